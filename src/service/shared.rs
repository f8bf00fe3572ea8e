//! State that all parts of the service share.

use super::leadership::Leadership;
use super::metrics::Metrics;
use super::queue::Queue;
use super::settings::Settings;
use super::store::Store;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// Handles of one running service; clones share them.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) store: Store,
    pub(super) queue: Queue,
    pub(super) settings: Arc<Settings>,
    pub(super) metrics: Arc<Metrics>,
    /// Whether this process does what one of several must.
    pub(super) leadership: Leadership,
    /// Cancelled when the service begins to stop.
    pub(super) draining: CancellationToken,
}
