//! Tables of statistics over sessions, one row per variant of the method, as Markdown and as JSON.

use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Statistics of one solve by column; `None`: not available.
pub(super) type Statistics = BTreeMap<&'static str, Option<f64>>;

/// Name of a column and its number of decimals.
pub(super) type Column = (&'static str, usize);

/// Assigns values to the columns, in order.
pub(super) fn statistics(columns: &[Column], values: impl IntoIterator<Item = Option<f64>>) -> Statistics {
    columns.iter().map(|(name, _)| *name).zip(values).collect()
}

/// One variant of the method, over all sessions.
#[derive(Debug, Serialize)]
struct Row {
    cameras: &'static str,
    arm: String,
    sessions: Vec<Statistics>,
}

/// The row that all others are compared with, session by session: the spread over sessions hides paired differences.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference {
    /// Name of the variant.
    pub arm: &'static str,
    /// Compared columns; smaller is better.
    pub columns: &'static [&'static str],
}

/// Rows in the order in which they were first added.
#[derive(Debug)]
pub(super) struct Table {
    columns: &'static [Column],
    reference: Option<Reference>,
    rows: Vec<Row>,
}

impl Table {
    pub(super) fn new(columns: &'static [Column], reference: Option<Reference>) -> Self {
        Self { columns, reference, rows: Vec::new() }
    }

    /// Adds a session to a row. A row without values for a session must get empty statistics, because the n-th entries of
    /// all rows belong to the same session.
    pub(super) fn add(&mut self, cameras: &'static str, arm: &str, statistics: Statistics) {
        match self.row_mut(cameras, arm) {
            Some(row) => row.sessions.push(statistics),
            None => self.rows.push(Row { cameras, arm: arm.to_owned(), sessions: vec![statistics] }),
        }
    }

    /// Prints the table and writes `NAME.md` and `NAME.json` into an existing folder.
    pub(super) fn publish(&self, folder: &Path, name: &str) -> anyhow::Result<()> {
        let table = self.markdown();
        print!("{table}");
        std::fs::write(folder.join(format!("{name}.md")), table)?;
        std::fs::write(folder.join(format!("{name}.json")), serde_json::to_string_pretty(&self.rows)?)?;
        Ok(())
    }

    fn row_mut(&mut self, cameras: &str, arm: &str) -> Option<&mut Row> {
        self.rows.iter_mut().find(|row| row.cameras == cameras && row.arm == arm)
    }

    /// Means over sessions; with several sessions also standard deviations and counts against the reference.
    fn markdown(&self) -> String {
        let reference = self.reference.filter(|_| self.rows.iter().any(|row| row.sessions.len() > 1));
        let comparisons: Vec<(&str, &str)> =
            reference.map_or_else(Vec::new, |r| r.columns.iter().map(|c| (r.arm, *c)).collect());
        let mut heads: Vec<String> = self.columns.iter().map(|(name, _)| (*name).to_owned()).collect();
        heads.extend(comparisons.iter().map(|(arm, column)| format!("{arm} better in {column}")));
        let mut table = format!("| cameras | | {} |\n|---|---|{}\n", heads.join(" | "), "---|".repeat(heads.len()));
        for row in &self.rows {
            let mut cells: Vec<String> =
                self.columns.iter().map(|(name, decimals)| mean_and_spread(&row.values(name), *decimals)).collect();
            cells.extend(comparisons.iter().map(|(arm, column)| self.wins(arm, row, column)));
            table.push_str(&format!("| {} | {} | {} |\n", row.cameras, row.arm, cells.join(" | ")));
        }
        table
    }

    /// Counts the sessions in which the reference has a smaller value than `row`, of those in which the two differ.
    fn wins(&self, arm: &str, row: &Row, column: &str) -> String {
        let reference = self.rows.iter().find(|other| other.cameras == row.cameras && other.arm == arm);
        let pairs = reference.into_iter().flat_map(|reference| reference.sessions.iter().zip(&row.sessions));
        let decided: Vec<bool> = pairs
            .filter_map(|(ours, theirs)| Some((ours[column]?, theirs[column]?)))
            .filter(|(ours, theirs)| ours != theirs)
            .map(|(ours, theirs)| ours < theirs)
            .collect();
        match decided.len() {
            0 => "-".to_owned(),
            n => format!("{} of {n}", decided.iter().filter(|won| **won).count()),
        }
    }
}

impl Row {
    fn values(&self, column: &str) -> Vec<f64> {
        self.sessions.iter().filter_map(|statistics| statistics[column]).collect()
    }
}

fn mean_and_spread(values: &[f64], decimals: usize) -> String {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    match values.len() {
        0 => "-".to_owned(),
        1 => format!("{mean:.decimals$}"),
        _ => format!("{mean:.decimals$} ± {:.decimals$}", variance.sqrt()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [Column; 2] = [("error mm", 1), ("recall", 2)];

    #[test]
    fn cells_show_mean_and_standard_deviation() {
        let cell = |values: &[f64]| mean_and_spread(values, 1);
        assert_eq!([cell(&[]), cell(&[2.0]), cell(&[1.0, 3.0])], ["-", "2.0", "2.0 ± 1.4"]);
    }

    #[test]
    fn compares_rows_with_reference_per_session() {
        let reference = Reference { arm: "full", columns: &["error mm"] };
        let mut table = Table::new(&COLUMNS, Some(reference));
        let mut add = |arm, error: Option<f64>| table.add("free", arm, statistics(&COLUMNS, [error, Some(1.0)]));
        for (full, half) in [(1.0, Some(2.0)), (5.0, Some(4.0)), (3.0, Some(3.0)), (7.0, None), (8.0, Some(9.0))] {
            add("half", half);
            add("full", Some(full));
        }
        let markdown = table.markdown();
        let lines: Vec<&str> = markdown.lines().collect();
        assert_eq!(lines[0], "| cameras | | error mm | recall | full better in error mm |");
        assert!(lines[2].ends_with("| 1.00 ± 0.00 | 2 of 3 |"), "{}", lines[2]);
        assert!(lines[3].ends_with("| - |"), "{}", lines[3]);
    }

    #[test]
    fn single_session_has_neither_spread_nor_counts() {
        let reference = Reference { arm: "full", columns: &["error mm"] };
        let mut table = Table::new(&COLUMNS, Some(reference));
        table.add("free", "full", statistics(&COLUMNS, [Some(1.25), None]));
        assert_eq!(table.markdown().lines().nth(2), Some("| free | full | 1.2 | - |"));
    }
}
