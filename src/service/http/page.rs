//! Paginated lists: `page_size`, and a `page_token` that names the last row of the page before.

use super::error::Problem;
use serde::Deserialize;
use utoipa::IntoParams;

const DEFAULT_PAGE_SIZE: i64 = 50;
const MAX_PAGE_SIZE: i64 = 500;

/// `?page_size=&page_token=`
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// Items per page; values above 500 mean 500.
    #[param(nullable = false, minimum = 0, default = 50)]
    pub(super) page_size: Option<i64>,
    /// `next_page_token` of the page before.
    #[param(nullable = false, pattern = "^(s[0-9a-f]{1,15})?$")]
    pub(super) page_token: Option<String>,
}

/// One page of a list.
#[derive(Debug)]
pub(super) struct Page<T> {
    pub(super) items: Vec<T>,
    /// Requests the next page; `None` on the last page.
    pub(super) next_page_token: Option<String>,
}

impl PageQuery {
    /// Upper bound (exclusive) of the `seq` of the rows on this page; `None` on the first page.
    pub(super) fn before(&self) -> Result<Option<i64>, Problem> {
        let token = self.page_token.as_deref().filter(|token| !token.is_empty());
        let seq = token.map(|token| token.strip_prefix('s').and_then(|seq| i64::from_str_radix(seq, 16).ok()));
        match seq {
            Some(None) => Err(Problem::malformed(
                "the page_token is invalid",
                "use next_page_token of the page before, unchanged",
            )),
            Some(seq) => Ok(seq),
            None => Ok(None),
        }
    }

    /// Number of rows to fetch: one more than the page holds shows whether another page follows.
    pub(super) fn fetch_size(&self) -> Result<i64, Problem> {
        Ok(self.size()? + 1)
    }

    fn size(&self) -> Result<i64, Problem> {
        match self.page_size {
            None | Some(0) => Ok(DEFAULT_PAGE_SIZE),
            Some(size) if size > 0 => Ok(size.min(MAX_PAGE_SIZE)),
            Some(size) => {
                Err(Problem::malformed(format!("page_size is {size}"), format!("use 1 to {MAX_PAGE_SIZE}, or omit it")))
            }
        }
    }
}

impl<T> Page<T> {
    /// Makes a page of the fetched rows and drops the extra row.
    pub(super) fn cut(mut rows: Vec<T>, query: &PageQuery, seq: impl Fn(&T) -> i64) -> Result<Self, Problem> {
        let size = query.size()? as usize;
        let is_last = rows.len() <= size;
        rows.truncate(size);
        let next_page_token = rows.last().filter(|_| !is_last).map(|row| format!("s{:x}", seq(row)));
        Ok(Self { items: rows, next_page_token })
    }
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
            let fetched = rows(query.before().unwrap()).take(query.fetch_size().unwrap() as usize).collect();
            let page = Page::cut(fetched, &query, |seq| *seq).unwrap();
            seen.extend(page.items);
            query.page_token = page.next_page_token;
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
