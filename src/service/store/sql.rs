//! The SQL layer. Statements have one text for SQLite and PostgreSQL: parameters are `$1`, sums are cast to BIGINT, existence is 0 or
//! 1, and the functions of SQLite that they call exist in PostgreSQL, too (`migrations/postgres`).
//!
//! Without the feature `scale` the types are SQLite's own, so the embedded service pays nothing; with it they are `sqlx::Any`, which
//! holds either.

#[cfg(feature = "scale")]
pub(crate) use sqlx::Any as Db;
use sqlx::Database;
#[cfg(not(feature = "scale"))]
pub(crate) use sqlx::Sqlite as Db;
use sqlx::query::Query;
use sqlx::{AssertSqlSafe, Pool, Transaction};

/// A pool of connections.
pub(crate) type SqlPool = Pool<Db>;

/// A row of an answer.
pub(crate) type SqlRow = <Db as Database>::Row;

/// Options of one connection.
#[cfg(feature = "scale")]
pub(crate) type SqlOptions = <<Db as Database>::Connection as sqlx::Connection>::Options;

/// The settings of a pool.
#[cfg(feature = "scale")]
pub(crate) type SqlPoolOptions = sqlx::pool::PoolOptions<Db>;

/// An open transaction that may write.
pub(crate) type WriteTransaction = Transaction<'static, Db>;

/// A number that may be missing, as a parameter.
#[cfg(not(feature = "scale"))]
pub(crate) type Float = f64;

/// A number that may be missing, as a parameter. `sqlx::Any` announces a missing f64 to PostgreSQL as a number of four bytes, and the
/// statement, which is prepared once, then refuses numbers of eight; what it announces for a missing f32 is right.
#[cfg(feature = "scale")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Float(f64);

#[cfg(feature = "scale")]
impl sqlx::Type<Db> for Float {
    fn type_info() -> <Db as Database>::TypeInfo {
        <f32 as sqlx::Type<Db>>::type_info()
    }
}

#[cfg(feature = "scale")]
impl sqlx::Encode<'_, Db> for Float {
    fn encode_by_ref(
        &self,
        buffer: &mut <Db as Database>::ArgumentBuffer,
    ) -> Result<sqlx::encode::IsNull, sqlx::error::BoxDynError> {
        <f64 as sqlx::Encode<Db>>::encode_by_ref(&self.0, buffer)
    }
}

/// A parameter of a number that may be missing.
pub(crate) fn float(value: Option<f64>) -> Option<Float> {
    #[cfg(feature = "scale")]
    return value.map(Float);
    #[cfg(not(feature = "scale"))]
    value
}

/// Most rows of one statement: with ten columns far below the parameters that it may have (32,766 with SQLite, 65,535 with PostgreSQL).
pub(super) const ROWS_IN_ONE_STATEMENT: usize = 1000;

/// The statement that inserts so many rows, whose values are bound row by row. One for many rows, since a server far away answers each
/// one after a round trip.
pub(super) fn insert_rows<'q>(
    table: &'static str,
    columns: &[&'static str],
    n_rows: usize,
) -> Query<'q, Db, <Db as Database>::Arguments> {
    let text = format!("INSERT INTO {table} ({}) VALUES {}", columns.join(", "), places(n_rows, columns.len()));
    sqlx::query(AssertSqlSafe(text)).persistent(false) // the text is our own; it depends on the number of rows
}

/// Places of the values of several rows: `($1, $2), ($3, $4)`.
fn places(n_rows: usize, n_columns: usize) -> String {
    let row = |row: usize| {
        let places: Vec<String> = (1..=n_columns).map(|column| format!("${}", row * n_columns + column)).collect();
        format!("({})", places.join(", "))
    };
    (0..n_rows).map(row).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    #[test]
    fn places_count_on_through_the_rows() {
        assert_eq!(super::places(2, 3), "($1, $2, $3), ($4, $5, $6)");
    }
}
