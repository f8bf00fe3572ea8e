//! API keys: `wl_<id>_<secret>`, the secret 256 random bits. Only its SHA-256 is stored: the secret has all its bits from
//! the system, so a slow hash would protect nothing that a fast one does not.

use super::tenants::Tenant;
use super::{Store, StoreError};
use crate::service::failpoint::fault;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sqlx::Row;
use sqlx::sqlite::SqliteRow;
use subtle::ConstantTimeEq;

/// What a key allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// To look at the tenant's sessions, jobs and results.
    Read,
    /// To upload, submit, cancel and delete.
    Write,
    /// To read the service's figures.
    Metrics,
}

impl Scope {
    /// Every scope.
    pub const ALL: [Scope; 3] = [Scope::Read, Scope::Write, Scope::Metrics];

    /// Its spelling.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Metrics => "metrics",
        }
    }

    /// Reads its spelling.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scope| scope.name() == name)
    }
}

/// A key as the operator sees it.
#[derive(Debug, Clone)]
pub struct ApiKey {
    /// The public half.
    pub id: String,
    /// Whose.
    pub tenant: Tenant,
    /// For the operator to read.
    pub name: String,
    /// What it allows.
    pub scopes: Vec<Scope>,
    /// UTC, RFC 3339.
    pub created_at: String,
    /// UTC, RFC 3339; refused since then.
    pub revoked_at: Option<String>,
}

/// A key that was just made; the secret is told this once.
#[derive(Debug)]
pub struct NewKey {
    /// The row.
    pub id: String,
    /// What the client sends.
    pub token: String,
}

const PREFIX: &str = "wl_";

/// Bytes of a secret.
pub(crate) const SECRET_BYTES: usize = 32;

/// Fresh bytes from the system.
pub(crate) fn random_bytes() -> Result<[u8; SECRET_BYTES], StoreError> {
    let mut bytes = [0; SECRET_BYTES];
    getrandom::fill(&mut bytes).map_err(|_| StoreError::NoRandomness)?;
    Ok(bytes)
}

/// Makes a key.
///
/// # Errors
/// When the store or the system's source of randomness fails.
pub async fn create(store: &Store, tenant: &Tenant, name: &str, scopes: &[Scope]) -> Result<NewKey, StoreError> {
    let id = hex::encode(&random_bytes()?[..8]);
    let secret = hex::encode(random_bytes()?);
    let mut transaction = store.write().await?;
    super::tenants::remember(&mut transaction, tenant).await?;
    sqlx::query(
        "INSERT INTO api_keys (id, tenant, name, scopes, digest, created_at)
         VALUES (?, ?, ?, ?, ?, strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))",
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

/// Every key, oldest first.
///
/// # Errors
/// When the store fails.
pub async fn list(store: &Store) -> Result<Vec<ApiKey>, StoreError> {
    let rows = sqlx::query("SELECT * FROM api_keys ORDER BY created_at, id").fetch_all(store.read()).await?;
    rows.iter().map(from_row).collect()
}

/// Refuses a key from now on; false where there is no such key, or it was refused before.
///
/// # Errors
/// When the store fails.
pub async fn revoke(store: &Store, id: &str) -> Result<bool, StoreError> {
    if fault("keys.kept") {
        return Ok(true);
    }
    let mut transaction = store.write().await?;
    let revoked = sqlx::query(
        "UPDATE api_keys SET revoked_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now') WHERE id = ? AND revoked_at IS NULL",
    )
    .bind(id)
    .execute(&mut *transaction)
    .await?;
    transaction.commit().await?;
    Ok(revoked.rows_affected() == 1)
}

/// Whether a key was ever made: from then on one is asked for, even when all are revoked.
///
/// # Errors
/// When the store fails.
pub async fn any(store: &Store) -> Result<bool, StoreError> {
    Ok(sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM api_keys)").fetch_one(store.read()).await?)
}

/// The key that a client's token stands for; `None` where it is none of ours, or revoked.
///
/// # Errors
/// When the store fails.
pub async fn check(store: &Store, token: &str) -> Result<Option<ApiKey>, StoreError> {
    let Some((id, secret)) = token.strip_prefix(PREFIX).and_then(|rest| rest.split_once('_')) else { return Ok(None) };
    let row = sqlx::query("SELECT * FROM api_keys WHERE id = ? AND revoked_at IS NULL").bind(id);
    let Some(row) = row.fetch_optional(store.read()).await? else { return Ok(None) };
    let is_right = is_same_digest(row.try_get("digest")?, &digest(secret));
    if is_right { from_row(&row).map(Some) } else { Ok(None) }
}

fn digest(secret: &str) -> String {
    hex::encode(Sha256::digest(secret.as_bytes()))
}

/// In constant time, so that nothing of a digest can be learned from how long a refusal takes.
fn is_same_digest(stored: &str, given: &str) -> bool {
    stored.as_bytes().ct_eq(given.as_bytes()).into()
}

fn from_row(row: &SqliteRow) -> Result<ApiKey, StoreError> {
    Ok(ApiKey {
        id: row.try_get("id")?,
        tenant: Tenant::stored(row.try_get("tenant")?),
        name: row.try_get("name")?,
        scopes: serde_json::from_str(row.try_get("scopes")?)?,
        created_at: row.try_get("created_at")?,
        revoked_at: row.try_get("revoked_at")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[tokio::test]
    async fn a_key_opens_its_tenant_until_it_is_revoked() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
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
        assert!(revoke(&store, &first.id).await.unwrap());
        assert!(!revoke(&store, &first.id).await.unwrap());
        assert!(check(&store, &first.token).await.unwrap().is_none());
        assert!(check(&store, &second.token).await.unwrap().is_some());
        let stored = std::fs::read(store.folders.database()).unwrap();
        let secret = first.token.rsplit('_').next().unwrap().as_bytes();
        assert!(!stored.windows(secret.len()).any(|window| window == secret));
        assert!(any(&store).await.unwrap());
    }

    /// Welch's t between the times of two kinds of digest, wrong in the first character and in the last, in random order;
    /// the slowest tenth of all, in which the machine did something else, is left out.
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

    /// Reparaz, Balasch and Verbauwhede 2017 ("Dude, is my code constant time?") call |t| above 5 a leak.
    #[test]
    #[ignore = "times a hundred thousand comparisons: cargo test --release times_of -- --ignored --nocapture"]
    fn times_of_refusals_tell_nothing_of_a_digest() {
        let ours = t_of_times(is_same_digest);
        let naive = t_of_times(|stored, given| stored.bytes().zip(given.bytes()).all(|(a, b)| a == b));
        println!("t = {ours:.2}; of a comparison that ends at the first difference {naive:.0}");
        assert!(ours.abs() < 5.0);
        assert!(naive.abs() > 50.0, "a leak would not be seen");
    }
}
