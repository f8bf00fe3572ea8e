//! What is worth telling about an accepted upload, each thing once.

use super::error::shown;

/// More lines than this tell a user nothing new.
const MAX_LINES: usize = 50;

/// Lines for the user, in the order in which they came up.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    lines: Vec<String>,
    n_unsaid: usize,
    n_clamped: usize,
    largest_confidence: f64,
}

impl Warnings {
    /// Adds a line, unless it stands there already.
    pub(crate) fn add(&mut self, line: String) {
        if self.lines.contains(&line) {
            return;
        }
        if self.lines.len() < MAX_LINES { self.lines.push(line) } else { self.n_unsaid += 1 }
    }

    /// A key that means nothing was passed over; said once per key and kind of object.
    pub(crate) fn unknown_key(&mut self, file: &str, object: &str, key: &str) {
        // All pose files count as one kind: a detector's extra key stands in each of them.
        let file = if file.contains("poses/") { "poses" } else { file };
        self.add(format!("{file}: unknown key {} in {object} is ignored", shown(key)));
    }

    /// A confidence above 1 was read as 1.
    pub(crate) fn clamped_confidence(&mut self, confidence: f64) {
        self.n_clamped += 1;
        self.largest_confidence = self.largest_confidence.max(confidence);
    }

    /// All lines.
    pub(crate) fn into_lines(mut self) -> Vec<String> {
        if self.n_clamped > 0 {
            let (n, largest) = (self.n_clamped, self.largest_confidence);
            self.lines.push(format!("{n} confidences above 1 (up to {largest}) are read as 1"));
        }
        if self.n_unsaid > 0 {
            self.lines.push(format!("{} more warnings", self.n_unsaid));
        }
        self.lines
    }
}
