//! The rows: copied as they are, in one transaction, and compared before it is committed.

mod table;

use super::error::TransferError;
use super::moved::Moved;
use super::source::Source;
use crate::service::store::{Store, StoreError};
use sqlx::postgres::PgConnection;
use sqlx::{Connection, Executor};
use table::{TABLES, Table};

/// Tables that stay: the list of migrations, where the files are, and SQLite's own.
const LEFT: [&str; 3] = ["_sqlx_migrations", "storage", "sqlite_sequence"];

/// Tables whose rows a used target has.
const OF_USE: [&str; 5] = ["sessions", "jobs", "api_keys", "idempotency", "webhook_deliveries"];

/// Before the rows: no trigger counts, since the counters are rows, too, and no other process writes.
const PREPARE: &str = "SET LOCAL synchronous_commit = on;
    LOCK TABLE tenants, sessions, jobs, api_keys, idempotency IN EXCLUSIVE MODE;
    ALTER TABLE jobs DISABLE TRIGGER USER; ALTER TABLE sessions DISABLE TRIGGER USER;
    DELETE FROM tenants; DELETE FROM clock";

/// After the rows: counters that SQLite does not have, and the next turn.
const COMPLETE: &str = "
    UPDATE tenants SET n_wanted_0 = n[1], n_wanted_1 = n[2], n_wanted_2 = n[3], n_wanted_3 = n[4]
    FROM (SELECT tenant, ARRAY[count(*) FILTER (WHERE class = 0), count(*) FILTER (WHERE class = 1),
                               count(*) FILTER (WHERE class = 2), count(*) FILTER (WHERE class = 3)] AS n
          FROM jobs WHERE state IN ('queued', 'running', 'canceling') GROUP BY tenant) AS open
    WHERE name = open.tenant;
    SELECT add_up_totals();
    ALTER TABLE jobs ENABLE TRIGGER USER; ALTER TABLE sessions ENABLE TRIGGER USER;
    SELECT setval('turns', 1 + (SELECT coalesce(max(turn), 0) FROM tenants))";

/// Refuses a target with rows.
///
/// # Errors
/// [`TransferError::NotEmpty`] with the first table.
pub(super) async fn require_empty(target: &Store) -> Result<(), TransferError> {
    let mut connection = connection(target).await?;
    none_used(&mut connection).await
}

async fn none_used(connection: &mut PgConnection) -> Result<(), TransferError> {
    for table in OF_USE {
        let count = sqlx::query_scalar(sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}")));
        let rows: i64 = count.fetch_one(&mut *connection).await?;
        if rows > 0 {
            return Err(TransferError::NotEmpty { table, rows });
        }
    }
    Ok(())
}

/// Copies every row.
///
/// # Errors
/// When a database fails, a table is unknown, or a table reads back otherwise; nothing is committed then.
pub(super) async fn store(source: &Source, target: &Store, moved: &mut Moved) -> Result<(), TransferError> {
    require_known_tables(source).await?;
    let mut connection = connection(target).await?;
    connection.execute("SET statement_timeout = 0; SET idle_in_transaction_session_timeout = 0").await?;
    let mut transaction = connection.begin().await?;
    transaction.execute(sqlx::raw_sql(PREPARE)).await?;
    none_used(&mut transaction).await?; // under the lock
    for definition in TABLES {
        let name = definition.name;
        let table = Table::read(definition, source, &mut transaction).await?;
        let n_rows = table.copy(source, &mut transaction, &mut moved.replaced).await?;
        table.compare(source, &mut transaction).await?;
        moved.rows.push((name, n_rows));
    }
    set_sequences(source, &mut transaction).await?;
    transaction.execute(sqlx::raw_sql(COMPLETE)).await?;
    transaction.commit().await?;
    connection.execute("ANALYZE").await?;
    Ok(())
}

async fn connection(target: &Store) -> Result<PgConnection, TransferError> {
    target.own_connection().await?.ok_or(TransferError::NoServer)
}

async fn require_known_tables(source: &Source) -> Result<(), TransferError> {
    let names = sqlx::query_scalar("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name");
    let names: Vec<String> = names.fetch_all(&source.database).await?;
    let is_known = |name: &String| LEFT.contains(&&**name) || TABLES.iter().any(|table| table.name == name);
    match names.iter().find(|name| !is_known(name)) {
        Some(name) => Err(TransferError::Unknown { what: format!("the table {name}") }),
        None => Ok(()),
    }
}

/// Continues the numbers of rows where the earlier database stopped, so that none is used again.
async fn set_sequences(source: &Source, target: &mut PgConnection) -> Result<(), TransferError> {
    let last = sqlx::query_as("SELECT name, seq FROM sqlite_sequence WHERE seq > 0");
    let last: Vec<(String, i64)> = last.fetch_all(&source.database).await?;
    for (table, seq) in last {
        let set = sqlx::query("SELECT setval(pg_get_serial_sequence($1, 'seq'), $2)").bind(&table).bind(seq);
        set.execute(&mut *target).await.map_err(StoreError::from)?;
    }
    Ok(())
}
