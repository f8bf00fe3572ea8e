//! The data folder: one SQLite database and the files that its rows refer to. Only this module accesses either directly.

pub mod artifacts;
pub(crate) mod clock;
pub mod database;
pub mod error;
pub mod folders;
pub mod keys;
pub mod listing;
mod log;
pub(crate) mod pages;
pub(crate) mod private;
pub mod random;
pub mod reservation;
mod schema;
pub mod sessions;
mod shrink;
mod space;
pub mod summary;
pub mod tenants;

#[cfg(test)]
mod tests;

pub use database::{DiskUsage, Store};
pub use error::StoreError;
pub use folders::{DATABASE, Folders};
pub use random::new_id;
pub use tenants::Tenant;
