//! API keys: `wl_<id>_<secret>`, the secret 256 random bits. Only its SHA-256 is stored: all bits of the secret are random,
//! so a slow hash would not protect it better than a fast one.

use super::database::Store;
use super::error::StoreError;
use super::random::random_bytes;
use super::sql::SqlRow;
use super::tenants::{self, Tenant};
use crate::service::failpoint::fault;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sqlx::{AssertSqlSafe, Row};
use subtle::ConstantTimeEq;

/// Permission of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Read the tenant's sessions, jobs and results.
    Read,
    /// Upload, submit, cancel and delete.
    Write,
    /// Read the metrics of the service.
    Metrics,
}

impl Scope {
    /// Every scope.
    pub const ALL: [Scope; 3] = [Scope::Read, Scope::Write, Scope::Metrics];

    /// Spelling in the API and in the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Metrics => "metrics",
        }
    }

    /// Parses the spelling.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scope| scope.name() == name)
    }
}

/// A key as listed for the operator.
#[derive(Debug, Clone)]
pub struct ApiKey {
    /// Public part of the key.
    pub id: String,
    /// Tenant that the key belongs to.
    pub tenant: Tenant,
    /// Operator's description of the key.
    pub name: String,
    /// Permissions.
    pub scopes: Vec<Scope>,
    /// Time of creation; UTC, RFC 3339.
    pub created_at: String,
    /// Time of revocation; UTC, RFC 3339. The key is rejected from then on.
    pub revoked_at: Option<String>,
}

/// A newly created key; the only time that the secret is shown.
#[derive(Debug)]
pub struct NewKey {
    /// Public part of the key.
    pub id: String,
    /// The complete key that a client sends.
    pub token: String,
}

const PREFIX: &str = "wl_";

/// The columns of a key, named as those of jobs and sessions.
const COLUMNS: &str = "id, tenant, name, scopes, digest, created_at, revoked_at";

/// Creates a key.
///
/// # Errors
/// When the store or the system's source of randomness fails.
pub async fn create(store: &Store, tenant: &Tenant, name: &str, scopes: &[Scope]) -> Result<NewKey, StoreError> {
    let id = hex::encode(&random_bytes()?[..8]);
    let secret = hex::encode(random_bytes()?);
    let mut transaction = store.write().await?;
    tenants::insert_if_missing(&mut transaction, tenant).await?;
    sqlx::query(
        "INSERT INTO api_keys (id, tenant, name, scopes, digest, created_at)
         VALUES ($1, $2, $3, $4, $5, strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))",
    )
    .bind(&id)
    .bind(tenant.name())
    .bind(name)
    .bind(serde_json::to_string(scopes)?)
    .bind(digest(&secret))
    .execute(&mut *transaction)
    .await?;
    transaction.commit().await?;
    let token = format!("{PREFIX}{id}_{secret}");
    Ok(NewKey { id, token })
}

/// Lists all keys, oldest first.
///
/// # Errors
/// When the store fails.
pub async fn list(store: &Store) -> Result<Vec<ApiKey>, StoreError> {
    let rows = sqlx::query(AssertSqlSafe(format!("SELECT {COLUMNS} FROM api_keys ORDER BY created_at, id")));
    let rows = rows.fetch_all(store.read()).await?;
    rows.iter().map(from_row).collect()
}

/// Revokes a key; false if the key does not exist or was revoked before.
///
/// # Errors
/// When the store fails.
pub async fn revoke(store: &Store, id: &str) -> Result<bool, StoreError> {
    if fault("keys.kept") {
        return Ok(true);
    }
    let mut transaction = store.write().await?;
    let revoked = sqlx::query(
        "UPDATE api_keys SET revoked_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now') WHERE id = $1 AND revoked_at IS NULL",
    )
    .bind(id)
    .execute(&mut *transaction)
    .await?;
    transaction.commit().await?;
    Ok(revoked.rows_affected() == 1)
}

/// Whether a key was ever created: from then on requests need a key, even if all keys are revoked.
///
/// # Errors
/// When the store fails.
pub async fn any(store: &Store) -> Result<bool, StoreError> {
    let any = sqlx::query_scalar::<_, i64>("SELECT CASE WHEN EXISTS (SELECT 1 FROM api_keys) THEN 1 ELSE 0 END");
    Ok(any.fetch_one(store.read()).await? == 1)
}

/// Whether the key with this id exists and is not revoked.
///
/// # Errors
/// When the store fails.
pub async fn is_active(store: &Store, id: &str) -> Result<bool, StoreError> {
    let active = sqlx::query_scalar::<_, i64>("SELECT count(*) FROM api_keys WHERE id = $1 AND revoked_at IS NULL");
    Ok(active.bind(id).fetch_one(store.read()).await? == 1)
}

/// Returns the key of a client's token; `None` if it is unknown or revoked.
///
/// # Errors
/// When the store fails.
pub async fn check(store: &Store, token: &str) -> Result<Option<ApiKey>, StoreError> {
    let Some((id, secret)) = token.strip_prefix(PREFIX).and_then(|rest| rest.split_once('_')) else { return Ok(None) };
    let row =
        sqlx::query(AssertSqlSafe(format!("SELECT {COLUMNS} FROM api_keys WHERE id = $1 AND revoked_at IS NULL")));
    let Some(row) = row.bind(id).fetch_optional(store.read()).await? else { return Ok(None) };
    let is_right = is_same_digest(row.try_get("digest")?, &digest(secret));
    if is_right { from_row(&row).map(Some) } else { Ok(None) }
}

fn digest(secret: &str) -> String {
    hex::encode(Sha256::digest(secret.as_bytes()))
}

/// Compares in constant time, so that the duration of a rejection reveals nothing about a digest.
fn is_same_digest(stored: &str, given: &str) -> bool {
    stored.as_bytes().ct_eq(given.as_bytes()).into()
}

fn from_row(row: &SqlRow) -> Result<ApiKey, StoreError> {
    Ok(ApiKey {
        id: row.try_get("id")?,
        tenant: row.try_get("tenant")?,
        name: row.try_get("name")?,
        scopes: serde_json::from_str(row.try_get("scopes")?)?,
        created_at: row.try_get("created_at")?,
        revoked_at: row.try_get("revoked_at")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::store::test_support;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[tokio::test]
    async fn a_key_gives_access_until_it_is_revoked() {
        let folder = tempfile::tempdir().unwrap();
        let store = test_support::open(folder.path()).await;
        assert!(!any(&store).await.unwrap());
        let tenant = Tenant::parse("a").unwrap();
        let [first, second] =
            [create(&store, &tenant, "one", &[Scope::Read]).await, create(&store, &tenant, "two", &Scope::ALL).await]
                .map(Result::unwrap);
        let found = check(&store, &first.token).await.unwrap().unwrap();
        assert_eq!((found.tenant.name(), found.scopes.as_slice()), ("a", &[Scope::Read][..]));
        for wrong in ["", "wl_", &first.token[..first.token.len() - 1], &first.token.to_uppercase(), &first.id] {
            assert!(check(&store, wrong).await.unwrap().is_none(), "{wrong}");
        }
        let mixed = format!("wl_{}_{}", first.id, second.token.rsplit('_').next().unwrap());
        assert!(check(&store, &mixed).await.unwrap().is_none());
        assert!(is_active(&store, &first.id).await.unwrap());
        assert!(revoke(&store, &first.id).await.unwrap());
        assert!(!is_active(&store, &first.id).await.unwrap());
        assert!(!revoke(&store, &first.id).await.unwrap());
        assert!(check(&store, &first.token).await.unwrap().is_none());
        assert!(check(&store, &second.token).await.unwrap().is_some());
        let secret = first.token.rsplit('_').next().unwrap();
        let stored: Vec<(String, String)> =
            sqlx::query_as("SELECT id, digest FROM api_keys").fetch_all(store.read()).await.unwrap();
        assert!(!stored.iter().any(|(id, digest)| id.contains(secret) || digest.contains(secret)));
        if !test_support::is_of_sqlite_alone("no secret is anywhere in the database file") {
            let file = std::fs::read(store.folders.database()).unwrap();
            assert!(!file.windows(secret.len()).any(|window| window == secret.as_bytes()));
        }
        assert!(any(&store).await.unwrap());
    }

    /// Welch's t between the times of comparing two wrong digests, one different in the first character and one in the
    /// last, in random order; the slowest tenth of all samples (interrupted by other work) is left out.
    fn t_of_times(is_same: fn(&str, &str) -> bool) -> f64 {
        const SAMPLES: usize = 100_000;
        const CALLS: usize = 50;
        let stored = digest("a secret");
        let wrong = [format!("x{}", &stored[1..]), format!("{}x", &stored[..63])];
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let order: Vec<usize> = (0..SAMPLES).map(|_| usize::from(rng.random_bool(0.5))).collect();
        let timed = |kind: &usize| {
            let start = std::time::Instant::now();
            for _ in 0..CALLS {
                std::hint::black_box(is_same(std::hint::black_box(&stored), std::hint::black_box(&wrong[*kind])));
            }
            (*kind, start.elapsed().as_nanos() as f64)
        };
        let mut samples: Vec<(usize, f64)> = order.iter().map(timed).collect();
        samples.sort_by(|a, b| a.1.total_cmp(&b.1));
        samples.truncate(SAMPLES * 9 / 10);
        let [early, late] = [0, 1].map(|kind| {
            let times: Vec<f64> = samples.iter().filter(|(k, _)| *k == kind).map(|(_, t)| *t).collect();
            let n = times.len() as f64;
            let mean = times.iter().sum::<f64>() / n;
            (mean, times.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / (n - 1.0) / n)
        });
        (late.0 - early.0) / (late.1 + early.1).sqrt()
    }

    /// Limit of |t|: Reparaz, Balasch and Verbauwhede 2017 ("Dude, is my code constant time?") call |t| above 5 a leak.
    #[test]
    #[ignore = "times a hundred thousand comparisons: cargo test --release digest_comparison -- --ignored --nocapture"]
    fn digest_comparison_takes_constant_time() {
        let constant = t_of_times(is_same_digest);
        let naive = t_of_times(|stored, given| stored.bytes().zip(given.bytes()).all(|(a, b)| a == b));
        println!("t = {constant:.2}; of a comparison that stops at the first difference {naive:.0}");
        assert!(constant.abs() < 5.0);
        assert!(naive.abs() > 50.0, "the test would not detect a leak");
    }
}
