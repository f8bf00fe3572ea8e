//! `GET /v1/jobs/{id}/scene`: cameras and people of a running job, as they are known so far.

use super::access::Caller;
use super::app::App;
use super::conditions::is_unchanged;
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use crate::pipeline::provisional::ProvisionalScene;
use crate::service::queue::Phase;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Get the provisional scene of a running job.
///
/// Cameras and points after the stages `cameras`, `denoising`, `joint_trajectories` and `corrections`; the event `scene` announces
/// a new one. Scale, bodies and the last adjustment of the cameras are still missing, so that the result differs. In a service of
/// several machines the node that runs the job has it.
#[utoipa::path(get, path = "/v1/jobs/{id}/scene", operation_id = "getProvisionalScene", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The scene", body = ProvisionalScene, headers(("ETag" = String))),
        (status = 304, description = "Unchanged"), (status = 409)))]
pub(super) async fn get(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(JobPath { id }): ApiPath<JobPath>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = app.queue.get(&tenant, &id).await?.ok_or_else(|| Problem::not_found("job"))?;
    let scene = app.queue.scene(&id).ok_or_else(|| no_scene(&id, job.state.phase()))?;
    let tag = format!("\"{}\"", scene.sha256);
    if is_unchanged(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    let headers = [(header::CONTENT_TYPE, "application/json".to_owned()), (header::ETAG, tag)];
    Ok((headers, scene.document.clone()).into_response())
}

fn no_scene(id: &str, phase: Phase) -> Problem {
    let remedy = match phase.is_final() {
        true => format!("GET /v1/jobs/{id} says how the job ended, and links its result"),
        false => format!("wait for the event `scene` of GET /v1/jobs/{id}/events"),
    };
    let detail = format!("the job is {} and shows no provisional scene", phase.name());
    Problem::new(StatusCode::CONFLICT, "not_ready", detail, remedy)
}
