//! The commands; one file each.

pub mod bench;
mod body;
mod evaluate;
mod export;
mod meter;
mod prior;
mod reconstruct;
pub mod simulate;
mod solve;

#[cfg(feature = "service")]
mod client;
#[cfg(feature = "service")]
mod demo;
#[cfg(feature = "service")]
mod key;
#[cfg(feature = "service")]
mod operator;
#[cfg(feature = "service")]
mod run_job;
#[cfg(feature = "service")]
mod serve;
#[cfg(feature = "service")]
mod submit;

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Recovers moving people and the cameras that filmed them, without a calibration wand.
#[derive(Debug, Parser)]
#[command(name = "wandless", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Solve a session without a server
    Reconstruct(reconstruct::Args),
    /// Compare a result with the truth
    Evaluate(evaluate::Args),
    /// Write a finished result in further formats
    Export(export::Args),
    /// Make a session with exact truth
    Simulate(simulate::Args),
    /// Measure success and speed
    Bench(bench::Args),
    /// Look at a body model, or write it in other formats
    Body(body::Args),
    /// Train, measure and look at the motion prior
    Prior(prior::Args),
    /// Serve sessions and jobs over HTTP
    #[cfg(feature = "service")]
    Serve(serve::Args),
    /// Upload a session, follow its job, download the result
    #[cfg(feature = "service")]
    Submit(submit::Args),
    /// Simulate, serve, submit and evaluate in one go
    #[cfg(feature = "service")]
    Demo(demo::Args),
    /// Make, list and revoke API keys
    #[cfg(feature = "service")]
    Key(key::Args),
    /// Copy a data folder, its service may be at work
    #[cfg(feature = "service")]
    Backup(operator::BackupArgs),
    /// Make a data folder out of a backup
    #[cfg(feature = "service")]
    Restore(operator::RestoreArgs),
    /// Check every byte of a data folder or a backup
    #[cfg(feature = "service")]
    Verify(operator::VerifyArgs),
    /// Ask a service whether it is ready; for health checks
    #[cfg(feature = "service")]
    Health(operator::HealthArgs),
    /// Print the description of the HTTP API
    #[cfg(feature = "service")]
    Openapi,
    /// One job in a child process of the service
    #[cfg(feature = "service")]
    #[command(hide = true)]
    RunJob,
}

/// The input cannot be used: exit code 2 and one line that names what, where and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadInput(pub String);

/// Runs the command line; the exit code is 0 for done, 1 for failed, 2 for wrong usage or bad input.
pub fn main() -> ExitCode {
    let cli = Cli::parse(); // ends with 2 for wrong usage
    let filter = EnvFilter::try_from_env("WANDLESS_LOG").unwrap_or_else(|_| EnvFilter::new(default_level(&cli)));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    match wants_json_log(&cli) {
        true => log.json().flatten_event(true).init(),
        false => log.init(),
    }
    let done = match cli.command {
        Command::Reconstruct(args) => reconstruct::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Export(args) => export::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Body(args) => body::run(args),
        Command::Prior(args) => prior::run(args),
        #[cfg(feature = "service")]
        Command::Serve(args) => serve::run(args),
        #[cfg(feature = "service")]
        Command::Submit(args) => submit::run(args),
        #[cfg(feature = "service")]
        Command::Demo(args) => demo::run(args),
        #[cfg(feature = "service")]
        Command::Key(args) => key::run(args),
        #[cfg(feature = "service")]
        Command::Backup(args) => operator::back_up(args),
        #[cfg(feature = "service")]
        Command::Restore(args) => operator::restore(args),
        #[cfg(feature = "service")]
        Command::Verify(args) => operator::verify(args),
        #[cfg(feature = "service")]
        Command::Health(args) => operator::health(args),
        #[cfg(feature = "service")]
        Command::Openapi => {
            println!("{}", crate::service::http::openapi::text());
            Ok(())
        }
        #[cfg(feature = "service")]
        Command::RunJob => return run_job::run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wandless: {}", told(&error));
            ExitCode::from(if error.is::<BadInput>() { 2 } else { 1 })
        }
    }
}

/// The error and its causes in one line; what an error has said of its cause is not said again.
fn told(error: &anyhow::Error) -> String {
    let mut told = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if !told.contains(&cause) {
            told = if told.is_empty() { cause } else { format!("{told}: {cause}") };
        }
    }
    told
}

/// Log collectors read JSON; people do not.
fn wants_json_log(cli: &Cli) -> bool {
    match &cli.command {
        #[cfg(feature = "service")]
        Command::Serve(args) => args.log_format == serve::LogFormat::Json,
        _ => false,
    }
}

/// A service tells its operator what it does; a command speaks for itself.
fn default_level(cli: &Cli) -> &'static str {
    match cli.command {
        #[cfg(feature = "service")]
        Command::Serve(_) => "info",
        _ => "warn",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
