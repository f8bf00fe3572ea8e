//! The digest that separates a repeated request from another one under the same Idempotency-Key.

use crate::pipeline::Options;
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// What a client asked for.
pub(super) struct Request<'a> {
    pub session_sha256: &'a str,
    pub options: &'a Value,
    pub labels: &'a BTreeMap<String, String>,
    pub priority: i64,
    pub webhook: Option<&'a str>,
}

impl Request<'_> {
    /// SHA-256 of the request, without form boundaries, white space, and options at their defaults: so the next release, which knows
    /// more options, still knows the request.
    pub(super) fn fingerprint(&self) -> String {
        let Self { session_sha256, options, labels, priority, webhook } = self;
        let request = json!([session_sha256, stated(options), labels, priority, webhook]).to_string();
        hex::encode(Sha256::digest(request.as_bytes()))
    }
}

/// SHA-256 of a request as it was sent, of one whose meaning depends on another job: it still is known when that job was deleted.
pub fn fingerprint_as_sent(request: &Value) -> String {
    hex::encode(Sha256::digest(json!(["as sent", request]).to_string().as_bytes()))
}

/// The options that are not at their defaults.
fn stated(options: &Value) -> Map<String, Value> {
    let defaults = serde_json::to_value(Options::default()).unwrap_or_default();
    let all = options.as_object().into_iter().flatten();
    all.filter(|(name, value)| defaults.get(name) != Some(value))
        .map(|(name, value)| (name.clone(), value.clone()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_at_their_defaults_are_not_part_of_a_fingerprint() {
        let (session_sha256, labels) = ("00", &BTreeMap::new());
        let of = |options: Value| {
            Request { session_sha256, options: &options, labels, priority: 0, webhook: None }.fingerprint()
        };
        let all = serde_json::to_value(Options::default()).unwrap();
        assert_eq!(of(all.clone()), of(json!({})), "a release with fewer options has the same fingerprint");
        let mut other = all;
        other["people"] = json!(3);
        assert_eq!(of(other), of(json!({ "people": 3 })));
        assert_ne!(of(json!({ "people": 3 })), of(json!({})));
        assert_ne!(of(json!({ "people": 3 })), of(json!({ "people": 2 })));
    }
}
