//! The service as its clients meet it: the real binary on a free port, spoken to over HTTP.
#![cfg(feature = "service")]
#![allow(clippy::unwrap_used, missing_docs)]

mod crashes;
mod errors;
mod http;
mod jobs;
mod results;
mod server;
mod take;
mod uploads;
