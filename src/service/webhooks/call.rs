//! One webhook call: signed, only to checked addresses, without redirects, limited in time and response size.

use super::target::{Networks, check_url};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use std::io::Read;
use std::net::{SocketAddr, ToSocketAddrs};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use ureq::Agent;
use ureq::config::Config;
use ureq::http::Uri;
use ureq::unversioned::resolver::{ResolvedSocketAddrs, Resolver};
use ureq::unversioned::transport::{DefaultConnector, NextTimeout};

/// Maximal number of response bytes that are read.
const MAX_ANSWER: u64 = 64 << 10;

/// Maximal number of addresses of a host name that are used.
const MAX_ADDRESSES: usize = 16;

/// A prepared call.
#[derive(Debug)]
pub(super) struct Call {
    pub(super) id: String,
    pub(super) url: String,
    /// Secrets that sign the call: the current one, and the one that it has replaced a short time ago.
    pub(super) secrets: Vec<String>,
    pub(super) body: Vec<u8>,
}

/// CallOutcome of a call.
#[derive(Debug)]
pub(super) struct CallOutcome {
    pub(super) status: Option<u16>,
    pub(super) error: Option<String>,
}

impl CallOutcome {
    pub(super) fn failed(status: Option<u16>, error: impl Into<String>) -> Self {
        Self { status, error: Some(error.into()) }
    }

    pub(super) fn is_delivered(&self) -> bool {
        self.error.is_none()
    }
}

impl Call {
    /// Makes the call; blocks for at most `timeout`.
    pub(super) fn make(&self, networks: &Networks, timeout: Duration) -> CallOutcome {
        match self.answer_status(networks, timeout) {
            Ok(status) if (200..300).contains(&status) => CallOutcome { status: Some(status), error: None },
            Ok(status) => CallOutcome::failed(Some(status), format!("the receiver answered with status {status}")),
            Err(error) => CallOutcome::failed(None, error),
        }
    }

    fn answer_status(&self, networks: &Networks, timeout: Duration) -> Result<u16, String> {
        check_url(&self.url, networks).map_err(|error| error.to_string())?;
        let addresses = self.addresses()?;
        networks.check_all(&addresses).map_err(|error| error.to_string())?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        let signed = self.secrets.iter().map(|secret| signature(secret, &self.id, now, &self.body));
        let signatures: Vec<String> = signed.collect::<Option<_>>().ok_or("the secret is not valid base64")?;
        let config = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .proxy(None)
            .timeout_global(Some(timeout))
            .user_agent(concat!("wandless/", env!("CARGO_PKG_VERSION")))
            .build();
        let agent = Agent::with_parts(config, DefaultConnector::default(), Pinned(addresses));
        let answer = agent
            .post(&self.url)
            .content_type("application/json")
            .header("webhook-id", &self.id)
            .header("webhook-timestamp", now.to_string())
            .header("webhook-signature", signatures.join(" "))
            .send(&self.body[..]);
        let mut answer = answer.map_err(|error| error.to_string())?;
        let mut rest = answer.body_mut().as_reader().take(MAX_ANSWER);
        std::io::copy(&mut rest, &mut std::io::sink()).map_err(|error| error.to_string())?;
        Ok(answer.status().as_u16())
    }

    /// Resolves the host name.
    fn addresses(&self) -> Result<Vec<SocketAddr>, String> {
        let uri: Uri = self.url.parse().map_err(|_| "the URL cannot be parsed")?;
        let host = uri.host().ok_or("the URL has no host")?.trim_start_matches('[').trim_end_matches(']');
        let port = uri.port_u16().unwrap_or(if uri.scheme_str() == Some("https") { 443 } else { 80 });
        let addresses = (host, port).to_socket_addrs().map_err(|error| format!("{host}: {error}"))?;
        Ok(addresses.take(MAX_ADDRESSES).collect())
    }
}

/// `v1,` and the HMAC-SHA256 of `<id>.<timestamp>.<body>` in base64 (Standard Webhooks 1.0); `None` if the secret is not
/// `whsec_<base64>`.
pub fn signature(secret: &str, id: &str, timestamp_s: u64, body: &[u8]) -> Option<String> {
    let key = STANDARD.decode(secret.strip_prefix("whsec_")?).ok()?;
    let mut mac = Hmac::<Sha256>::new_from_slice(&key).ok()?;
    mac.update(format!("{id}.{timestamp_s}.").as_bytes());
    mac.update(body);
    Some(format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes())))
}

/// Resolver that returns the checked addresses for every name.
#[derive(Debug)]
struct Pinned(Vec<SocketAddr>);

impl Resolver for Pinned {
    fn resolve(&self, _: &Uri, _: &Config, _: NextTimeout) -> Result<ResolvedSocketAddrs, ureq::Error> {
        let mut resolved = self.empty();
        for address in self.0.iter().take(MAX_ADDRESSES) {
            resolved.push(*address);
        }
        if resolved.is_empty() { Err(ureq::Error::HostNotFound) } else { Ok(resolved) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Example of the reference libraries of Standard Webhooks.
    #[test]
    fn signature_matches_the_standard() {
        let signed = signature(
            "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw",
            "msg_p5jXN8AQM9LWM0D4loKWxJek",
            1_614_265_330,
            br#"{"test": 2432232314}"#,
        );
        assert_eq!(signed.as_deref(), Some("v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="));
        assert!(signature("secret", "a", 0, b"").is_none());
    }
}
