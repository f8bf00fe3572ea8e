//! The `wandless` binary.

use std::process::ExitCode;

fn main() -> ExitCode {
    wandless::cli::main()
}
