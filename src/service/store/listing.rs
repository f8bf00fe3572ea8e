//! Pages of a list, bounded in rows and bytes: a page of long names or labels ends early instead of filling the memory.

use super::error::StoreError;
use super::sql::SqlRow;
use crate::service::failpoint::fault;
use futures_util::{Stream, TryStreamExt};
use sqlx::Row;

/// Bytes of text that the rows of one page hold together. 500 usual jobs have about 400 KB; a single longer row is a page
/// of its own.
const MAX_PAGE_BYTES: i64 = 1 << 20;

/// One page of a list.
#[derive(Debug)]
pub struct Listed<T> {
    /// The rows, in the order of the list.
    pub items: Vec<T>,
    /// Whether further rows follow.
    pub has_more: bool,
}

/// Reads at most `max_rows` rows, which have the column `row_bytes`; the query must return one row more, if there is one.
///
/// # Errors
/// When the database fails or a row cannot be converted.
pub(crate) async fn read_page<T>(
    mut rows: impl Stream<Item = sqlx::Result<SqlRow>> + Unpin,
    max_rows: i64,
    convert: impl Fn(&SqlRow) -> Result<T, StoreError>,
) -> Result<Listed<T>, StoreError> {
    let mut items = Vec::new();
    let mut bytes = 0;
    while let Some(row) = rows.try_next().await? {
        bytes += row.try_get::<i64, _>("row_bytes")?;
        let is_full = bytes > MAX_PAGE_BYTES && !fault("pages.unbounded");
        if items.len() as i64 >= max_rows || (is_full && !items.is_empty()) {
            return Ok(Listed { items, has_more: true });
        }
        items.push(convert(&row)?);
    }
    Ok(Listed { items, has_more: false })
}
