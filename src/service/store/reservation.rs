//! Uploads count before their last byte: the bytes that they have announced are not free, and their bytes count towards the
//! tenant's quota although no row has them yet. Otherwise uploads that are received at the same time exceed both.

use super::database::Store;
use super::error::StoreError;
use super::sessions::AddError;
use super::tenants::{self, Tenant};
use crate::service::failpoint::fault;

/// Space of one upload until its row exists; released on drop.
#[derive(Debug)]
pub struct Reservation {
    store: Store,
    tenant: Tenant,
    /// Bytes that the tenant had stored at the beginning, and its quota.
    stored: i64,
    max_bytes: i64,
    /// Bytes that count towards the quota.
    counted: u64,
    /// Bytes received.
    received: u64,
    /// Announced bytes that have not arrived.
    unwritten: u64,
}

impl Store {
    /// Returns the store with the rule that `bytes` of the disk stay free.
    #[must_use]
    pub fn with_min_free_bytes(mut self, bytes: u64) -> Self {
        self.space.min_free_bytes = bytes;
        self
    }

    /// Checks that the disk has its minimum of free bytes.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], or when the system does not report the free bytes.
    pub fn require_space(&self) -> Result<(), StoreError> {
        self.require_free(0, 0)
    }

    /// Checks that the disk has its minimum besides `bytes` of an upload and what other uploads have `announced`.
    fn require_free(&self, bytes: u64, announced: u64) -> Result<(), StoreError> {
        let free = self.folders.free_bytes();
        let free = free.map_err(|source| StoreError::Folder { path: self.folders.database(), source })?;
        let min = self.space.min_free_bytes;
        if free < min.saturating_add(announced).saturating_add(bytes) && !fault("disk.unwatched") {
            return Err(StoreError::DiskFull { free, announced: announced.saturating_add(bytes), min });
        }
        Ok(())
    }

    /// Reserves the space of an upload. `announced`: bytes that will arrive, 0 if unknown; `counts`: whether all of them are
    /// content, which counts towards the quota `max_bytes`.
    ///
    /// # Errors
    /// [`AddError`] for a full disk, a full quota or a failed store.
    pub async fn reserve(
        &self,
        tenant: &Tenant,
        max_bytes: i64,
        announced: u64,
        counts: bool,
    ) -> Result<Reservation, AddError> {
        let announced = if fault("arrivals.uncounted") { 0 } else { announced };
        let stored = tenants::stored_bytes(self, tenant).await?;
        if stored >= max_bytes && !fault("quota.none") {
            return Err(AddError::QuotaExceeded { stored, max: max_bytes });
        }
        let (store, tenant) = (self.clone(), tenant.clone());
        let mut reservation = Reservation { store, tenant, stored, max_bytes, counted: 0, received: 0, unwritten: 0 };
        reservation.count(if counts { announced } else { 0 })?;
        let mut arriving = self.space.arriving(); // locked, so that two uploads cannot take the same space
        self.require_free(announced, arriving.unwritten)?;
        arriving.unwritten += announced;
        reservation.unwritten = announced;
        Ok(reservation)
    }
}

impl Reservation {
    /// Notes `bytes` that have arrived and will now be written.
    ///
    /// # Errors
    /// [`AddError`] when the disk or the quota is full.
    pub fn note(&mut self, bytes: u64) -> Result<(), AddError> {
        self.received += bytes;
        self.count(self.received.saturating_sub(self.counted))?;
        let mut arriving = self.store.space.arriving();
        let announced = bytes.min(self.unwritten);
        self.store.require_free(bytes - announced, arriving.unwritten)?;
        arriving.unwritten -= announced;
        self.unwritten -= announced;
        Ok(())
    }

    /// Counts further bytes towards the quota.
    fn count(&mut self, bytes: u64) -> Result<(), AddError> {
        if bytes == 0 || fault("arrivals.uncounted") {
            return Ok(());
        }
        let mut arriving = self.store.space.arriving();
        let all = arriving.by_tenant.entry(self.tenant.name().to_owned()).or_default();
        let used = self.stored.saturating_add_unsigned(*all);
        if used.saturating_add_unsigned(bytes) > self.max_bytes && !fault("quota.none") {
            return Err(AddError::QuotaExceeded { stored: used, max: self.max_bytes });
        }
        *all += bytes;
        self.counted += bytes;
        Ok(())
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut arriving = self.store.space.arriving();
        arriving.unwritten -= self.unwritten;
        if let Some(all) = arriving.by_tenant.get_mut(self.tenant.name()) {
            *all -= self.counted;
            if *all == 0 {
                arriving.by_tenant.remove(self.tenant.name());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::store::test_support;

    async fn store(folder: &tempfile::TempDir) -> (Store, Tenant) {
        (test_support::open(folder.path()).await, Tenant::default_tenant())
    }

    #[tokio::test]
    async fn announced_bytes_count_towards_the_quota() {
        let folder = tempfile::tempdir().unwrap();
        let (store, tenant) = store(&folder).await;
        let first = store.reserve(&tenant, 100, 60, true).await.unwrap();
        let full = store.reserve(&tenant, 100, 41, true).await.unwrap_err();
        assert!(matches!(full, AddError::QuotaExceeded { stored: 60, max: 100 }));
        let other = Tenant::parse("other").unwrap();
        assert!(store.reserve(&other, 100, 100, true).await.is_ok(), "each tenant has its own quota");
        drop(first);
        assert!(store.reserve(&tenant, 100, 100, true).await.is_ok());
    }

    #[tokio::test]
    async fn bytes_without_announcement_count_as_they_arrive() {
        let folder = tempfile::tempdir().unwrap();
        let (store, tenant) = store(&folder).await;
        let mut first = store.reserve(&tenant, 100, 0, true).await.unwrap();
        let mut form = store.reserve(&tenant, 100, 500, false).await.unwrap();
        first.note(60).unwrap();
        form.note(40).unwrap();
        assert!(matches!(form.note(1), Err(AddError::QuotaExceeded { stored: 100, .. })));
        drop(first);
        form.note(1).unwrap();
    }

    #[tokio::test]
    async fn announced_bytes_are_not_free() {
        let folder = tempfile::tempdir().unwrap();
        let (store, tenant) = store(&folder).await;
        let free = store.folders.free_bytes().unwrap();
        let margin = free / 10; // others write to the disk during the test
        let store = store.with_min_free_bytes(margin);
        store.require_space().unwrap();
        let large = store.reserve(&tenant, i64::MAX, free / 2, true).await.unwrap();
        let second = store.reserve(&tenant, i64::MAX, free / 2, true).await;
        assert!(matches!(second, Err(AddError::Store(StoreError::DiskFull { .. }))), "{second:?}");
        drop(large);
        assert!(store.reserve(&tenant, i64::MAX, free / 2, true).await.is_ok());
        let error = store.with_min_free_bytes(u64::MAX).require_space().unwrap_err();
        assert!(error.is_disk_full());
    }
}
