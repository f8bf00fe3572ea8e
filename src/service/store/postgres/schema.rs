//! The tables of the server, and which releases may use them.
//!
//! Several releases use the database at the same time while a service is upgraded. A migration therefore only adds; what a release does not use any more
//! is taken away by the next one, whose migration raises `gate.oldest_release`. So a node passes over newer migrations that it does not
//! know, and ends where the gate says that it is too old.

use super::super::error::StoreError;
use super::super::migrations::POSTGRES;
use sqlx::migrate::Migrator;
use sqlx::postgres::{PgConnectOptions, PgConnection};
use sqlx::{ConnectOptions, Connection, Executor};

/// The release of this program.
const RELEASE: &str = env!("CARGO_PKG_VERSION");

/// Runs the migrations that the database does not have yet; of several processes one does, and the others wait for it.
///
/// # Errors
/// When the server does not answer, a migration fails, or this release is too old for the database.
pub(super) async fn migrate(options: &PgConnectOptions) -> Result<(), StoreError> {
    // A connection without the limits of the pool: an index of a large table takes minutes.
    let mut connection = options.connect().await?;
    connection.execute(sqlx::raw_sql("SET client_min_messages = 'warning'; SET timezone = 'UTC'")).await?;
    require_release(&mut connection).await?;
    let mut known = Migrator::with_migrations(POSTGRES.iter().cloned().collect());
    known.set_ignore_missing(true);
    known.run_direct(None, &mut connection, false).await.map_err(StoreError::Migration)?;
    require_release(&mut connection).await?;
    Ok(connection.close().await?)
}

/// Number of the newest migration that this release knows.
pub(in crate::service::store) fn newest() -> i64 {
    POSTGRES.iter().map(|migration| migration.version).max().unwrap_or(0)
}

/// Refuses a database that only newer releases may use.
async fn require_release(connection: &mut PgConnection) -> Result<(), StoreError> {
    let gate: Option<String> =
        sqlx::query_scalar("SELECT to_regclass('gate')::text").fetch_one(&mut *connection).await?;
    if gate.is_none() {
        return Ok(());
    }
    let oldest: Option<String> =
        sqlx::query_scalar("SELECT oldest_release FROM gate").fetch_optional(&mut *connection).await?;
    match oldest {
        Some(oldest) if numbers(RELEASE) < numbers(&oldest) => Err(StoreError::TooOld { oldest }),
        _ => Ok(()),
    }
}

/// The numbers of a release, most significant first.
fn numbers(release: &str) -> Vec<u64> {
    release.split(['.', '-', '+']).map_while(|number| number.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn releases_are_compared_by_number() {
        assert!(numbers("0.9.0") < numbers("0.10.0"));
        assert!(numbers("1.0.0") > numbers("0.99.99"));
        assert_eq!(numbers("1.2.3"), numbers("1.2.3-alpha"));
    }
}
