//! What a client may ask of a job, checked before it is accepted.

use super::error::Problem;
use crate::export;
use crate::pipeline::Options;
use crate::pipeline::config::{Extrinsics, ScaleSource};
use crate::service::store::sessions::SessionSummary;
use crate::session::recording::UpAxis;
use axum::http::StatusCode;
use serde_json::{Map, Value};

/// Most people a session is solved for.
const MAX_PEOPLE: usize = 64;

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

/// Whether this session can give what is asked for.
pub(super) fn check(options: &Options, session: &SessionSummary) -> Result<(), Problem> {
    if options.people.is_some_and(|people| people == 0 || people > MAX_PEOPLE) {
        return Err(impossible("people", "the number of people is out of range", "take 1 to 64, or null"));
    }
    if options.extrinsics != Extrinsics::Estimate && !session.has_extrinsics {
        let remedy = "give R and t of every camera in the session, or take `estimate`";
        return Err(impossible("extrinsics", "the session lacks the extrinsics of a camera", remedy));
    }
    if options.up_axis == UpAxis::X {
        return Err(impossible("up_axis", "the result's world has y or z up", "take `y` or `z`"));
    }
    if options.body != "default" {
        return Err(impossible("body", "no such body is registered", "take `default`"));
    }
    check_scale(&options.scale, session)?;
    match options.exports.iter().position(|format| !export::supported(*format)) {
        Some(at) => Err(not_supported("this export is not written yet").at(format!("/options/exports/{at}"))),
        None => Ok(()),
    }
}

fn check_scale(scale: &ScaleSource, session: &SessionSummary) -> Result<(), Problem> {
    let metres = match scale {
        ScaleSource::Body => return Ok(()),
        ScaleSource::Height { metres, .. } | ScaleSource::CameraDistance { metres, .. } => *metres,
    };
    if !(metres.is_finite() && metres > 0.0) {
        return Err(impossible("scale/metres", "a length must be positive", "give it in metres"));
    }
    let ScaleSource::CameraDistance { cameras, .. } = scale else { return Ok(()) };
    if cameras[0] == cameras[1] {
        return Err(impossible("scale/cameras", "both cameras are the same", "name two cameras"));
    }
    match cameras.iter().position(|camera| !session.camera_ids.contains(camera)) {
        Some(at) => Err(impossible(
            &format!("scale/cameras/{at}"),
            &format!("the session has no camera `{}`", cameras[at]),
            &format!("the cameras are: {}", session.camera_ids.join(", ")),
        )),
        None => Ok(()),
    }
}

fn impossible(option: &str, detail: &str, remedy: &str) -> Problem {
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "option_impossible", detail, remedy).at(format!("/options/{option}"))
}

/// 422 for what a later release will do.
pub(super) fn not_supported(detail: &str) -> Problem {
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "not_supported", detail, "leave it out")
}
