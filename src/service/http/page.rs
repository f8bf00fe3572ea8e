//! Paginated lists: `page_size`, and a `page_token` that names the last row of the page before.

use super::error::Problem;
use crate::service::store::listing::Listed;
use axum::body::{Body, Bytes};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use futures_util::{StreamExt, stream};
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::IntoParams;

const DEFAULT_PAGE_SIZE: i64 = 50;
const MAX_PAGE_SIZE: i64 = 500;

/// Bytes handed to the connection at a time.
const CHUNK_BYTES: usize = 64 << 10;

/// `?page_size=&page_token=`
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// Most items per page; values above 500 mean 500. Long items make a page shorter.
    #[param(nullable = false, minimum = 0, default = 50)]
    pub(super) page_size: Option<i64>,
    /// `next_page_token` of the page before.
    #[param(nullable = false, pattern = "^(s[0-9a-f]{1,15})?$")]
    pub(super) page_token: Option<String>,
}

impl PageQuery {
    /// Upper bound (exclusive) of the `seq` of the rows on this page; `None` on the first page.
    pub(super) fn before(&self) -> Result<Option<i64>, Problem> {
        let seq = self
            .page_token
            .as_deref()
            .map(|token| token.strip_prefix('s').and_then(|seq| i64::from_str_radix(seq, 16).ok()));
        match seq {
            Some(None) => Err(Problem::malformed(
                "the page_token is invalid",
                "use next_page_token of the page before, unchanged",
            )),
            Some(seq) => Ok(seq),
            None => Ok(None),
        }
    }

    /// Largest number of rows of the page.
    pub(super) fn max_rows(&self) -> Result<i64, Problem> {
        match self.page_size {
            None | Some(0) => Ok(DEFAULT_PAGE_SIZE),
            Some(size) if size > 0 => Ok(size.min(MAX_PAGE_SIZE)),
            Some(size) => {
                Err(Problem::malformed(format!("page_size is {size}"), format!("use 1 to {MAX_PAGE_SIZE}, or omit it")))
            }
        }
    }
}

/// `next_page_token` of a page; `None` on the last one. `seq` is the position of a row in the list.
pub(super) fn next_page_token<T>(page: &Listed<T>, seq: impl Fn(&T) -> i64) -> Option<String> {
    page.items.last().filter(|_| page.has_more).map(|row| format!("s{:x}", seq(row)))
}

/// Sends a page as JSON; `turn` ends when the client has read it.
pub(super) fn answer(page: &impl Serialize, turn: OwnedSemaphorePermit) -> Result<Response, Problem> {
    let text = Bytes::from(serde_json::to_vec(page).map_err(Problem::internal)?);
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("application/json")),
        (header::CONTENT_LENGTH, HeaderValue::from(text.len())),
    ];
    let starts = (0..text.len()).step_by(CHUNK_BYTES);
    let chunks = starts.map(move |start| text.slice(start..text.len().min(start + CHUNK_BYTES)));
    let chunks = stream::iter(chunks).map(move |chunk| {
        let _ = &turn; // held until the last chunk is taken
        Ok::<_, Infallible>(chunk)
    });
    Ok((headers, Body::from_stream(chunks)).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_have_no_gap_and_no_overlap() {
        let rows = |before: Option<i64>| (1..=5).rev().filter(move |seq| *seq < before.unwrap_or(i64::MAX));
        let mut query = PageQuery { page_size: Some(2), page_token: None };
        let mut seen = Vec::new();
        loop {
            let mut rest = rows(query.before().unwrap());
            let items = rest.by_ref().take(query.max_rows().unwrap() as usize).collect();
            let page = Listed { items, has_more: rest.next().is_some() };
            query.page_token = next_page_token(&page, |seq| *seq);
            seen.extend(page.items);
            if query.page_token.is_none() {
                break;
            }
        }
        assert_eq!(seen, [5, 4, 3, 2, 1]);
    }

    #[test]
    fn rejects_an_invalid_page_token() {
        for token in ["12", "sxyz", "s-"] {
            let query = PageQuery { page_size: None, page_token: Some(token.to_owned()) };
            assert!(query.before().is_err(), "{token}");
        }
    }
}
