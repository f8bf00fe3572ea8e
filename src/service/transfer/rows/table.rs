//! One table: its columns, its rows from SQLite as JSON, and what PostgreSQL reads back.

use super::super::error::TransferError;
use super::super::source::Source;
use futures_util::TryStreamExt;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};
use sqlx::postgres::PgConnection;
use sqlx::sqlite::SqliteRow;
use sqlx::{AssertSqlSafe, Column, Row, TypeInfo, ValueRef};

/// Rows of one statement.
const BATCH: usize = 500;

/// The escape of U+0000 in JSON, and what stands for that character in a text.
const NUL_ESCAPE: &str = "\\u0000";
const REPLACEMENT: char = '\u{fffd}';

/// A table that is moved.
pub(super) struct Definition {
    pub(super) name: &'static str,
    /// Columns that order the rows without ties.
    key: &'static [&'static str],
}

/// Every table, those that others refer to first.
pub(super) const TABLES: [Definition; 14] = [
    Definition { name: "tenants", key: &["name"] },
    Definition { name: "api_keys", key: &["id"] },
    Definition { name: "sessions", key: &["seq"] },
    Definition { name: "jobs", key: &["seq"] },
    Definition { name: "job_labels", key: &["seq", "key"] },
    Definition { name: "idempotency", key: &["tenant", "key"] },
    Definition { name: "artifacts", key: &["job_id", "name"] },
    Definition { name: "verdicts", key: &["job_id"] },
    Definition { name: "stage_metrics", key: &["job_id", "stage_index"] },
    Definition { name: "stage_metric_values", key: &["job_id", "stage_index", "name"] },
    Definition { name: "camera_results", key: &["job_id", "camera_index"] },
    Definition { name: "person_results", key: &["job_id", "person"] },
    Definition { name: "webhook_deliveries", key: &["seq"] },
    Definition { name: "clock", key: &["seen_at"] },
];

/// A table and the columns that it has in both databases.
pub(super) struct Table {
    name: &'static str,
    columns: Vec<String>,
    /// Columns that order the rows without ties.
    key: &'static [&'static str],
}

impl Table {
    /// Reads the columns of the source; each must be one of the target.
    pub(super) async fn read(
        definition: Definition,
        source: &Source,
        target: &mut PgConnection,
    ) -> Result<Self, TransferError> {
        let Definition { name, key } = definition;
        let columns = sqlx::query_scalar("SELECT name FROM pragma_table_info($1) ORDER BY cid").bind(name);
        let columns: Vec<String> = columns.fetch_all(&source.database).await?;
        let known = "SELECT column_name::text FROM information_schema.columns
                     WHERE table_schema = current_schema() AND table_name = $1";
        let known: Vec<String> = sqlx::query_scalar(known).bind(name).fetch_all(target).await?;
        match columns.iter().find(|column| !known.contains(column)) {
            Some(column) => Err(TransferError::Unknown { what: format!("the column {column} of {name}") }),
            None => Ok(Self { name, columns, key }),
        }
    }

    /// Copies all rows; returns their number. Texts that the server cannot store are changed and noted.
    pub(super) async fn copy(
        &self,
        source: &Source,
        target: &mut PgConnection,
        replaced: &mut Vec<String>,
    ) -> Result<u64, TransferError> {
        let columns = self.columns.join(", ");
        let insert = format!(
            "INSERT INTO {0} ({columns}) OVERRIDING SYSTEM VALUE
             SELECT {columns} FROM json_populate_recordset(NULL::{0}, $1::json)",
            self.name
        );
        let statement = self.statement();
        let mut rows = sqlx::query(AssertSqlSafe(statement)).fetch(&source.database);
        let (mut batch, mut n_rows) = (Vec::with_capacity(BATCH), 0);
        loop {
            let row = rows.try_next().await?;
            if let Some(row) = &row {
                batch.push(Value::Object(self.object(row, replaced)?));
            }
            if batch.len() == BATCH || (row.is_none() && !batch.is_empty()) {
                let text = Value::Array(std::mem::take(&mut batch)).to_string();
                let inserted = sqlx::query(AssertSqlSafe(insert.clone())).bind(text).execute(&mut *target).await?;
                n_rows += inserted.rows_affected();
            }
            if row.is_none() {
                return Ok(n_rows);
            }
        }
    }

    /// Compares every value of every row with what was read.
    pub(super) async fn compare(&self, source: &Source, target: &mut PgConnection) -> Result<(), TransferError> {
        let (mut expected, mut n_expected) = (Sha256::new(), 0_u64);
        let statement = self.statement();
        let mut rows = sqlx::query(AssertSqlSafe(statement)).fetch(&source.database);
        while let Some(row) = rows.try_next().await? {
            expected.update(self.canonical(&self.object(&row, &mut Vec::new())?));
            n_expected += 1;
        }
        let order: Vec<String> = self.key.iter().map(|column| format!("{column}{}", collation(column))).collect();
        let statement = format!(
            "SELECT row_to_json(found)::text FROM (SELECT {} FROM {} ORDER BY {}) AS found",
            self.columns.join(", "),
            self.name,
            order.join(", ")
        );
        let (mut found, mut n_found) = (Sha256::new(), 0_u64);
        let mut rows = sqlx::query_scalar::<_, String>(AssertSqlSafe(statement)).fetch(target);
        while let Some(row) = rows.try_next().await? {
            let row: Map<String, Value> =
                serde_json::from_str(&row).map_err(crate::service::store::StoreError::from)?;
            found.update(self.canonical(&row));
            n_found += 1;
        }
        if n_expected == n_found && expected.finalize() == found.finalize() {
            return Ok(());
        }
        Err(TransferError::Differs { table: self.name })
    }

    /// Reads all rows of the source in their order, texts by bytes.
    fn statement(&self) -> String {
        format!("SELECT {} FROM {} ORDER BY {}", self.columns.join(", "), self.name, self.key.join(", "))
    }

    fn object(&self, row: &SqliteRow, replaced: &mut Vec<String>) -> Result<Map<String, Value>, TransferError> {
        let mut object = Map::new();
        for (at, column) in row.columns().iter().enumerate() {
            let raw = row.try_get_raw(at)?;
            // Of a missing value the type is that of its column.
            let kind = if raw.is_null() { "NULL".to_owned() } else { raw.type_info().name().to_owned() };
            let value = match kind.as_str() {
                "NULL" => Value::Null,
                "INTEGER" => row.try_get::<i64, _>(at)?.into(),
                "REAL" => number(row.try_get(at)?),
                "TEXT" => Value::String(storable(column.name(), row.try_get(at)?, || {
                    replaced.push(format!("{}.{}", self.name, column.name()));
                })),
                kind => {
                    let what = format!("a value of the type {kind} in {}.{}", self.name, column.name());
                    return Err(TransferError::Unknown { what });
                }
            };
            object.insert(column.name().to_owned(), value);
        }
        Ok(object)
    }

    /// The values of a row in the order of the columns. A number is written by its bits: the server writes 1 for 1.0.
    fn canonical(&self, row: &Map<String, Value>) -> String {
        let values = self.columns.iter().map(|column| match row.get(column) {
            Some(Value::Number(number)) => match number.as_i64() {
                Some(whole) => (whole as f64).to_bits().to_string() + "/" + &whole.to_string(),
                None => {
                    let value = number.as_f64().unwrap_or(f64::NAN);
                    // A whole number in a column of numbers reads back without its point.
                    let whole =
                        if value.fract() == 0.0 && value.abs() < 1e15 { format!("{value:.0}") } else { String::new() };
                    value.to_bits().to_string() + "/" + &whole
                }
            },
            Some(other) => other.to_string(),
            None => String::new(),
        });
        values.map(|value| value + "\u{1f}").collect::<String>() + "\u{1e}"
    }
}

/// PostgreSQL orders texts by language, SQLite by bytes.
fn collation(column: &str) -> &'static str {
    if ["seq", "stage_index", "camera_index", "person", "seen_at"].contains(&column) { "" } else { " COLLATE \"C\"" }
}

/// Infinite numbers have no JSON; the server reads their names.
fn number(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or_else(|| Value::String(value.to_string()), Value::Number)
}

/// A text that the server can store.
fn storable(column: &str, text: String, mut note: impl FnMut()) -> String {
    if text.contains('\0') {
        note();
        return text.replace('\0', &REPLACEMENT.to_string());
    }
    // The server takes labels apart, which it cannot where their JSON has the escape.
    let labels =
        (column == "labels" && text.contains(NUL_ESCAPE)).then(|| serde_json::from_str::<Map<String, Value>>(&text));
    let Some(Ok(labels)) = labels else { return text };
    note();
    let clean = |text: &str| text.replace('\0', &REPLACEMENT.to_string());
    let labels = labels.iter().map(|(key, value)| (clean(key), Value::String(clean(value.as_str().unwrap_or("")))));
    Value::Object(labels.collect()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_with_nul_is_changed_and_noted() {
        let stored = |column, text: &str| {
            let mut notes = 0;
            (storable(column, text.to_owned(), || notes += 1), notes)
        };
        assert_eq!(stored("name", "a\0b"), ("a\u{fffd}b".to_owned(), 1));
        assert_eq!(stored("labels", r#"{"a":"b\u0000"}"#), ("{\"a\":\"b\u{fffd}\"}".to_owned(), 1));
        assert_eq!(stored("labels", r#"{"a":"b"}"#), (r#"{"a":"b"}"#.to_owned(), 0));
    }

    #[test]
    fn rows_are_compared_by_value() {
        let table = Table { name: "t", columns: vec!["a".to_owned()], key: &["a"] };
        let canonical = |value: Value| table.canonical(&Map::from_iter([("a".to_owned(), value)]));
        let read = |text: &str| canonical(serde_json::from_str(text).unwrap());
        assert_eq!(canonical(number(1.0)), read("1"));
        assert_eq!(canonical(number(0.1)), read("0.1"));
        assert_eq!(canonical(number(1e300)), read("1e+300"));
        assert_ne!(canonical(number(0.1)), read("0.10000000000000002"));
        assert_ne!(canonical(i64::MAX.into()), canonical((i64::MAX - 1).into()));
        assert_ne!(canonical(Value::Null), canonical("".into()));
    }
}
