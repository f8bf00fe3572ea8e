//! `/v1/jobs/{id}/deliveries` and `/v1/webhook-secret`: webhook deliveries of a job, redelivery, and the signing secret.

use super::access::Caller;
use super::app::App;
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use crate::service::store::tenants;
use crate::service::webhooks::{self, Delivery};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// The webhook deliveries of one job.
#[derive(Serialize, ToSchema)]
pub(super) struct DeliveryList {
    deliveries: Vec<Delivery>,
}

/// The key that signs the webhooks of the caller.
#[derive(Serialize, ToSchema)]
pub(super) struct WebhookSecret {
    #[schema(pattern = "^whsec_")]
    secret: String,
}

/// `{id}` of a job and `{delivery}`.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct DeliveryPath {
    /// Id of the job.
    #[param(pattern = "^job_[0-9a-f]{32}$")]
    id: String,
    /// Id of the delivery.
    #[param(pattern = "^delivery_[0-9a-f]{32}$")]
    delivery: String,
}

/// List the webhook deliveries of a job, oldest first.
#[utoipa::path(get, path = "/v1/jobs/{id}/deliveries", operation_id = "listDeliveries", tag = "webhooks",
    params(JobPath), responses((status = 200, description = "The deliveries", body = DeliveryList)))]
pub(super) async fn list(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(JobPath { id }): ApiPath<JobPath>,
) -> Result<Json<DeliveryList>, Problem> {
    app.queue.get(&tenant, &id).await?.ok_or_else(|| Problem::not_found("job"))?;
    let deliveries = webhooks::deliveries_of(&app.store, &tenant, &id).await?;
    Ok(Json(DeliveryList { deliveries }))
}

/// Repeat a webhook delivery.
#[utoipa::path(post, path = "/v1/jobs/{id}/deliveries/{delivery}/redeliver", operation_id = "redeliver", tag = "webhooks",
    params(DeliveryPath), responses((status = 202, description = "The call is repeated at once", body = Delivery)))]
pub(super) async fn redeliver(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(DeliveryPath { id: job, delivery: id }): ApiPath<DeliveryPath>,
) -> Result<(StatusCode, Json<Delivery>), Problem> {
    let delivery = webhooks::redeliver(&app.store, &tenant, &job, &id).await?;
    delivery.map(|delivery| (StatusCode::ACCEPTED, Json(delivery))).ok_or_else(|| {
        Problem::new(
            StatusCode::NOT_FOUND,
            "not_found",
            "the job does not have this delivery",
            format!("list them with GET /v1/jobs/{job}/deliveries"),
        )
    })
}

/// Get the secret that signs the webhooks of the caller; needs the scope `write`.
#[utoipa::path(get, path = "/v1/webhook-secret", operation_id = "getWebhookSecret", tag = "webhooks",
    responses((status = 200, description = "The secret, `whsec_…`", body = WebhookSecret)))]
pub(super) async fn secret(State(app): State<App>, Caller { tenant }: Caller) -> Result<Json<WebhookSecret>, Problem> {
    Ok(Json(WebhookSecret { secret: tenants::webhook_secret(&app.store, &tenant).await? }))
}

/// Replace the secret that signs the webhooks of the caller.
///
/// For 24 hours calls are signed with both secrets, so that receivers can change over.
#[utoipa::path(post, path = "/v1/webhook-secret", operation_id = "rotateWebhookSecret", tag = "webhooks",
    responses((status = 200, description = "The new secret, `whsec_…`", body = WebhookSecret)))]
pub(super) async fn rotate_secret(
    State(app): State<App>,
    Caller { tenant }: Caller,
) -> Result<Json<WebhookSecret>, Problem> {
    Ok(Json(WebhookSecret { secret: tenants::rotate_webhook_secret(&app.store, &tenant).await? }))
}
