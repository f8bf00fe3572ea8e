//! `verify` of a service of several machines: every object that a row names is read and compared with its digest, and where it is
//! missing, brought back from the versions of the bucket.

use crate::service::store::blobs::Checked;
use crate::service::store::{Store, StoreError};
use futures_util::{StreamExt, TryStreamExt};
use sqlx::Connection;
use sqlx::postgres::PgConnection;

/// Objects that are read at the same time.
const AT_ONCE: usize = 8;

/// Sessions, or jobs, whose objects are listed by one statement.
const PAGE: i64 = 1000;

/// Number, key and digest of the objects of the sessions, or jobs, after `$1`.
const NAMED: [&str; 2] = [
    "SELECT seq, 'sessions/' || id, sha256 FROM sessions WHERE seq > $1 ORDER BY seq LIMIT $2",
    "SELECT DISTINCT page.seq, 'results/' || page.id || '/' || page.result_fence || '/' || sha256, sha256
     FROM (SELECT seq, id, result_fence FROM jobs WHERE seq > $1 AND state = 'succeeded' ORDER BY seq LIMIT $2) AS page
     JOIN artifacts ON artifacts.job_id = page.id ORDER BY page.seq",
];

/// Result of a verification.
#[derive(Debug, Default)]
pub struct SharedReport {
    /// Objects that were read.
    pub checked: usize,
    /// Objects that were brought back.
    pub restored: usize,
    /// One line for each object that is missing or has other bytes.
    pub damages: Vec<String>,
    /// Why nothing can be brought back.
    pub unversioned: Option<String>,
}

/// Verifies every object that a row names; with `undelete`, missing and damaged ones are brought back from their versions.
///
/// # Errors
/// When the database or the object store does not answer; damage is not an error but part of the report.
pub async fn verify_shared(store: &Store, undelete: bool) -> Result<SharedReport, StoreError> {
    let mut report = SharedReport::default();
    let undelete = undelete && can_undelete(store, &mut report).await?;
    let Some(mut connection) = store.own_connection().await? else { return Ok(report) };
    for statement in NAMED {
        let mut last = 0;
        loop {
            let page = named(&mut connection, statement, last).await?;
            let Some((seq, _, _)) = page.last() else { break };
            last = *seq;
            check(store, page, undelete, &mut report).await?;
        }
    }
    connection.close().await?;
    Ok(report)
}

async fn can_undelete(store: &Store, report: &mut SharedReport) -> Result<bool, StoreError> {
    match store.blobs.require_versions().await {
        Ok(()) => Ok(true),
        Err(StoreError::Unversioned { reason }) => {
            report.unversioned = Some(reason);
            Ok(false)
        }
        Err(error) => Err(error),
    }
}

async fn named(
    connection: &mut PgConnection,
    statement: &'static str,
    last: i64,
) -> Result<Vec<(i64, String, String)>, StoreError> {
    Ok(sqlx::query_as(statement).bind(last).bind(PAGE).fetch_all(connection).await?)
}

async fn check(
    store: &Store,
    page: Vec<(i64, String, String)>,
    undelete: bool,
    report: &mut SharedReport,
) -> Result<(), StoreError> {
    let checks = page.into_iter().map(|(_, key, sha256)| async move {
        let checked = store.blobs.check(&key, &sha256, undelete).await?;
        Ok::<_, StoreError>((key, checked))
    });
    let checks: Vec<_> = futures_util::stream::iter(checks).buffer_unordered(AT_ONCE).try_collect().await?;
    for (key, checked) in checks {
        report.checked += 1;
        match checked {
            Checked::Whole => {}
            Checked::Restored => report.restored += 1,
            Checked::Damaged => report.damages.push(format!("{key}: the object is missing or has other bytes")),
        }
    }
    Ok(())
}
