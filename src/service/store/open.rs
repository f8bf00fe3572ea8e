//! Opening the database and the store of the files that the settings name.

use super::blobs::Blobs;
use super::database::Store;
use super::error::StoreError;
use super::folders::Folders;
use super::sqlite;
use crate::service::settings::Settings;
use std::path::Path;

/// The value of `store.url` that keeps the database in the data folder.
const IN_FOLDER: &str = "sqlite:";

impl Store {
    /// Locks the folder for this process, opens the database in it and migrates it to this release's schema.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn open(root: &Path) -> Result<Self, StoreError> {
        sqlite::open(Folders::open(root)?).await
    }

    /// Locks the data folder for this process, opens the database and the store of the files that the settings name, and migrates
    /// the database to this release's schema.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn open_for(settings: &Settings) -> Result<Self, StoreError> {
        let folders = Folders::open(&settings.data)?;
        let mut store = Self::connect(settings, folders).await?;
        store.blobs = Blobs::open(&settings.blobs, &store.folders).await?;
        store.require_blobs(&settings.blobs.url).await?;
        Ok(store)
    }

    /// Opens the store beside a running service, for a command; if no service is running, same as [`Store::open_for`]. Commands need
    /// no files.
    ///
    /// # Errors
    /// Same as [`Store::open_for`].
    pub async fn open_beside(settings: &Settings) -> Result<Self, StoreError> {
        let folders = match Folders::open(&settings.data) {
            Err(StoreError::InUse { .. }) => Folders::beside(&settings.data)?,
            folders => folders?,
        };
        Self::connect(settings, folders).await
    }

    /// Number of the newest migration that this release knows, and the database has.
    pub fn newest_migration(&self) -> i64 {
        #[cfg(feature = "scale")]
        if self.is_shared() {
            return super::postgres::newest_migration();
        }
        super::migrations::SQLITE.iter().map(|migration| migration.version).max().unwrap_or(0)
    }

    pub(super) async fn connect(settings: &Settings, folders: Folders) -> Result<Self, StoreError> {
        let url = &settings.store.url;
        if url == IN_FOLDER {
            return sqlite::open(folders).await;
        }
        #[cfg(feature = "scale")]
        return super::postgres::open(&settings.store, folders).await;
        #[cfg(not(feature = "scale"))]
        Err(StoreError::without_scale("store.url", "another database", IN_FOLDER))
    }

    /// Refuses a store of the files that is not the one in which those of the database are; a database without files takes any.
    async fn require_blobs(&self, url: &str) -> Result<(), StoreError> {
        let known: Option<String> =
            sqlx::query_scalar("SELECT blobs_url FROM storage").fetch_optional(self.read()).await?;
        if known.as_deref() == Some(url) {
            return Ok(());
        }
        let mut transaction = self.write().await?;
        let files = "SELECT (SELECT count(*) FROM sessions) + (SELECT count(*) FROM artifacts)";
        let n_files: i64 = sqlx::query_scalar(files).fetch_one(&mut *transaction).await?;
        if let Some(known) = known
            && n_files > 0
        {
            return Err(StoreError::OtherBlobs { known, given: url.to_owned() });
        }
        let set = "INSERT INTO storage (id, blobs_url) VALUES (1, $1) ON CONFLICT (id) DO UPDATE SET blobs_url = excluded.blobs_url";
        sqlx::query(set).bind(url).execute(&mut *transaction).await?;
        Ok(self.commit(transaction).await?)
    }
}
