//! State that every HTTP handler can use.

use super::error::Problem;
use super::inspections::Inspections;
use super::rate_limit::RateLimiter;
use super::turns::Turns;
use super::verified::VerifiedFiles;
use crate::service::leadership::Leadership;
use crate::service::metrics::Metrics;
use crate::service::queue::Queue;
use crate::service::settings::Settings;
use crate::service::shared::Shared;
use crate::service::store::Store;
use crate::service::webhooks::Networks;
use std::sync::Arc;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

/// Handles and limits of the HTTP API; clones share them.
#[derive(Clone)]
pub(super) struct App {
    pub(super) store: Store,
    pub(super) queue: Queue,
    pub(super) settings: Arc<Settings>,
    pub(super) metrics: Arc<Metrics>,
    /// Cancelled when the service begins to stop.
    pub(super) draining: CancellationToken,
    /// Whether this process does what one of several must.
    pub(super) leadership: Leadership,
    /// Private networks that webhooks may call.
    pub(super) allowed_networks: Arc<Networks>,
    /// Proxies whose header names the client.
    pub(super) trusted_proxies: Arc<Networks>,
    /// Limits the number of uploads that are held in memory at the same time.
    pub(super) validations: Arc<Semaphore>,
    /// Limits the number of lists that one tenant reads at the same time.
    pub(super) lists: Arc<Turns>,
    /// Limits the number of archives that are written at the same time: each holds a thread while its client reads.
    pub(super) archives: Arc<Semaphore>,
    /// Formats are added to one result at a time: each takes a core and the memory of a result.
    pub(super) exporting: Arc<Semaphore>,
    /// Inspections of sessions: the finished ones and the turns of the others.
    pub(super) inspections: Arc<Inspections>,
    /// Published files whose digest was compared.
    pub(super) verified: Arc<VerifiedFiles>,
    /// Rate limit of each tenant.
    pub(super) tenant_rates: Arc<RateLimiter>,
    /// Rate limit of requests without a valid key, for each address.
    pub(super) bad_key_rates: Arc<RateLimiter>,
}

/// Networks of the settings.
#[derive(Debug, Clone)]
pub(in crate::service) struct HttpNetworks {
    /// Private networks that webhooks may call.
    pub(in crate::service) webhooks: Arc<Networks>,
    /// Trusted proxies.
    pub(in crate::service) proxies: Arc<Networks>,
}

/// Uploads validated at the same time: each may hold a session of some hundred megabytes.
const VALIDATIONS: usize = 2;

/// Archives written at the same time.
const ARCHIVES: usize = 8;

/// Lists of one tenant at the same time: each can hold some megabytes until its client has read it.
const LISTS_PER_TENANT: usize = 4;

impl App {
    pub(super) fn new(shared: Shared, networks: HttpNetworks) -> Self {
        let Shared { store, queue, settings, metrics, leadership, draining } = shared;
        let tenant_rates = Arc::new(RateLimiter::new(settings.tenants.requests_per_s));
        let bad_key_rates = Arc::new(RateLimiter::new(settings.limits.bad_keys_per_s));
        let validations = Arc::new(Semaphore::new(VALIDATIONS));
        let lists = Arc::new(Turns::new(LISTS_PER_TENANT));
        Self {
            store,
            queue,
            settings,
            metrics,
            draining,
            leadership,
            allowed_networks: networks.webhooks,
            trusted_proxies: networks.proxies,
            validations,
            lists,
            archives: Arc::new(Semaphore::new(ARCHIVES)),
            exporting: Arc::new(Semaphore::new(1)),
            inspections: Arc::default(),
            verified: Arc::default(),
            tenant_rates,
            bad_key_rates,
        }
    }

    /// Returns the problem 507 while the disk is nearly full.
    pub(super) fn require_disk(&self) -> Result<(), Problem> {
        Ok(self.store.require_space()?)
    }
}
