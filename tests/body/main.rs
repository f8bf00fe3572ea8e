//! Tests of the default body and of the loader of body files.

#![allow(clippy::unwrap_used)] // a test may

mod anthropometry;
mod capsules;
mod hips;
mod intersections;
mod loader;
mod mesh;
mod posing;

use std::sync::OnceLock;
use wandless::body::generator::{GeneratedBody, generate};

/// The generated body; generated once a process, since it takes seconds.
fn generated() -> &'static GeneratedBody {
    static BODY: OnceLock<GeneratedBody> = OnceLock::new();
    BODY.get_or_init(generate)
}
