//! Extractors of path and query parameters that answer with problem documents, and the ids in paths.

use super::error::Problem;
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::Uri;
use axum::http::request::Parts;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use utoipa::IntoParams;

/// [`Path`] that answers a malformed path with a problem document.
pub(super) struct ApiPath<T>(pub(super) T);

/// [`Query`] that answers a malformed query with a problem document; an empty parameter counts as absent.
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

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        require_storable(parts)?;
        let given = Uri::try_from(format!("/?{}", given(parts.uri.query().unwrap_or_default())));
        let query = Query::try_from_uri(&given.map_err(Problem::internal)?).map_err(|error| {
            let text = error.body_text();
            let reason = text.rsplit_once("query string: ").map_or(text.as_str(), |(_, reason)| reason);
            let remedy = "correct the parameter, or leave it out; GET /openapi.json states what each one takes";
            Problem::malformed(format!("the query: {reason}"), remedy)
        });
        query.map(|Query(query)| Self(query))
    }
}

/// A query without the parameters that are empty: forms and scripts send those for what is not set.
fn given(query: &str) -> String {
    let is_given = |pair: &&str| pair.split_once('=').is_some_and(|(_, value)| !value.is_empty());
    query.split('&').filter(is_given).collect::<Vec<_>>().join("&")
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_query_parameters_were_refused_as_numbers() {
        assert_eq!(given("page_size=&wait&state=&label=a=&page_token=s1"), "label=a=&page_token=s1");
        assert_eq!(given(""), "");
    }
}
