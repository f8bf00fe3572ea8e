//! Tenants: the owners of sessions and jobs, their disk usage and their webhook secrets.

use super::database::{Store, WriteTransaction};
use super::error::StoreError;
use super::random::random_bytes;
use base64::Engine;
use serde::Serialize;

/// Name of a tenant: 1 to 64 letters, digits, `-`, `_` and `.`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, sqlx::Type)]
#[serde(transparent)]
#[sqlx(transparent)]
pub struct Tenant(String);

/// Maximal length of a name, characters.
const MAX_NAME: usize = 64;

impl Tenant {
    /// The only tenant of a service without API keys.
    pub fn default_tenant() -> Self {
        Self("default".to_owned())
    }

    /// Parses a name; `None` if it is invalid.
    pub fn parse(name: &str) -> Option<Self> {
        let is_name_char = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let is_name = (1..=MAX_NAME).contains(&name.len()) && name.chars().all(is_name_char);
        is_name.then(|| Self(name.to_owned()))
    }

    /// The name as text.
    pub fn name(&self) -> &str {
        &self.0
    }
}

/// Returns the bytes of a tenant's uploads and results.
///
/// # Errors
/// When the store fails.
pub async fn stored_bytes(store: &Store, tenant: &Tenant) -> Result<i64, StoreError> {
    Ok(sqlx::query_scalar(STORED_BYTES).bind(tenant.name()).fetch_one(store.read()).await?)
}

/// Same as [`stored_bytes`], inside a transaction.
///
/// # Errors
/// When the store fails.
pub(crate) async fn stored_bytes_in(transaction: &mut WriteTransaction, tenant: &Tenant) -> Result<i64, StoreError> {
    Ok(sqlx::query_scalar(STORED_BYTES).bind(tenant.name()).fetch_one(&mut **transaction).await?)
}

/// The running total, which triggers keep.
const STORED_BYTES: &str = "SELECT coalesce((SELECT stored_bytes FROM tenants WHERE name = $1), 0)";

/// Inserts the row of a tenant unless it exists.
pub(crate) async fn insert_if_missing(transaction: &mut WriteTransaction, tenant: &Tenant) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO tenants (name) VALUES ($1) ON CONFLICT (name) DO NOTHING")
        .bind(tenant.name())
        .execute(&mut **transaction)
        .await?;
    Ok(())
}

/// Locks the row of a tenant until the transaction ends, so that what its limits allow and which sessions it has cannot change in
/// between. A write transaction of SQLite locks the whole database anyway. A transaction with this lock waits for no job's row.
pub(crate) async fn lock(store: &Store, transaction: &mut WriteTransaction, tenant: &Tenant) -> Result<(), StoreError> {
    if store.is_shared() {
        insert_if_missing(transaction, tenant).await?;
        let lock = sqlx::query("SELECT name FROM tenants WHERE name = $1 FOR UPDATE").bind(tenant.name());
        lock.execute(&mut **transaction).await?;
    }
    Ok(())
}

/// Prefix of a webhook secret (Standard Webhooks).
const SECRET_PREFIX: &str = "whsec_";

/// Time for which a replaced webhook secret still signs, s: a day, so that receivers can change over at any hour.
const OVERLAP_S: i64 = 24 * 3600;

/// Returns the secret that signs a tenant's webhooks, `whsec_` and 256 random bits in base64; created on first use.
///
/// # Errors
/// When the store or the system's source of randomness fails.
pub async fn webhook_secret(store: &Store, tenant: &Tenant) -> Result<String, StoreError> {
    let known: Option<Option<String>> = sqlx::query_scalar("SELECT webhook_secret FROM tenants WHERE name = $1")
        .bind(tenant.name())
        .fetch_optional(store.read())
        .await?;
    if let Some(Some(secret)) = known {
        return Ok(secret);
    }
    let set =
        "UPDATE tenants SET webhook_secret = coalesce(webhook_secret, $1) WHERE name = $2 RETURNING webhook_secret";
    set_secret(store, tenant, set).await
}

/// Replaces the secret of a tenant by a new one, which is returned; the replaced one signs for another day.
///
/// # Errors
/// When the store or the system's source of randomness fails.
pub async fn rotate_webhook_secret(store: &Store, tenant: &Tenant) -> Result<String, StoreError> {
    let set = "UPDATE tenants SET previous_webhook_secret = webhook_secret, webhook_secret_set_at = unixepoch(),
                                  webhook_secret = $1 WHERE name = $2 RETURNING webhook_secret";
    set_secret(store, tenant, set).await
}

/// Returns all secrets that sign a tenant's webhooks now, the current one first.
///
/// # Errors
/// When the store or the system's source of randomness fails.
pub async fn signing_secrets(store: &Store, tenant: &Tenant) -> Result<Vec<String>, StoreError> {
    let mut secrets = vec![webhook_secret(store, tenant).await?];
    let previous: Option<String> = sqlx::query_scalar(
        "SELECT previous_webhook_secret FROM tenants
         WHERE name = $1 AND previous_webhook_secret IS NOT NULL AND abs(unixepoch() - webhook_secret_set_at) < $2",
    )
    .bind(tenant.name())
    .bind(OVERLAP_S)
    .fetch_optional(store.read())
    .await?;
    secrets.extend(previous);
    Ok(secrets)
}

/// Runs a statement that sets the secret of a tenant to a new one; returns the secret that holds then.
async fn set_secret(store: &Store, tenant: &Tenant, statement: &'static str) -> Result<String, StoreError> {
    let secret = base64::engine::general_purpose::STANDARD.encode(random_bytes()?);
    let mut transaction = store.write().await?;
    insert_if_missing(&mut transaction, tenant).await?;
    let secret: String = sqlx::query_scalar(statement)
        .bind(format!("{SECRET_PREFIX}{secret}"))
        .bind(tenant.name())
        .fetch_one(&mut *transaction)
        .await?;
    transaction.commit().await?;
    Ok(secret)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::store::test_support;

    #[tokio::test]
    async fn replaced_webhook_secret_signs_for_another_day() {
        let folder = tempfile::tempdir().unwrap();
        let store = test_support::open(folder.path()).await;
        let tenant = Tenant::parse("a").unwrap();
        let first = webhook_secret(&store, &tenant).await.unwrap();
        assert_eq!(signing_secrets(&store, &tenant).await.unwrap(), std::slice::from_ref(&first));
        let second = rotate_webhook_secret(&store, &tenant).await.unwrap();
        assert_ne!(first, second);
        assert_eq!(webhook_secret(&store, &tenant).await.unwrap(), second);
        assert_eq!(signing_secrets(&store, &tenant).await.unwrap(), [second.clone(), first]);
        let mut transaction = store.write().await.unwrap();
        let a_day_later = sqlx::query("UPDATE tenants SET webhook_secret_set_at = unixepoch() - $1").bind(OVERLAP_S);
        a_day_later.execute(&mut *transaction).await.unwrap();
        transaction.commit().await.unwrap();
        assert_eq!(signing_secrets(&store, &tenant).await.unwrap(), [second]);
    }

    #[test]
    fn rejects_names_with_other_characters() {
        for name in ["default", "Studio-7", "a.b_c"] {
            assert_eq!(Tenant::parse(name).unwrap().name(), name);
        }
        for name in ["", "a b", "ä", "../x", &"x".repeat(65)] {
            assert!(Tenant::parse(name).is_none(), "{name}");
        }
    }
}
