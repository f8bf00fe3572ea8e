//! The PostgreSQL server that the processes of a service share.

mod schema;
pub(super) mod server;

use super::blobs::Blobs;
use super::database::{Engine, Store};
use super::error::StoreError;
use super::folders::Folders;
use super::space::Space;
use super::sql::{SqlOptions, SqlPool, SqlPoolOptions};
use crate::service::settings::StoreSettings;
pub(super) use schema::newest as newest_migration;
use server::Server;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgListener, PgPoolOptions};
use sqlx::{ConnectOptions, Connection, Executor};
use std::time::Duration;

/// Statements need functions and planner behaviour of this release.
const OLDEST_SERVER: i64 = 15;

/// Longest wait for a free connection; a request is answered 503 then.
const PATIENCE: Duration = Duration::from_secs(5);

/// A connection that was idle for less is used without asking the server whether it is still there: the pool asked when it was put back.
const UNTESTED: Duration = Duration::from_secs(1);

/// Settings of every connection. A process that stops inside a transaction loses its locks after four seconds, before those that wait for
/// them give up. No statement of a request takes longer than thirty.
const SESSION: &str =
    "SET idle_in_transaction_session_timeout = '4s'; SET lock_timeout = '5s'; SET statement_timeout = '30s';
                       SET client_min_messages = 'warning'; SET timezone = 'UTC'";

impl Store {
    /// A connection of its own that listens to a channel; `None` with SQLite.
    ///
    /// # Errors
    /// When the server does not answer.
    pub(crate) async fn listener(&self, channel: &str) -> Result<Option<PgListener>, StoreError> {
        let Engine::Postgres(server) = &self.engine else { return Ok(None) };
        let pool = PgPoolOptions::new().max_connections(1).connect_lazy_with(server.options.clone());
        let mut listener = PgListener::connect_with(&pool).await?;
        listener.eager_reconnect(false);
        listener.listen(channel).await?;
        Ok(Some(listener))
    }

    /// A connection of its own; `None` with SQLite.
    ///
    /// # Errors
    /// When the server does not answer.
    pub(crate) async fn own_connection(&self) -> Result<Option<PgConnection>, StoreError> {
        let Engine::Postgres(server) = &self.engine else { return Ok(None) };
        let mut connection = server.options.connect().await?;
        connection.execute(sqlx::raw_sql(SESSION)).await?;
        Ok(Some(connection))
    }
}

/// Connects to the server and runs the migrations that the database does not have yet.
///
/// # Errors
/// When the URL is malformed, the server does not answer or is too old, a migration fails, or the database needs a newer release. No message has the URL, which can hold
/// a password.
pub(super) async fn open(settings: &StoreSettings, folders: Folders) -> Result<Store, StoreError> {
    let options = parsed(&settings.url)?;
    let any = settings.url.parse::<SqlOptions>().map_err(|_| StoreError::StoreUrl)?;
    let pool = connect(any, settings.connections).await?;
    require_server(&pool).await?;
    schema::migrate(&options).await?;
    Ok(Store {
        writer: pool.clone(),
        progress_writer: pool.clone(),
        readers: pool,
        engine: Engine::Postgres(Box::new(Server { options: options.application_name("wandless") })),
        space: Space::default(),
        blobs: Blobs::Folder(folders.clone()),
        folders,
        boot: uuid::Uuid::new_v4().simple().to_string(),
    })
}

fn parsed(url: &str) -> Result<PgConnectOptions, StoreError> {
    let is_postgres = ["postgres://", "postgresql://"].iter().any(|scheme| url.starts_with(scheme));
    is_postgres.then(|| url.parse().ok()).flatten().ok_or(StoreError::StoreUrl)
}

async fn connect(options: SqlOptions, connections: u32) -> Result<SqlPool, StoreError> {
    sqlx::any::install_default_drivers();
    let pool = SqlPoolOptions::new().max_connections(connections).acquire_timeout(PATIENCE).test_before_acquire(false);
    let pool = pool.before_acquire(|connection, metadata| {
        Box::pin(async move {
            if metadata.idle_for >= UNTESTED {
                connection.ping().await?;
            }
            Ok(true)
        })
    });
    let pool = pool.after_connect(|connection, _| {
        Box::pin(async move { connection.execute(sqlx::raw_sql(SESSION)).await.map(drop) })
    });
    Ok(pool.connect_with(options).await?)
}

async fn require_server(pool: &SqlPool) -> Result<(), StoreError> {
    let version = "SELECT CAST(current_setting('server_version_num') AS BIGINT) / 10000";
    let found: i64 = sqlx::query_scalar(version).fetch_one(pool).await?;
    if found < OLDEST_SERVER {
        return Err(StoreError::OldPostgres { found });
    }
    Ok(())
}
