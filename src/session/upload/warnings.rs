//! Warnings about an accepted upload, without repetitions.

use super::error::shown;

/// Largest number of lines; further warnings are only counted.
const MAX_LINES: usize = 50;

/// Warnings for the user, in the order of their occurrence.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    lines: Vec<String>,
    n_omitted: usize,
    n_clamped: usize,
    largest_confidence: f64,
}

impl Warnings {
    /// Adds a line unless it is already there.
    pub(crate) fn add(&mut self, line: String) {
        if self.lines.contains(&line) {
            return;
        }
        if self.lines.len() < MAX_LINES { self.lines.push(line) } else { self.n_omitted += 1 }
    }

    /// Warns that an unknown key is ignored, once per key and kind of object.
    pub(crate) fn unknown_key(&mut self, file: &str, object: &str, key: &str) {
        // All pose files count as one: a detector writes the same additional key into each of them.
        let file = if file.contains("poses/") { "poses" } else { file };
        self.add(format!("{file}: unknown key {} in {object} is ignored", shown(key)));
    }

    /// Counts a confidence above 1 that is read as 1.
    pub(crate) fn clamped_confidence(&mut self, confidence: f64) {
        self.n_clamped += 1;
        self.largest_confidence = self.largest_confidence.max(confidence);
    }

    /// Adds those of another part of the upload.
    pub(crate) fn append(&mut self, other: Self) {
        other.lines.into_iter().for_each(|line| self.add(line));
        self.n_omitted += other.n_omitted;
        self.n_clamped += other.n_clamped;
        self.largest_confidence = self.largest_confidence.max(other.largest_confidence);
    }

    /// All warnings.
    pub(crate) fn into_lines(mut self) -> Vec<String> {
        if self.n_clamped > 0 {
            let (n, largest) = (self.n_clamped, self.largest_confidence);
            self.lines.push(format!("{n} confidences above 1 (up to {largest}) are read as 1"));
        }
        if self.n_omitted > 0 {
            self.lines.push(format!("{} more warnings are not listed", self.n_omitted));
        }
        self.lines
    }
}
