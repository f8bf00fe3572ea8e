//! Returns the pages of deleted rows to the disk: SQLite alone keeps them in the file for later rows.

use super::sql::SqlPool;

/// Free pages that are always kept: 4 MiB of 4 KiB pages, so that a queue that fills and empties does not resize its file.
const MIN_FREE_PAGES: i64 = 1000;

/// Pages returned in one transaction, so that other writers wait for milliseconds only.
const STEP: &str = "PRAGMA incremental_vacuum(2000)";

/// Whether more than a quarter of the file is free.
async fn is_loose(database: &SqlPool) -> Result<bool, sqlx::Error> {
    let free: i64 = sqlx::query_scalar("PRAGMA freelist_count").fetch_one(database).await?;
    let pages: i64 = sqlx::query_scalar("PRAGMA page_count").fetch_one(database).await?;
    Ok(free > MIN_FREE_PAGES && free > pages / 4)
}

/// Returns some free pages to the disk if a large part of the file is free; the next checkpoint shortens the file.
///
/// # Errors
/// When the database fails.
pub(super) async fn step(readers: &SqlPool, writer: &SqlPool) -> Result<(), sqlx::Error> {
    if is_loose(readers).await? {
        let mut transaction = writer.begin_with("BEGIN IMMEDIATE").await?;
        sqlx::query(STEP).execute(&mut *transaction).await?;
        transaction.commit().await?;
    }
    Ok(())
}

/// Rewrites a loose file of an earlier release, which cannot shrink step by step. If that fails, for example for want of
/// space, the file stays as it is.
///
/// # Errors
/// When the database cannot be read.
pub(super) async fn rewrite_if_loose(writer: &SqlPool) -> Result<(), sqlx::Error> {
    const NONE: i64 = 0;
    let mode: i64 = sqlx::query_scalar("PRAGMA auto_vacuum").fetch_one(writer).await?;
    if mode != NONE || !is_loose(writer).await? {
        return Ok(());
    }
    tracing::info!("rewriting the database, of which a large part is free");
    let mut connection = writer.acquire().await?;
    let rewritten = async {
        sqlx::query("PRAGMA auto_vacuum = INCREMENTAL").execute(&mut *connection).await?;
        sqlx::query("VACUUM").execute(&mut *connection).await
    };
    if let Err(error) = rewritten.await {
        tracing::warn!(%error, "the database was not rewritten and keeps its size");
    }
    Ok(())
}
