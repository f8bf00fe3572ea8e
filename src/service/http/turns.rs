//! Requests of one kind that each tenant can make at the same time; further ones wait for their turn.

use super::error::Problem;
use crate::service::store::Tenant;
use axum::http::{HeaderValue, StatusCode, header};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Longest wait for a turn; more clients of one tenant than it serves are refused.
const PATIENCE: Duration = Duration::from_secs(20);

/// Turns by tenant. Tenants are created by the operator, so their number is bounded.
#[derive(Debug)]
pub(super) struct Turns {
    at_once: usize,
    patience: Duration,
    by_tenant: Mutex<BTreeMap<String, Arc<Semaphore>>>,
}

impl Turns {
    /// Gives each tenant `at_once` turns at the same time.
    pub(super) fn new(at_once: usize) -> Self {
        Self { at_once, patience: PATIENCE, by_tenant: Mutex::default() }
    }

    /// The same with another longest wait.
    pub(super) fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// Waits for a turn; it ends when the permit is dropped.
    pub(super) async fn take(&self, tenant: &Tenant) -> Result<OwnedSemaphorePermit, Problem> {
        let turns = {
            let mut by_tenant = self.by_tenant.lock().unwrap_or_else(PoisonError::into_inner);
            by_tenant.entry(tenant.name().to_owned()).or_insert_with(|| Arc::new(Semaphore::new(self.at_once))).clone()
        };
        match tokio::time::timeout(self.patience, turns.acquire_owned()).await {
            Ok(permit) => permit.map_err(Problem::internal),
            Err(_) => Err(Problem::new(
                StatusCode::TOO_MANY_REQUESTS,
                "too_many_requests",
                format!(
                    "{} such requests of the tenant were unfinished for {} s",
                    self.at_once,
                    self.patience.as_secs()
                ),
                "read the answers to their end before asking again",
            )
            .with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn tenants_wait_for_their_own_turns_only() {
        let turns = Turns::new(1).with_patience(Duration::from_millis(20));
        let [a, b] = ["a", "b"].map(|name| Tenant::parse(name).unwrap());
        let held = turns.take(&a).await.unwrap();
        assert!(turns.take(&b).await.is_ok());
        assert_eq!(turns.take(&a).await.unwrap_err().code(), "too_many_requests");
        drop(held);
        assert!(turns.take(&a).await.is_ok());
    }
}
