//! The command line: one file per command.

#[cfg(any(test, feature = "service"))]
mod arguments;
mod bad_input;
mod bench;
mod body;
mod evaluate;
mod export;
mod noise;
mod output_folder;
mod prior;
mod progress_display;
mod reconstruct;
mod simulate;
mod solve;

#[cfg(feature = "service")]
mod child;
#[cfg(feature = "service")]
mod client;
#[cfg(feature = "service")]
mod confinement;
#[cfg(feature = "service")]
mod demo;
#[cfg(feature = "service")]
mod key;
#[cfg(feature = "service")]
mod operator;
#[cfg(feature = "service")]
mod read_upload;
#[cfg(feature = "service")]
mod run_job;
#[cfg(feature = "service")]
mod serve;
#[cfg(feature = "service")]
mod submit;

use bad_input::BadInput;
use clap::{Parser, Subcommand};
use std::io::IsTerminal;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Reconstructs moving people and the cameras that filmed them from 2D poses, without a calibration wand.
#[derive(Debug, Parser)]
#[command(name = "wandless", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Reconstruct a session locally, without a server
    Reconstruct(reconstruct::Args),
    /// Compare a result with the ground truth
    Evaluate(evaluate::Args),
    /// Export a finished result to further formats
    Export(export::Args),
    /// Simulate a session with exact ground truth
    Simulate(simulate::Args),
    /// Measure accuracy, robustness and speed
    Bench(bench::Args),
    /// Inspect, register and export body models
    Body(body::Args),
    /// Train, evaluate and sample the motion prior
    Prior(prior::Args),
    /// Run the HTTP service
    #[cfg(feature = "service")]
    Serve(serve::Args),
    /// Upload a session to a service, follow its job and download the result
    #[cfg(feature = "service")]
    Submit(submit::Args),
    /// Simulate a session, solve it through a local service and evaluate the result
    #[cfg(feature = "service")]
    Demo(demo::Args),
    /// Create, list and revoke API keys
    #[cfg(feature = "service")]
    Key(key::Args),
    /// Back up a data folder; the service may keep running
    #[cfg(feature = "service")]
    Backup(operator::BackupArgs),
    /// Restore a data folder from a backup
    #[cfg(feature = "service")]
    Restore(operator::RestoreArgs),
    /// Verify every file of a data folder or a backup
    #[cfg(feature = "service")]
    Verify(operator::VerifyArgs),
    /// Check whether a service is ready (for container health checks)
    #[cfg(feature = "service")]
    Health(operator::HealthArgs),
    /// Print the OpenAPI description of the HTTP API
    #[cfg(feature = "service")]
    Openapi,
    /// Solve one job (child process of the service)
    #[cfg(feature = "service")]
    #[command(hide = true)]
    RunJob,
    /// Read one upload (child process of the service)
    #[cfg(feature = "service")]
    #[command(hide = true)]
    ReadUpload,
}

/// Runs the command line; exit code 0: done, 1: failed, 2: wrong usage or unusable input.
pub fn main() -> ExitCode {
    let cli = Cli::parse(); // exits with 2 on wrong usage
    let filter = EnvFilter::try_from_env("WANDLESS_LOG").unwrap_or_else(|_| EnvFilter::new(default_level(&cli)));
    let is_terminal = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(is_terminal);
    match log_form(&cli) {
        LogForm::Text => log.init(),
        #[cfg(feature = "service")]
        LogForm::Json => log.json().flatten_event(true).init(),
        #[cfg(feature = "service")]
        LogForm::Child => log.without_time().init(),
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
            println!("{}", crate::service::http::openapi_json());
            Ok(())
        }
        #[cfg(feature = "service")]
        Command::RunJob => return run_job::run(),
        #[cfg(feature = "service")]
        Command::ReadUpload => return read_upload::run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wandless: {}", one_line(&error));
            ExitCode::from(if error.is::<BadInput>() { 2 } else { 1 })
        }
    }
}

/// The error and its causes on one line. A cause that an outer message already contains is not repeated.
fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if !line.contains(&cause) {
            line = if line.is_empty() { cause } else { format!("{line}: {cause}") };
        }
    }
    line
}

/// Form of the log on stderr.
enum LogForm {
    /// Lines to read.
    Text,
    /// One JSON object per line (an option of `serve`).
    #[cfg(feature = "service")]
    Json,
    /// Lines that the service repeats in its own log, with its own time.
    #[cfg(feature = "service")]
    Child,
}

fn log_form(cli: &Cli) -> LogForm {
    match &cli.command {
        #[cfg(feature = "service")]
        Command::Serve(args) if args.log_format == serve::LogFormat::Json => LogForm::Json,
        #[cfg(feature = "service")]
        Command::RunJob | Command::ReadUpload => LogForm::Child,
        _ => LogForm::Text,
    }
}

/// Default log level: `info` for the service, `warn` for other commands, which print their results themselves.
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
    fn command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
