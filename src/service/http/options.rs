//! What a client may ask of a job, checked before it is accepted.

use super::error::Problem;
use crate::pipeline::{CameraFacts, Options, PipelineError};
use crate::service::bodies;
use axum::http::StatusCode;
use serde_json::{Map, Value};
use std::path::Path;

/// Reads the options; unknown keys and wrong types are refused by name.
pub(super) fn parse(options: Option<Value>) -> Result<Options, Problem> {
    let Some(options) = options.filter(|options| !options.is_null()) else { return Ok(Options::default()) };
    let Value::Object(map) = &options else {
        return Err(Problem::malformed("options is no JSON object", "send {\"<option>\": value}").at("/options"));
    };
    serde_json::from_value(options.clone()).map_err(|error| {
        find_bad_option(map).unwrap_or_else(|| {
            Problem::malformed(format!("options: {error}"), "see the list of options").at("/options")
        })
    })
}

/// The option that alone is refused already.
fn find_bad_option(options: &Map<String, Value>) -> Option<Problem> {
    options.iter().find_map(|(key, value)| {
        let alone = Value::Object(Map::from_iter([(key.clone(), value.clone())]));
        let error = serde_json::from_value::<Options>(alone).err()?;
        let pointer = format!("/options/{}", key.replace('~', "~0").replace('/', "~1"));
        let code = if is_known(key) { "option_malformed" } else { "option_unknown" };
        let remedy = if is_known(key) { "see the option's meaning and values" } else { "leave it out" };
        Some(Problem::new(StatusCode::BAD_REQUEST, code, format!("options: {error}"), remedy).at(pointer))
    })
}

fn is_known(key: &str) -> bool {
    serde_json::to_value(Options::default()).is_ok_and(|all| all.get(key).is_some())
}

/// Whether this session and the bodies registered here can give what is asked for.
pub(super) fn check(options: &Options, cameras: &[CameraFacts], bodies: &Path) -> Result<(), Problem> {
    let bodies = bodies::list(bodies).map_err(Problem::internal)?;
    let names: Vec<String> = bodies.into_iter().map(|body| body.name).collect();
    options.check(cameras, &names).map_err(|error| match error {
        PipelineError::Option { option, reason } => {
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "option_impossible", reason, "change the option")
                .at(format!("/options{option}"))
        }
        other => Problem::internal(other),
    })
}
