//! Jobs that correct an earlier job: its session and its options, with other corrections.

use super::app::App;
use super::error::Problem;
use super::options;
use crate::pipeline::Options;
use crate::service::queue::Phase;
use crate::service::queue::job::Job;
use crate::service::store::Tenant;
use axum::http::StatusCode;
use serde_json::Value;

/// The job that is corrected.
pub(super) async fn corrected_job(app: &App, tenant: &Tenant, id: &str) -> Result<Job, Problem> {
    let job = app.queue.get(tenant, id).await?.ok_or_else(|| Problem::not_found("job").at("/corrects"))?;
    if job.state.phase() == Phase::Succeeded {
        return Ok(job);
    }
    let detail = format!("the job is {}: it has no people to correct", job.state.phase().name());
    let remedy = "wait until it has succeeded, or correct another job";
    Err(Problem::new(StatusCode::CONFLICT, "job_not_succeeded", detail, remedy).at("/corrects"))
}

/// The options of the earlier job with those of the request.
pub(super) fn with_options_of(earlier: &Job, given: Option<Value>) -> Result<Option<Value>, Problem> {
    let mut merged = earlier.options.clone();
    match given {
        None | Some(Value::Null) => {}
        Some(Value::Object(given)) => given.into_iter().for_each(|(name, value)| merged[name] = value),
        Some(_) => return Err(not_an_object()),
    }
    let [before, after] = [earlier.options.clone(), merged.clone()].map(|all| options::parse(Some(all)));
    match changed_option(&before?.without_corrections(), &after?.without_corrections()) {
        None => Ok(Some(merged)),
        Some(name) => {
            let detail = format!("{name} differs from the corrected job's, on which the numbers of its people depend");
            let remedy = "leave the option out, or submit the session without `corrects`";
            let problem = Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "option_impossible", detail, remedy);
            Err(problem.at(format!("/options/{name}")))
        }
    }
}

pub(super) fn not_an_object() -> Problem {
    Problem::malformed("options is not a JSON object", "send {\"corrections\": […]}").at("/options")
}

/// The first option that differs.
fn changed_option(before: &Options, after: &Options) -> Option<String> {
    let [before, after] = [before, after].map(|options| serde_json::to_value(options).unwrap_or_default());
    let names = before.as_object().into_iter().flat_map(|all| all.keys());
    names.into_iter().find(|name| before[name.as_str()] != after[name.as_str()]).cloned()
}
