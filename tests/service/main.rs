//! The service as its clients meet it: the real binary on a free port, spoken to over HTTP.
#![cfg(feature = "service")]
#![allow(clippy::unwrap_used)] // a test that meets what it did not expect has failed
#![allow(unreachable_pub)] // the modules share with each other, a test binary exports nothing

mod crashes;
mod errors;
mod http;
mod jobs;
mod operations;
mod results;
mod server;
#[path = "../fixtures/stick_figure.rs"]
mod stick_figure;
mod take;
mod tenants;
mod uploads;
