//! The service: sessions and jobs over HTTP, each job in a supervised child process, SQLite as the one truth.
//!
//! Inside: `http` and `worker` stand on `queue`, that on `store`, that on `settings`; `http` and `worker` never meet.
//!
//! - [`settings`]: what an operator may set
//! - [`failpoint`]: where the checks may end the process or break a promise
//! - [`store`]: the data folder: database, uploads, results
//! - [`bodies`]: body models that jobs may ask for by name
//! - [`queue`]: the `jobs` table: accept, claim, finish, cancel, recover
//! - [`protocol`]: what the service and a job's child say to each other
//! - [`metrics`]: what is counted for whoever watches
//! - [`webhooks`]: the calls that tell of a job's end
//! - [`safety`]: backup, restore, verify
//! - `retention`: what is removed by itself
//! - `worker`: one claimed job -> one child process -> one recorded end
//! - [`http`]: every route

pub mod bodies;
pub mod failpoint;
pub mod http;
mod memory;
pub mod metrics;
pub mod protocol;
pub mod queue;
mod retention;
pub mod safety;
pub mod settings;
pub mod store;
pub mod webhooks;
mod worker;

pub use settings::Settings;

use failpoint::{failpoint, fault};
use metrics::Metrics;
use queue::Queue;
use std::net::SocketAddr;
use std::sync::Arc;
use store::{Store, StoreError};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use webhooks::{NetworkError, Networks};

/// Why the service does not start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Nobody is asked for a key yet, so nobody from outside may come.
    #[error(
        "{listen}: only a loopback address can be served as long as there are no API keys; make one with `wandless key create`, or listen on 127.0.0.1"
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
    /// A network in the settings is none.
    #[error(transparent)]
    Network(#[from] NetworkError),
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

/// What all parts of the service use.
#[derive(Clone)]
struct Shared {
    store: Store,
    queue: Queue,
    settings: Arc<Settings>,
    metrics: Arc<Metrics>,
    draining: CancellationToken,
}

/// Opens and mends the data folder, then serves and works until [`Running::stop`].
///
/// Must be called on a multi-threaded runtime that outlives the service.
///
/// # Errors
/// [`ServeError`].
pub async fn start(settings: Settings) -> Result<Running, ServeError> {
    let listen = settings.listen;
    if fault("start.slow") {
        tokio::time::sleep(std::time::Duration::from_secs(3)).await;
    }
    let networks = Arc::new(Networks::parse(&settings.webhooks.allowed_networks)?);
    let store = Store::open(&settings.data).await?;
    if !listen.ip().is_loopback() && !store::keys::any(&store).await? {
        return Err(ServeError::NotLoopback { listen });
    }
    let queue = Queue::new(store.clone());
    let recovered = queue::recovery::recover(&queue).await?;
    tracing::info!(boot = store.boot, ?recovered, "data folder opened");
    let cannot_listen = |source| ServeError::Listen { listen, source };
    let listener = TcpListener::bind(listen).await.map_err(cannot_listen)?;
    let address = listener.local_addr().map_err(cannot_listen)?;

    let draining = CancellationToken::new();
    let shared =
        Shared { store, queue, settings: Arc::new(settings), metrics: Arc::default(), draining: draining.clone() };
    let mut tasks = vec![
        tokio::spawn(http::serve(http::App::new(shared.clone(), networks.clone()), listener)),
        tokio::spawn(webhooks::run(shared.clone(), networks)),
        tokio::spawn(retention::run(shared.clone())),
        tokio::spawn(store::pages::run_checkpointer(shared.store.clone(), draining.clone())),
    ];
    for _ in 0..shared.settings.jobs.concurrent {
        tasks.push(tokio::spawn(worker::run(shared.clone())));
    }
    Ok(Running { address, store: shared.store, draining, tasks })
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
        failpoint("stop.drained");
        self.store.close().await;
        failpoint("stop.closed");
    }
}
