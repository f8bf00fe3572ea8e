//! The service: sessions and jobs over HTTP, each job in a supervised child process, SQLite as the one truth.
//!
//! Inside: `http` and `worker` stand on `queue`, that on `store`, that on `settings`; `http` and `worker` never meet.
//!
//! - [`settings`]: what an operator may set
//! - [`store`]: the data folder: database, uploads, results
//! - [`bodies`]: body models that jobs may ask for by name
//! - [`queue`]: the `jobs` table: accept, claim, finish, cancel, recover
//! - [`protocol`]: what the service and a job's child say to each other
//! - `worker`: one claimed job -> one child process -> one recorded end
//! - `http`: every route

pub mod bodies;
mod http;
pub mod protocol;
pub mod queue;
pub mod settings;
pub mod store;
mod worker;

pub use settings::Settings;

use queue::Queue;
use std::net::SocketAddr;
use std::sync::Arc;
use store::{Store, StoreError};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Why the service does not start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Nobody is asked for a key yet, so nobody from outside may come.
    #[error(
        "{listen}: only a loopback address can be served as long as there are no API keys; listen on 127.0.0.1 and put a proxy that asks for a password before it"
    )]
    NotLoopback {
        /// The address asked for.
        listen: SocketAddr,
    },
    /// The address is taken or not ours.
    #[error("{listen}: {source}")]
    Listen {
        /// The address asked for.
        listen: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The data folder cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A service at work.
pub struct Running {
    /// Where it listens.
    pub address: SocketAddr,
    store: Store,
    draining: CancellationToken,
    tasks: Vec<JoinHandle<()>>,
}

/// Opens and mends the data folder, then serves and works until [`Running::stop`].
///
/// Must be called on a multi-threaded runtime that outlives the service.
///
/// # Errors
/// [`ServeError`].
pub async fn start(settings: Settings) -> Result<Running, ServeError> {
    let listen = settings.listen;
    if !listen.ip().is_loopback() {
        return Err(ServeError::NotLoopback { listen });
    }
    let store = Store::open(&settings.data).await?;
    let queue = Queue::new(store.clone());
    let recovered = queue::recovery::recover(&queue).await?;
    tracing::info!(boot = store.boot, ?recovered, "data folder opened");
    let cannot_listen = |source| ServeError::Listen { listen, source };
    let listener = TcpListener::bind(listen).await.map_err(cannot_listen)?;
    let address = listener.local_addr().map_err(cannot_listen)?;

    let settings = Arc::new(settings);
    let draining = CancellationToken::new();
    let app = http::App::new(store.clone(), queue.clone(), settings.clone(), draining.clone());
    let mut tasks = vec![tokio::spawn(http::serve(app, listener))];
    for _ in 0..settings.jobs.concurrent {
        tasks.push(tokio::spawn(worker::run(store.clone(), queue.clone(), settings.clone(), draining.clone())));
    }
    Ok(Running { address, store, draining, tasks })
}

impl Running {
    /// Stops in order: no new connections, open requests end, running jobs go back to the queue.
    pub async fn stop(self) {
        self.draining.cancel();
        for task in self.tasks {
            if let Err(error) = task.await {
                tracing::error!(%error, "a part of the service had ended before");
            }
        }
        self.store.close().await;
    }
}
