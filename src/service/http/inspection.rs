//! `GET /v1/sessions/{id}/inspection`: what can be expected, before any compute is spent.

use super::access::Caller;
use super::error::Problem;
use super::intake::upload_problem;
use super::{ApiPath, App};
use crate::pipeline::inspection::{Inspection, inspect};
use crate::service::store::sessions;
use crate::session::upload::{self, UploadLimits};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

/// The inspection; the same for ever, as its session is.
pub(super) async fn get(
    State(app): State<App>,
    caller: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    let session = sessions::get(&app.store, &caller.tenant, &id).await?;
    let session = session.ok_or_else(|| Problem::not_found("session"))?;
    let _turn = app.validations.acquire().await.map_err(Problem::internal)?; // it holds a session in memory
    let (path, threads) = (app.store.folders.session(&id), app.settings.jobs.threads);
    let inspected = tokio::task::spawn_blocking(move || -> Result<Inspection, Problem> {
        let loaded = upload::read_path(&path, &UploadLimits::default()).map_err(upload_problem)?;
        let threads = if threads == 0 { std::thread::available_parallelism().map_or(1, usize::from) } else { threads };
        Ok(inspect(&loaded.session, threads))
    });
    let inspection = inspected.await.map_err(Problem::internal)??;
    let tag = [(header::ETAG, format!("\"{}-{}\"", session.summary.sha256, env!("CARGO_PKG_VERSION")))];
    Ok((tag, Json(inspection)).into_response())
}
