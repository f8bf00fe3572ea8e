//! The central directory of a zip, checked before anything is decompressed.
//!
//! Only plain archives are read: one archive from the first byte to the last, relative names, stored or deflated members. The
//! zip reader limits every member to the size that the directory states, so the sizes checked here bound the decompressed
//! data.

use super::error::{Fault, UploadError, shown};
use super::limits::UploadLimits;
use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use zip::read::{ArchiveOffset, Config, ZipFileEntry};
use zip::{CompressionMethod, ZipArchive};

/// An opened archive and the position of each file in it.
pub(super) struct ZipIndex<R> {
    pub(super) archive: ZipArchive<R>,
    pub(super) positions: BTreeMap<String, usize>,
}

/// Size of the end record without its comment (APPNOTE 4.3.16).
const END_BYTES: usize = 22;
/// Largest length of a member's name, bytes.
const MAX_NAME_BYTES: usize = 4200;

/// Opens a zip and checks its directory.
///
/// # Errors
/// The first member that breaks a rule, or the archive as a whole.
pub(super) fn index_zip<R: Read + Seek>(mut reader: R, limits: &UploadLimits) -> Result<ZipIndex<R>, UploadError> {
    check_end_record(&mut reader, limits)?;
    let config = Config { archive_offset: ArchiveOffset::Known(0) };
    let mut archive = ZipArchive::with_config(config, reader).map_err(|e| Fault::ZipInvalid.with(e.to_string()))?;
    Fault::ZipDuplicateMember.when(archive.has_duplicate_names(), || "the archive contains one name twice")?;
    let positions = checked_positions(&archive, limits)?;
    match archive.has_overlapping_entries() {
        Ok(false) => Ok(ZipIndex { archive, positions }),
        Ok(true) => Err(Fault::ZipOverlap.with("members of the archive share bytes")),
        Err(e) => Err(Fault::ZipInvalid.with(e.to_string())),
    }
}

/// Checks the end record before the zip reader does, because that reader allocates memory for as many members as the record
/// announces.
fn check_end_record<R: Read + Seek>(reader: &mut R, limits: &UploadLimits) -> Result<(), UploadError> {
    let invalid = |detail: &str| Fault::ZipInvalid.with(detail);
    let unreadable = |e: std::io::Error| Fault::FileUnreadable.with(e.to_string());
    let length = reader.seek(SeekFrom::End(0)).map_err(unreadable)?;
    let tail_start = length.saturating_sub((END_BYTES + usize::from(u16::MAX)) as u64);
    reader.seek(SeekFrom::Start(tail_start)).map_err(unreadable)?;
    let mut tail = Vec::new();
    reader.take(length - tail_start).read_to_end(&mut tail).map_err(unreadable)?;

    let at =
        tail.windows(4).rposition(|w| w == b"PK\x05\x06").ok_or_else(|| invalid("the archive has no end record"))?;
    let end = tail.get(at..at + END_BYTES).ok_or_else(|| invalid("the end record is truncated"))?;
    let u16_at = |i: usize| u16::from_le_bytes([end[i], end[i + 1]]);
    let u32_at = |i: usize| u32::from_le_bytes([end[i], end[i + 1], end[i + 2], end[i + 3]]);
    if at + END_BYTES + usize::from(u16_at(20)) != tail.len() {
        return Err(invalid("there is content after the end of the archive, or its comment is truncated"));
    }
    let short = Directory {
        n_members: u64::from(u16_at(10)),
        bytes: u64::from(u32_at(12)),
        start: u64::from(u32_at(16)),
        end: tail_start + at as u64,
    };
    let directory = if at >= 20 && tail[at - 20..].starts_with(b"PK\x06\x07") {
        long_directory(&tail[..at], tail_start).ok_or_else(|| invalid("the 64-bit end record is damaged"))?
    } else {
        short
    };
    if directory.n_members > limits.max_members as u64 {
        return Err(Fault::TooManyMembers.with(format!("the archive has more than {} members", limits.max_members)));
    }
    Fault::TooManyMembers.when(directory.bytes > limits.max_directory_bytes, || {
        format!("the directory has {} bytes, at most {} are read", directory.bytes, limits.max_directory_bytes)
    })?;
    if directory.start.checked_add(directory.bytes) != Some(directory.end) {
        return Err(invalid("the directory is not at the position that the end record states"));
    }
    Ok(())
}

/// Size and position of the directory as an end record states them, and where the directory must end.
struct Directory {
    n_members: u64,
    bytes: u64,
    start: u64,
    end: u64,
}

/// Sizes of the 64-bit end record without extensions and of its locator (APPNOTE 4.3.14, 4.3.15).
const LONG_END_BYTES: usize = 56;
const LOCATOR_BYTES: usize = 20;

/// Reads the 64-bit end record before the plain one, which archives of more than 65535 members need.
fn long_directory(before_end: &[u8], tail_start: u64) -> Option<Directory> {
    let at = before_end.len().checked_sub(LOCATOR_BYTES + LONG_END_BYTES)?;
    let (record, locator) = before_end[at..].split_at(LONG_END_BYTES);
    let u64_at = |bytes: &[u8], i: usize| Some(u64::from_le_bytes(bytes.get(i..i + 8)?.try_into().ok()?));
    let end = tail_start + at as u64;
    let is_whole = record.starts_with(b"PK\x06\x06") && u64_at(record, 4)? == LONG_END_BYTES as u64 - 12;
    let is_located = u64_at(locator, 8)? == end;
    (is_whole && is_located).then_some(Directory {
        n_members: u64_at(record, 32)?,
        bytes: u64_at(record, 40)?,
        start: u64_at(record, 48)?,
        end,
    })
}

fn checked_positions<R: Read + Seek>(
    archive: &ZipArchive<R>,
    limits: &UploadLimits,
) -> Result<BTreeMap<String, usize>, UploadError> {
    let mut positions = BTreeMap::new();
    let mut unpacked: u64 = 0;
    for position in 0..archive.len() {
        let entry = archive.by_index_data(position).map_err(|e| Fault::ZipInvalid.with(e.to_string()))?;
        let name = checked_name(entry.name_raw())?;
        let in_member = |error| UploadError { file: Some(name.to_owned()), ..error };
        check_member(&entry, limits).map_err(in_member)?;
        unpacked = unpacked.saturating_add(entry.size());
        if unpacked > limits.max_unpacked_bytes {
            let detail = format!("the archive decompresses to more than {} bytes", limits.max_unpacked_bytes);
            return Err(in_member(Fault::TooLarge.with(detail)));
        }
        if !entry.is_dir() {
            positions.insert(name.to_owned(), position);
        }
    }
    Ok(positions)
}

/// Checks that the name is a relative path of plain parts, which no operating system resolves to a place outside a folder.
fn checked_name(raw: &[u8]) -> Result<&str, UploadError> {
    let refuse = |name: &str, why: &str| UploadError {
        file: Some(name.to_owned()),
        ..Fault::ZipNameUnsafe.with(format!("the member's name {why}"))
    };
    let name = std::str::from_utf8(raw).map_err(|_| refuse(&String::from_utf8_lossy(raw), "is not UTF-8"))?;
    let has_drive = name.as_bytes().get(1) == Some(&b':') && name.as_bytes()[0].is_ascii_alphabetic();
    if name.len() > MAX_NAME_BYTES {
        return Err(refuse(&shown(name), "is too long"));
    }
    if name.contains(['\0', '\\']) {
        return Err(refuse(name, "contains a NUL or a backslash"));
    }
    if name.starts_with('/') || has_drive {
        return Err(refuse(name, "is absolute"));
    }
    if name.strip_suffix('/').unwrap_or(name).split('/').any(|part| matches!(part, "" | "." | "..")) {
        return Err(refuse(name, "contains an empty part, . or .."));
    }
    Ok(name)
}

fn check_member(entry: &ZipFileEntry<'_>, limits: &UploadLimits) -> Result<(), UploadError> {
    Fault::ZipSymlink.when(entry.is_symlink(), || "the member is a symbolic link")?;
    Fault::ZipEncrypted.when(entry.encrypted(), || "the member is encrypted")?;
    Fault::ZipMethod
        .when(!matches!(entry.compression(), CompressionMethod::Stored | CompressionMethod::Deflated), || {
            format!("the member is compressed with method {}, expected deflate or none", entry.compression())
        })?;
    let (packed, unpacked) = (entry.compressed_size(), entry.size());
    Fault::ZipRatio
        .when(unpacked > limits.ratio_free_bytes && unpacked > packed.saturating_mul(limits.max_ratio), || {
            format!("{packed} bytes decompress to {unpacked}, expected a ratio of at most {} to 1", limits.max_ratio)
        })?;
    Ok(())
}
