//! What a move has done, at its end and on the way.

/// What was moved.
#[derive(Debug, Default)]
pub struct Moved {
    /// Rows by table.
    pub rows: Vec<(&'static str, u64)>,
    /// Files, and those of them that an interrupted move had stored before.
    pub files: usize,
    /// Files that were there already.
    pub known_files: usize,
    /// Bytes of all files.
    pub bytes: u64,
    /// Texts with the character U+0000, which PostgreSQL cannot store; it was replaced by U+FFFD. Each with table and column.
    pub replaced: Vec<String>,
    /// Registered bodies, which are not moved: every node reads them from its own data folder.
    pub bodies: usize,
}

/// Files that are moved, while they are.
#[derive(Debug, Clone, Copy)]
pub struct FileProgress {
    /// Files that are there.
    pub done: usize,
    /// All files.
    pub total: usize,
    /// Bytes of the files that are there.
    pub bytes: u64,
}
