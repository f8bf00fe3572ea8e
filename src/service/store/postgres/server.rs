//! What the store keeps of the server.

use super::super::sql::{SqlPool, WriteTransaction};
use sqlx::postgres::PgConnectOptions;

/// The server, for connections beside the pool.
#[derive(Debug, Clone)]
pub(crate) struct Server {
    /// How a single connection is made.
    pub(crate) options: PgConnectOptions,
}

/// Starts a transaction whose commit does not wait for the disk: a crash of the server can lose it, but damages nothing.
pub(in crate::service::store) async fn begin_relaxed(pool: &SqlPool) -> Result<WriteTransaction, sqlx::Error> {
    let mut transaction = pool.begin().await?;
    sqlx::query("SET LOCAL synchronous_commit = off").execute(&mut *transaction).await?;
    Ok(transaction)
}
