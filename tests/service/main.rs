//! Tests of the service over HTTP: the real binary on a free port.
#![cfg(feature = "service")]
#![allow(clippy::unwrap_used)] // an unexpected value fails the test
#![allow(unreachable_pub)] // the modules share items; a test binary exports nothing

mod commands;
mod corrections;
mod crashes;
mod errors;
mod front;
mod http;
mod jobs;
mod operations;
mod results;
mod server;
#[path = "../fixtures/stick_figure.rs"]
mod stick_figure;
mod store;
mod take;
mod tenants;
mod uploads;
