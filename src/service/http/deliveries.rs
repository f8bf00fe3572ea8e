//! `/v1/jobs/{id}/deliveries` and `/v1/webhook-secret`: what became of a job's webhooks, once more, and how they are signed.

use super::access::Caller;
use super::error::Problem;
use super::{ApiPath, App};
use crate::service::store::tenants;
use crate::service::webhooks::{self, Delivery};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde_json::{Value, json};

/// The deliveries of a job, oldest first.
pub(super) async fn list(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<Value>, Problem> {
    app.queue.get(&tenant, &id).await?.ok_or_else(|| Problem::not_found("job"))?;
    let deliveries = webhooks::deliveries_of(&app.store, &tenant, &id).await?;
    Ok(Json(json!({ "deliveries": deliveries })))
}

/// 202: the call is made once more, at once.
pub(super) async fn redeliver(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath((job, id)): ApiPath<(String, String)>,
) -> Result<(StatusCode, Json<Delivery>), Problem> {
    let delivery = webhooks::redeliver(&app.store, &tenant, &job, &id).await?;
    delivery.map(|delivery| (StatusCode::ACCEPTED, Json(delivery))).ok_or_else(|| {
        Problem::new(
            StatusCode::NOT_FOUND,
            "not_found",
            "the job has no such delivery",
            format!("list them with GET /v1/jobs/{job}/deliveries"),
        )
    })
}

/// The secret that the caller's webhooks are signed with.
pub(super) async fn secret(State(app): State<App>, Caller { tenant }: Caller) -> Result<Json<Value>, Problem> {
    Ok(Json(json!({ "secret": tenants::webhook_secret(&app.store, &tenant).await? })))
}
