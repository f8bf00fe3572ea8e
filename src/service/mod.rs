//! The service: sessions and jobs over HTTP, each job in a supervised child process, SQLite as the single source of truth.
//!
//! Import order: `http` and `worker` use `queue`, `queue` uses `store`, `store` uses `settings`; `http` and `worker` do not
//! import each other.
//!
//! - [`settings`]: every setting of an operator, with its default
//! - [`failpoint`]: points at which the checks end the process or break a guarantee
//! - [`store`]: the data folder: database, uploads, results
//! - [`bodies`]: registered body models, which jobs request by name
//! - [`queue`]: the `jobs` table: accept, claim, finish, cancel, recover
//! - [`protocol`]: messages between the service and its child processes
//! - `child`: a child process: its order, its messages, its log, its end
//! - `leader`, `leadership`: what one of several processes must do, and which does it
//! - `memory`: memory limits of the child processes
//! - [`validation`]: reads an upload in a child process
//! - `exports`: formats that are added to a published result
//! - [`metrics`]: Prometheus metrics
//! - [`webhooks`]: HTTP calls that report the end of a job
//! - [`safety`]: backup, restore, verify
//! - `transfer` (feature `scale`): moves the service of a data folder to a PostgreSQL server and an object store
//! - `retention`: automatic removal of old jobs and sessions
//! - `worker`: runs one claimed job in one child process and records its outcome
//! - [`http`]: the HTTP API

pub mod bodies;
mod child;
mod exports;
pub mod failpoint;
pub mod http;
#[cfg(feature = "scale")]
mod leader;
mod leadership;
mod memory;
pub mod metrics;
pub mod protocol;
pub mod queue;
mod retention;
pub mod safety;
pub mod settings;
mod shared;
pub mod store;
#[cfg(feature = "scale")]
pub mod transfer;
pub mod validation;
pub mod webhooks;
mod worker;

pub use settings::Settings;

use failpoint::{failpoint, fault};
use http::HttpNetworks;
use leadership::Leadership;
use queue::Queue;
use shared::Shared;
use std::net::SocketAddr;
use std::sync::Arc;
use store::{Store, StoreError};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use webhooks::{NetworkError, Networks};

/// Reasons why the service does not start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Without API keys, requests from other machines are not accepted.
    #[error(
        "{listen}: without API keys only a loopback address can be served; create a key with `wandless key create`, or listen on 127.0.0.1"
    )]
    NotLoopback {
        /// The requested address.
        listen: SocketAddr,
    },
    /// The address is in use or not available on this machine.
    #[error("{listen}: {source}")]
    Listen {
        /// The requested address.
        listen: SocketAddr,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A network in the settings is malformed.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The data folder cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A running service.
pub struct Running {
    /// The address it listens on.
    pub address: SocketAddr,
    store: Store,
    draining: CancellationToken,
    tasks: Vec<JoinHandle<()>>,
}

/// Opens and recovers the data folder, then serves requests and runs jobs until [`Running::stop`].
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
    let networks = Arc::new(Networks::parse("webhooks.allowed_networks", &settings.webhooks.allowed_networks)?);
    let proxies = Arc::new(Networks::parse("limits.trusted_proxies", &settings.limits.trusted_proxies)?);
    let store = Store::open_for(&settings).await?.with_min_free_bytes(settings.limits.min_free_bytes);
    if !listen.ip().is_loopback() && !store::keys::any(&store).await? {
        return Err(ServeError::NotLoopback { listen });
    }
    let queue = Queue::new(store.clone()).with_class(settings.worker.class);
    let recovered = queue::recovery::recover(&queue).await?;
    tracing::info!(boot = store.boot, ?recovered, "data folder opened");
    let cannot_listen = |source| ServeError::Listen { listen, source };
    let listener = TcpListener::bind(listen).await.map_err(cannot_listen)?;
    let address = listener.local_addr().map_err(cannot_listen)?;

    let draining = CancellationToken::new();
    let leadership = Leadership::new(!store.is_shared());
    let settings = Arc::new(settings);
    let shared = Shared { store, queue, settings, metrics: Arc::default(), leadership, draining: draining.clone() };
    let http_networks = HttpNetworks { webhooks: networks.clone(), proxies };
    let mut tasks = vec![
        tokio::spawn(http::serve(shared.clone(), http_networks, listener)),
        tokio::spawn(webhooks::run(shared.clone(), networks)),
        tokio::spawn(retention::run(shared.clone())),
    ];
    if !shared.store.is_shared() {
        tasks.push(tokio::spawn(store::pages::run_checkpointer(shared.store.clone(), draining.clone())));
    }
    #[cfg(feature = "scale")]
    tasks.extend(shared_tasks(&shared));
    if shared.settings.role.works() {
        for _ in 0..shared.settings.jobs.concurrent {
            tasks.push(tokio::spawn(worker::run(shared.clone())));
        }
    }
    Ok(Running { address, store: shared.store, draining, tasks })
}

/// Tasks of a process that shares its database.
#[cfg(feature = "scale")]
fn shared_tasks(shared: &Shared) -> Vec<JoinHandle<()>> {
    if !shared.store.is_shared() {
        return Vec::new();
    }
    vec![
        tokio::spawn(leader::run(shared.clone())),
        tokio::spawn(queue::wake::listen(shared.queue.clone(), shared.draining.clone())),
        tokio::spawn(queue::wake::watch(shared.queue.clone(), shared.draining.clone())),
    ]
}

impl Running {
    /// Stops the service: accepts no new connections, finishes open requests, returns running jobs to the queue.
    pub async fn stop(self) {
        self.draining.cancel();
        for task in self.tasks {
            if let Err(error) = task.await {
                tracing::error!(%error, "a task of the service had ended early");
            }
        }
        failpoint("stop.drained");
        self.store.close().await;
        failpoint("stop.closed");
    }
}
