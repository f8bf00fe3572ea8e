//! Extractors of path and query parameters that answer with problem documents, and the ids in paths.

use super::error::Problem;
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use utoipa::IntoParams;

/// [`Path`] that answers a malformed path with a problem document.
pub(super) struct ApiPath<T>(pub(super) T);

/// [`Query`] that answers a malformed query with a problem document.
pub(super) struct ApiQuery<T>(pub(super) T);

impl<T: DeserializeOwned + Send, S: Sync + Send> FromRequestParts<S> for ApiPath<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        require_storable(parts)?;
        let path = Path::from_request_parts(parts, state).await;
        path.map(|Path(path)| Self(path)).map_err(|error| Problem::malformed(error.body_text(), "check the path"))
    }
}

impl<T: DeserializeOwned, S: Sync + Send> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        require_storable(parts)?;
        let query = Query::from_request_parts(parts, state).await;
        query.map(|Query(query)| Self(query)).map_err(|error| Problem::malformed(error.body_text(), "check the query"))
    }
}

/// Refuses the character U+0000, which PostgreSQL takes in no text, with every database.
fn require_storable(parts: &Parts) -> Result<(), Problem> {
    match parts.uri.path_and_query().is_some_and(|path| path.as_str().contains("%00")) {
        true => Err(Problem::malformed("the path or the query has the character U+0000", "leave it out")),
        false => Ok(()),
    }
}

/// `{id}` of a session.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct SessionPath {
    /// Id of the session.
    #[param(pattern = "^session_[0-9a-f]{32}$")]
    pub(super) id: String,
}

/// `{id}` of a job.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct JobPath {
    /// Id of the job.
    #[param(pattern = "^job_[0-9a-f]{32}$")]
    pub(super) id: String,
}
