//! Files of a result on the disk: listed, hashed and synced once.

use super::sql::SqlRow;
use sha2::{Digest, Sha256};
use sqlx::{FromRow, Row};
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// One published file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Artifact {
    /// Path below the result folder, with `/`.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size, bytes.
    pub bytes: u64,
    /// SHA-256, hex.
    pub sha256: String,
}

impl FromRow<'_, SqlRow> for Artifact {
    fn from_row(row: &SqlRow) -> sqlx::Result<Self> {
        let bytes = u64::try_from(row.try_get::<i64, _>("bytes")?);
        Ok(Self {
            name: row.try_get("name")?,
            media_type: row.try_get("media_type")?,
            bytes: bytes.map_err(|error| sqlx::Error::Decode(error.into()))?,
            sha256: row.try_get("sha256")?,
        })
    }
}

/// Lists a result folder: hashes every file, syncs files and folders, and sorts by name.
///
/// # Errors
/// When an entry cannot be read or synced, is neither file nor folder, or has a name that is not UTF-8.
pub fn scan(root: &Path) -> io::Result<Vec<Artifact>> {
    let mut artifacts = Vec::new();
    scan_folder(root, "", &mut artifacts)?;
    artifacts.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(artifacts)
}

fn scan_folder(folder: &Path, prefix: &str, artifacts: &mut Vec<Artifact>) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let file_name = entry.file_name();
        let invalid = |what: &str| io::Error::other(format!("{}: {what}", entry.path().display()));
        let name = file_name.to_str().ok_or_else(|| invalid("the name is not UTF-8"))?;
        let name = format!("{prefix}{name}");
        let kind = entry.file_type()?; // does not follow links
        if kind.is_dir() {
            scan_folder(&entry.path(), &format!("{name}/"), artifacts)?;
        } else if kind.is_file() {
            File::open(entry.path())?.sync_all()?;
            let digest = digest_file(&entry.path())?;
            let media_type = media_type(&name).to_owned();
            artifacts.push(Artifact { name, media_type, bytes: digest.bytes, sha256: digest.sha256 });
        } else {
            return Err(invalid("neither file nor folder"));
        }
    }
    File::open(folder)?.sync_all()
}

/// Size and digest of a file.
#[derive(Debug, PartialEq, Eq)]
pub struct FileDigest {
    /// Size, bytes.
    pub bytes: u64,
    /// SHA-256, hex.
    pub sha256: String,
}

/// Computes the size and the SHA-256 of a file, reading it once.
///
/// # Errors
/// When the file cannot be read.
pub fn digest_file(path: &Path) -> io::Result<FileDigest> {
    digest_of(&mut File::open(path)?)
}

/// Computes the size and the SHA-256 of everything that a reader returns.
///
/// # Errors
/// When reading fails.
pub fn digest_of(file: &mut impl Read) -> io::Result<FileDigest> {
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    let mut bytes = 0;
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(FileDigest { bytes, sha256: hex::encode(hasher.finalize()) }),
            n => {
                hasher.update(&buffer[..n]);
                bytes += n as u64;
            }
        }
    }
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("json") => "application/json",
        Some("glb") => "model/gltf-binary",
        Some("usda") => "model/vnd.usda",
        Some("usdz") => "model/vnd.usdz+zip",
        Some("yml" | "yaml") => "application/yaml",
        Some("toml") => "application/toml",
        Some("bvh" | "trc" | "mot" | "txt" | "chan") => "text/plain",
        Some("csv") => "text/csv",
        Some("xml") => "application/xml",
        Some("py") => "text/x-python",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scan_lists_files_with_digests_in_order() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("smpl")).unwrap();
        std::fs::write(folder.path().join("smpl/0.npz"), b"abc").unwrap();
        std::fs::write(folder.path().join("report.json"), b"").unwrap();
        let artifacts = scan(folder.path()).unwrap();
        let names: Vec<_> = artifacts.iter().map(|a| (a.name.as_str(), a.media_type.as_str(), a.bytes)).collect();
        assert_eq!(names, [("report.json", "application/json", 0), ("smpl/0.npz", "application/octet-stream", 3)]);
        // FIPS 180-2, appendix B.1.
        assert_eq!(artifacts[1].sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn rejects_links_in_a_result() {
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc/hostname", folder.path().join("cameras.json")).unwrap();
        assert!(scan(folder.path()).is_err());
    }
}
