//! The data folder: one SQLite database and the files that its rows refer to; with the feature `scale` a PostgreSQL server and an object
//! store take their places. Only this module accesses any of them directly.

pub mod artifacts;
pub(crate) mod blobs;
pub(crate) mod clock;
pub mod database;
pub mod error;
pub mod folders;
pub mod keys;
pub mod listing;
mod log;
mod migrations;
mod open;
pub(crate) mod pages;
#[cfg(feature = "scale")]
pub(crate) mod postgres;
pub(crate) mod private;
pub(crate) mod published;
pub mod random;
pub mod reservation;
mod schema;
pub mod sessions;
mod shrink;
mod space;
pub(crate) mod sql;
mod sqlite;
pub mod summary;
pub mod tenants;

#[cfg(test)]
pub(crate) mod test_support;
#[cfg(test)]
mod tests;

pub use database::{DiskUsage, Store};
pub use error::StoreError;
pub use folders::{DATABASE, Folders};
pub use random::new_id;
pub use tenants::Tenant;
