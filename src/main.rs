//! The `wandless` binary.
fn main() {}
