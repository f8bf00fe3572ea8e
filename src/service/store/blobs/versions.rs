//! Earlier versions of objects, which a bucket with versioning keeps. A database that was restored to an earlier second names objects that
//! were removed since; their versions have the bytes.

use super::super::error::StoreError;
use futures_util::TryFutureExt;
use object_store::aws::AmazonS3;
use object_store::path::Path as Key;
use object_store::signer::{SignedUrlOptions, Signer};
use std::sync::Arc;
use std::time::Duration;

/// Time for which the signature of a request is valid.
const VALID: Duration = Duration::from_secs(60);

/// The bucket behind the objects, for requests that an [`object_store::ObjectStore`] does not make.
#[derive(Debug, Clone)]
pub(super) struct Versions {
    s3: Arc<AmazonS3>,
    prefix: String,
}

impl Versions {
    /// `prefix`: that of all keys, without a slash at its end.
    pub(super) fn new(s3: Arc<AmazonS3>, prefix: &str) -> Self {
        Self { s3, prefix: prefix.to_owned() }
    }

    /// Whether the bucket keeps versions.
    ///
    /// # Errors
    /// When the object store fails, or does not know versions.
    pub(super) async fn are_kept(&self) -> Result<bool, StoreError> {
        let answer = self.ask("versioning", [("versioning", String::new())]).await?;
        let document = parsed("versioning", &answer)?;
        let status = document.descendants().find(|node| is_named(node, "Status"));
        Ok(status.and_then(|status| status.text()) == Some("Enabled"))
    }

    /// Ids of the versions of an object, newest first; marks of its removal are none.
    ///
    /// # Errors
    /// When the object store fails.
    pub(super) async fn of(&self, key: &str) -> Result<Vec<String>, StoreError> {
        let full = if self.prefix.is_empty() { key.to_owned() } else { format!("{}/{key}", self.prefix) };
        let answer = self.ask(key, [("versions", String::new()), ("prefix", full.clone())]).await?;
        let document = parsed(key, &answer)?;
        let versions = document.descendants().filter(|node| is_named(node, "Version"));
        let text = |node: &roxmltree::Node<'_, '_>, name: &str| {
            let child = node.children().find(|child| is_named(child, name));
            child.and_then(|child| child.text()).map(str::to_owned)
        };
        let versions = versions.filter(|version| text(version, "Key").as_deref() == Some(&full));
        Ok(versions.filter_map(|version| text(&version, "VersionId")).collect())
    }

    /// The answer of the bucket to a signed request.
    async fn ask<const N: usize>(&self, key: &str, query: [(&str, String); N]) -> Result<String, StoreError> {
        let failed =
            |source: Box<dyn std::error::Error + Send + Sync>| StoreError::Blobs { key: key.to_owned(), source };
        let options = SignedUrlOptions::new().with_query(query.map(|(name, value)| (name.to_owned(), value)));
        let bucket = Key::default();
        let url = self.s3.signed_url_opts(reqwest::Method::GET, &bucket, VALID, &options);
        let url = url.await.map_err(|error| failed(error.into()))?;
        let answer = reqwest::get(url).map_err(|error| failed(error.without_url().into())).await?;
        if !answer.status().is_success() {
            return Err(StoreError::Unversioned {
                reason: format!("the object store answers HTTP {}", answer.status()),
            });
        }
        answer.text().await.map_err(|error| failed(error.without_url().into()))
    }
}

fn parsed<'a>(key: &str, answer: &'a str) -> Result<roxmltree::Document<'a>, StoreError> {
    roxmltree::Document::parse(answer)
        .map_err(|error| StoreError::Blobs { key: key.to_owned(), source: error.to_string().into() })
}

/// Whether a node has this name; stores differ in the namespace of their answers.
fn is_named(node: &roxmltree::Node<'_, '_>, name: &str) -> bool {
    node.tag_name().name() == name
}
