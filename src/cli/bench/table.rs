//! Tables of figures over sessions: one row a way of solving; as Markdown and as JSON.

use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Figures of one solve, by column; `None` where there is none to tell.
pub(super) type Figures = BTreeMap<&'static str, Option<f64>>;

/// Name of a column and the decimals that are worth reading.
pub(super) type Column = (&'static str, usize);

/// Figures of the columns, in their order.
pub(super) fn figures(columns: &[Column], values: impl IntoIterator<Item = Option<f64>>) -> Figures {
    columns.iter().map(|(name, _)| *name).zip(values).collect()
}

/// One way of solving, over all sessions.
#[derive(Debug, Serialize)]
struct Row {
    cameras: &'static str,
    arm: String,
    sessions: Vec<Figures>,
}

/// A row that all others are compared with, session by session: the spread over sessions hides what happens in each.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference {
    /// Its arm.
    pub arm: &'static str,
    /// In these columns; less is better.
    pub columns: &'static [&'static str],
}

/// Rows in order of their first figures.
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

    /// One more session of a row. A row without a figure for a session gets empty ones: the n-th of every row are of the
    /// same session.
    pub(super) fn add(&mut self, cameras: &'static str, arm: &str, figures: Figures) {
        match self.row_mut(cameras, arm) {
            Some(row) => row.sessions.push(figures),
            None => self.rows.push(Row { cameras, arm: arm.to_owned(), sessions: vec![figures] }),
        }
    }

    /// Prints the table and writes `NAME.md` and `NAME.json` into a folder that there is.
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

    /// Means over sessions, with standard deviations and, against the reference, counts where there are several.
    fn markdown(&self) -> String {
        let reference = self.reference.filter(|_| self.rows.iter().any(|row| row.sessions.len() > 1));
        let duels: Vec<(&str, &str)> =
            reference.map_or_else(Vec::new, |r| r.columns.iter().map(|c| (r.arm, *c)).collect());
        let mut heads: Vec<String> = self.columns.iter().map(|(name, _)| (*name).to_owned()).collect();
        heads.extend(duels.iter().map(|(arm, column)| format!("{arm} has less {column}")));
        let mut table = format!("| cameras | | {} |\n|---|---|{}\n", heads.join(" | "), "---|".repeat(heads.len()));
        for row in &self.rows {
            let mut cells: Vec<String> =
                self.columns.iter().map(|(name, decimals)| mean_and_spread(&row.values(name), *decimals)).collect();
            cells.extend(duels.iter().map(|(arm, column)| self.wins(arm, row, column)));
            table.push_str(&format!("| {} | {} | {} |\n", row.cameras, row.arm, cells.join(" | ")));
        }
        table
    }

    /// In how many sessions the arm of the same cameras has less than `row`, of those in which the two differ.
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
        self.sessions.iter().filter_map(|figures| figures[column]).collect()
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
    fn cells_tell_mean_and_spread() {
        let cell = |values: &[f64]| mean_and_spread(values, 1);
        assert_eq!([cell(&[]), cell(&[2.0]), cell(&[1.0, 3.0])], ["-", "2.0", "2.0 ± 1.4"]);
    }

    #[test]
    fn rows_are_compared_with_the_reference_session_by_session() {
        let reference = Reference { arm: "whole", columns: &["error mm"] };
        let mut table = Table::new(&COLUMNS, Some(reference));
        let mut add = |arm, error: Option<f64>| table.add("free", arm, figures(&COLUMNS, [error, Some(1.0)]));
        for (whole, half) in [(1.0, Some(2.0)), (5.0, Some(4.0)), (3.0, Some(3.0)), (7.0, None), (8.0, Some(9.0))] {
            add("half", half);
            add("whole", Some(whole));
        }
        let told = table.markdown();
        let lines: Vec<&str> = told.lines().collect();
        assert_eq!(lines[0], "| cameras | | error mm | recall | whole has less error mm |");
        assert!(lines[2].ends_with("| 1.00 ± 0.00 | 2 of 3 |"), "{}", lines[2]);
        assert!(lines[3].ends_with("| - |"), "{}", lines[3]);
    }

    #[test]
    fn one_session_has_no_spread_and_no_counts() {
        let reference = Reference { arm: "whole", columns: &["error mm"] };
        let mut table = Table::new(&COLUMNS, Some(reference));
        table.add("free", "whole", figures(&COLUMNS, [Some(1.25), None]));
        assert_eq!(table.markdown().lines().nth(2), Some("| free | whole | 1.2 | - |"));
    }
}
