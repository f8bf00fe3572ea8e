//! Parses the arguments of a single command.

use clap::Parser;
use std::ffi::OsString;

#[derive(Parser)]
struct Arguments<T: clap::Args> {
    #[command(flatten)]
    args: T,
}

/// Parses `words`, the first of which is the name of the command.
///
/// # Errors
/// Wrong usage, as on the command line.
pub(super) fn arguments_of<T: clap::Args>(
    words: impl IntoIterator<Item = impl Into<OsString> + Clone>,
) -> Result<T, clap::Error> {
    Ok(Arguments::try_parse_from(words)?.args)
}
