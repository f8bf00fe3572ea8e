//! The open connections: how long each may be idle, and which one is closed when there are too many.
//!
//! A connection has *access* from its first admitted request on: with a valid key, or while no key is required. A client
//! without access must not keep other clients out: its connections are closed soon after they become idle, it has a limited
//! number of them, and they are the first to be closed when all slots are taken.

use crate::service::failpoint::fault;
use crate::service::settings::RequestLimits;
use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

/// A connection that was idle for less is not closed in favour of others: its request may be on the way.
const GRACE: Duration = Duration::from_secs(1);
/// An answer to a client without access that takes longer than this is held up by the client.
const SLOW_ANSWER: Duration = Duration::from_secs(5);
/// Time between two searches for connections that were idle for too long.
const SWEEP_INTERVAL: Duration = Duration::from_secs(1);

/// All open connections of the service.
pub(super) struct Connections {
    limits: RequestLimits,
    /// Most connections at the same time.
    max: usize,
    open: Mutex<BTreeMap<u64, Open>>,
    /// A connection has ended or become idle.
    freed: Notify,
}

/// State of one connection.
struct Open {
    network: IpAddr,
    /// A trusted proxy: its connections carry the requests of many clients, so they count as admitted.
    is_proxy: bool,
    has_access: bool,
    /// Whether a complete request head has arrived.
    has_asked: bool,
    /// Requests without a complete answer.
    n_pending: usize,
    /// When it became busy or idle.
    since: Instant,
    close: CancellationToken,
}

/// One open connection, for its own task and the handlers of its requests.
#[derive(Clone)]
pub(super) struct Connection {
    id: u64,
    connections: Arc<Connections>,
    /// Cancelled when the connection is to be closed.
    pub(super) close: CancellationToken,
}

/// A request on a connection, until the last byte of its answer was taken.
pub(super) struct Pending(Connection);

impl Connections {
    /// `max`: most connections at the same time.
    pub(super) fn new(limits: RequestLimits, max: usize) -> Arc<Self> {
        Arc::new(Self { limits, max, open: Mutex::default(), freed: Notify::new() })
    }

    /// Waits until the connection number `id` from `address` has a slot. If all slots are taken, the connection that was idle
    /// the longest is closed.
    pub(super) async fn enter(self: &Arc<Self>, id: u64, address: IpAddr, is_proxy: bool) -> Connection {
        while !self.makes_room(Instant::now()) {
            // Every connection is busy, or idle for a moment only.
            let _ = tokio::time::timeout(GRACE, self.freed.notified()).await;
        }
        let close = CancellationToken::new();
        self.open().insert(id, Open::new(network(address), is_proxy, close.clone()));
        Connection { id, connections: self.clone(), close }
    }

    /// Closes connections that are idle for too long or too many for their network, until dropped.
    pub(super) async fn sweep(&self) {
        loop {
            tokio::time::sleep(SWEEP_INTERVAL).await;
            self.close_superfluous(Instant::now());
        }
    }

    /// Whether a slot is free, if necessary after a connection was closed.
    fn makes_room(&self, now: Instant) -> bool {
        let mut open = self.open();
        if open.len() < self.max {
            return true;
        }
        if fault("idlers.kept") {
            return false;
        }
        let candidates = open.iter().filter(|(_, one)| one.can_be_closed(now));
        let Some(victim) = candidates.min_by_key(|(_, one)| one.rank()).map(|(id, _)| *id) else { return false };
        tracing::debug!(
            max = self.max,
            "all connection slots are taken; the connection that was idle the longest is closed"
        );
        close(&mut open, victim);
        true
    }

    fn close_superfluous(&self, now: Instant) {
        if fault("idlers.kept") {
            return;
        }
        let mut open = self.open();
        let overdue = open.iter().filter(|(_, one)| one.is_idle() && now - one.since >= self.idle_limit(one));
        let mut superfluous: Vec<u64> = overdue.map(|(id, _)| *id).collect();
        let mut by_network: BTreeMap<IpAddr, Vec<u64>> = BTreeMap::new();
        for (id, one) in open.iter().filter(|(_, one)| !one.has_access) {
            by_network.entry(one.network).or_default().push(*id);
        }
        for ids in by_network.into_values() {
            let excess = ids.len().saturating_sub(self.limits.max_connections_per_address);
            let mut ids: Vec<u64> = ids.into_iter().filter(|id| open[id].can_be_closed(now)).collect();
            ids.sort_by_key(|id| open[id].rank());
            superfluous.extend(ids.into_iter().take(excess));
        }
        for id in superfluous {
            close(&mut open, id);
        }
    }

    fn idle_limit(&self, one: &Open) -> Duration {
        match (one.has_asked, one.has_access) {
            (false, _) => self.limits.header_timeout,
            (true, false) => self.limits.keep_alive_without_key,
            (true, true) => self.limits.keep_alive,
        }
    }

    fn open(&self) -> MutexGuard<'_, BTreeMap<u64, Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state of a connection, unless it was closed.
    fn change(&self, id: u64, change: impl FnOnce(&mut Open)) {
        if let Some(one) = self.open().get_mut(&id) {
            change(one);
        }
    }
}

/// Frees the slot at once; the task of the connection ends a moment later.
fn close(open: &mut BTreeMap<u64, Open>, id: u64) {
    if let Some(one) = open.remove(&id) {
        one.close.cancel();
    }
}

impl Open {
    fn new(network: IpAddr, is_proxy: bool, close: CancellationToken) -> Self {
        Self { network, is_proxy, has_access: is_proxy, has_asked: false, n_pending: 0, since: Instant::now(), close }
    }

    fn is_idle(&self) -> bool {
        self.n_pending == 0
    }

    fn can_be_closed(&self, now: Instant) -> bool {
        let age = now - self.since;
        if self.is_idle() { age >= GRACE } else { !self.has_access && age >= SLOW_ANSWER }
    }

    /// Order of closing: idle without access, idle with access, busy without access; the longest time first.
    fn rank(&self) -> (u8, Instant) {
        let class = match (self.is_idle(), self.has_access) {
            (true, false) => 0,
            (true, true) => 1,
            (false, _) => 2,
        };
        (class, self.since)
    }
}

impl Connection {
    /// Notes a request; the connection is busy until the returned value is dropped.
    pub(super) fn begin_request(&self) -> Pending {
        self.connections.change(self.id, |one| {
            one.has_asked = true;
            one.n_pending += 1;
            one.since = Instant::now();
        });
        Pending(self.clone())
    }

    /// Notes whether the last request with access control was admitted.
    pub(super) fn note_access(&self, has_access: bool) {
        self.connections.change(self.id, |one| one.has_access = has_access || one.is_proxy);
    }

    /// Frees the slot.
    pub(super) fn end(&self) {
        self.connections.open().remove(&self.id);
        self.connections.freed.notify_one();
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        let Self(Connection { id, connections, .. }) = self;
        connections.change(*id, |one| {
            one.n_pending -= 1;
            one.since = Instant::now();
        });
        connections.freed.notify_one();
    }
}

/// The address, or for IPv6 its /64: one client has all addresses of it.
pub(super) fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64)),
        v4 => v4,
    }
}

#[cfg(test)]
mod tests;
