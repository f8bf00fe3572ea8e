//! The default body (tests M1 to M14 and M16 of its design) and the loader of body files.

#![allow(clippy::unwrap_used)] // a test may

mod anthropometry;
mod capsules;
mod intersections;
mod loader;
mod mesh;
mod posing;

use std::sync::OnceLock;
use wandless::body::generator::{GeneratedBody, generate};

/// The body made anew; once a process, for it takes seconds.
fn generated() -> &'static GeneratedBody {
    static BODY: OnceLock<GeneratedBody> = OnceLock::new();
    BODY.get_or_init(generate)
}
