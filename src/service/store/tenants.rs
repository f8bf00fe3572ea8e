//! Tenants: the owners of sessions and jobs, their disk usage and their webhook secrets.

use super::database::{Store, WriteTransaction};
use super::error::StoreError;
use super::random::random_bytes;
use super::sql::Db;
use base64::Engine;
use serde::Serialize;
use sqlx::{AssertSqlSafe, Database};

/// Name of a tenant: 1 to 64 letters, digits, `-`, `_` and `.`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(transparent)]
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

/// A tenant is read as the text that it is.
impl sqlx::Type<Db> for Tenant {
    fn type_info() -> <Db as Database>::TypeInfo {
        <String as sqlx::Type<Db>>::type_info()
    }

    fn compatible(found: &<Db as Database>::TypeInfo) -> bool {
        <String as sqlx::Type<Db>>::compatible(found)
    }
}

impl<'r> sqlx::Decode<'r, Db> for Tenant {
    fn decode(value: <Db as Database>::ValueRef<'r>) -> Result<Self, sqlx::error::BoxDynError> {
        <String as sqlx::Decode<Db>>::decode(value).map(Self)
    }
}

/// Returns the bytes of a tenant's uploads and results, a running total that triggers keep.
///
/// # Errors
/// When the store fails.
pub async fn stored_bytes(store: &Store, tenant: &Tenant) -> Result<i64, StoreError> {
    let bytes = "SELECT coalesce((SELECT stored_bytes FROM tenants WHERE name = $1), 0)";
    Ok(sqlx::query_scalar(bytes).bind(tenant.name()).fetch_one(store.read()).await?)
}

/// Inserts the row of a tenant unless it exists.
pub(crate) async fn insert_if_missing(transaction: &mut WriteTransaction, tenant: &Tenant) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO tenants (name) VALUES ($1) ON CONFLICT (name) DO NOTHING")
        .bind(tenant.name())
        .execute(&mut **transaction)
        .await?;
    Ok(())
}

/// The table with the counters of all jobs: those of the tenants, and where many processes share the database, which may have ten thousand
/// tenants, the totals that its triggers keep.
pub(crate) fn counters_of_all(store: &Store) -> &'static str {
    if store.is_shared() { "job_totals" } else { "tenants" }
}

/// What the limits of a tenant, and of all together, apply to.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Usage {
    /// Waiting jobs.
    pub n_queued: i64,
    /// Waiting jobs of all tenants.
    pub n_queued_of_all: i64,
    /// Bytes of uploads and results.
    pub stored_bytes: i64,
}

/// Locks the row of a tenant, inserted if it is missing, until the transaction ends, so that what its limits allow and which sessions it
/// has cannot change in between. A write transaction of SQLite locks the whole database anyway. A transaction with this lock waits for no
/// job's row.
pub(crate) async fn lock(
    store: &Store,
    transaction: &mut WriteTransaction,
    tenant: &Tenant,
) -> Result<Usage, StoreError> {
    let usage = match usage(store, transaction, tenant).await? {
        Some(usage) => Some(usage),
        None => {
            insert_if_missing(transaction, tenant).await?;
            usage(store, transaction, tenant).await?
        }
    };
    Ok(usage.unwrap_or_default()) // no row of a tenant is deleted
}

async fn usage(
    store: &Store,
    transaction: &mut WriteTransaction,
    tenant: &Tenant,
) -> Result<Option<Usage>, StoreError> {
    let lock = if store.is_shared() { "FOR UPDATE" } else { "" };
    let all = counters_of_all(store);
    // An index of the tenants with waiting jobs; a row of the totals may be negative.
    let some = if store.is_shared() { "" } else { "WHERE n_queued > 0" };
    let row = format!(
        "SELECT n_queued, (SELECT CAST(coalesce(sum(n_queued), 0) AS BIGINT) FROM {all} {some}), stored_bytes
         FROM tenants WHERE name = $1 {lock}"
    );
    let row = sqlx::query_as(AssertSqlSafe(row)).bind(tenant.name()); // the text is our own
    let row: Option<(i64, i64, i64)> = row.fetch_optional(&mut **transaction).await?;
    Ok(row.map(|(n_queued, n_queued_of_all, stored_bytes)| Usage { n_queued, n_queued_of_all, stored_bytes }))
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
