//! Reads and checks the options of a job before the job is accepted.

use super::error::Problem;
use crate::pipeline::option_table::OptionRow;
use crate::pipeline::{CameraFacts, Options, PipelineError};
use crate::service::bodies;
use crate::session::parser_errors::{in_json_words, pointer_step};
use axum::http::StatusCode;
use serde_json::{Map, Value};
use std::path::Path;

/// Reads the options; an unknown key or a wrong type is an error that names the option.
pub(super) fn parse(options: Option<Value>) -> Result<Options, Problem> {
    let Some(options) = options.filter(|options| !options.is_null()) else { return Ok(Options::default()) };
    let Value::Object(map) = &options else {
        return Err(Problem::malformed("options is not a JSON object", "send {\"<option>\": value}").at("/options"));
    };
    serde_json::from_value(options.clone()).map_err(|error| {
        find_bad_option(map).unwrap_or_else(|| {
            Problem::malformed(format!("options: {}", in_json_words(&error)), "see the list of options").at("/options")
        })
    })
}

/// Finds the option that causes the error: the first one that fails on its own.
fn find_bad_option(options: &Map<String, Value>) -> Option<Problem> {
    options.iter().find_map(|(key, value)| {
        let alone = Value::Object(Map::from_iter([(key.clone(), value.clone())]));
        let error = serde_json::from_value::<Options>(alone).err()?;
        let pointer = format!("/options{}", pointer_step(key));
        let (code, remedy) = match OptionRow::named(key) {
            None => ("option_unknown", "remove it".to_owned()),
            Some(OptionRow { kind, .. }) if kind.range().is_empty() => {
                ("option_malformed", format!("send a value of the type {}", kind.name()))
            }
            Some(OptionRow { kind, .. }) => {
                ("option_malformed", format!("send a value of the type {} ({})", kind.name(), kind.range()))
            }
        };
        Some(
            Problem::new(StatusCode::BAD_REQUEST, code, format!("options: {}", in_json_words(&error)), remedy)
                .at(pointer),
        )
    })
}

/// Checks that the session and the registered body models support the options.
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
