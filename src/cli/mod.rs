//! The command line: one file per command.

#[cfg(any(test, feature = "service"))]
mod arguments;
mod bad_input;
mod bench;
mod body;
mod broken_pipe;
mod completions;
mod evaluate;
mod export;
mod noise;
mod option_flags;
mod options;
mod output_folder;
mod prior;
mod progress_display;
mod reconstruct;
mod simulate;
mod solve;
mod summary;

#[cfg(feature = "service")]
mod child;
#[cfg(feature = "service")]
mod client;
#[cfg(feature = "service")]
mod confinement;
#[cfg(feature = "service")]
mod data_folder;
#[cfg(feature = "service")]
mod demo;
#[cfg(feature = "service")]
mod key;
#[cfg(feature = "service")]
mod mcp;
#[cfg(feature = "service")]
mod migrate;
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
#[cfg(feature = "service")]
mod view;

use bad_input::BadInput;
use clap::{CommandFactory, Parser, Subcommand};
use std::io::IsTerminal;
use std::process::ExitCode;
use summary::RejectedResult;
use tracing_subscriber::EnvFilter;

/// Reconstructs moving people and the cameras that filmed them from 2D poses, without a calibration wand.
///
/// Exit codes: 0 done, 1 failed, 2 wrong usage or unusable input, 3 a result was written but its verdict is `reject`.
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
    /// List every option of a job with type, default, range and effect
    Options(options::Args),
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
    /// Serve the job API to agents over the Model Context Protocol, on stdin and stdout
    #[cfg(feature = "service")]
    Mcp(mcp::Args),
    /// Open the viewer on a result folder, without a service
    #[cfg(feature = "service")]
    View(view::Args),
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
    /// Bring a database to this release's tables, or move a service to PostgreSQL and an object store
    #[cfg(feature = "service")]
    Migrate(migrate::Args),
    /// Verify every file of a data folder or a backup
    #[cfg(feature = "service")]
    Verify(operator::VerifyArgs),
    /// Check whether a service is ready (for container health checks)
    #[cfg(feature = "service")]
    Health(operator::HealthArgs),
    /// Print the OpenAPI description of the HTTP API
    #[cfg(feature = "service")]
    Openapi,
    /// Print the completion script of a shell
    Completions(completions::Args),
    /// Solve one job (child process of the service)
    #[cfg(feature = "service")]
    #[command(hide = true)]
    RunJob,
    /// Read one upload (child process of the service)
    #[cfg(feature = "service")]
    #[command(hide = true)]
    ReadUpload,
}

/// Runs the command line; exit code 0: done, 1: failed, 2: wrong usage or unusable input, 3: written, but with the verdict
/// `reject`.
pub fn main() -> ExitCode {
    broken_pipe::end_quietly();
    let cli = Cli::parse(); // exits with 2 on wrong usage
    let filter = EnvFilter::try_from_env("WANDLESS_LOG").unwrap_or_else(|_| EnvFilter::new(default_level(&cli)));
    // https://no-color.org: any non-empty value switches colours off.
    let has_colours =
        std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(has_colours);
    match log_form(&cli) {
        LogForm::Plain => log.without_time().with_target(false).init(),
        #[cfg(feature = "service")]
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
        Command::Options(args) => {
            options::run(&args);
            Ok(())
        }
        Command::Simulate(args) => simulate::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Body(args) => body::run(args),
        Command::Prior(args) => prior::run(args),
        #[cfg(feature = "service")]
        Command::Serve(args) => serve::run(args),
        #[cfg(feature = "service")]
        Command::Submit(args) => submit::run(args),
        #[cfg(feature = "service")]
        Command::Mcp(args) => mcp::run(&args),
        #[cfg(feature = "service")]
        Command::View(args) => view::run(args),
        #[cfg(feature = "service")]
        Command::Demo(args) => demo::run(args),
        #[cfg(feature = "service")]
        Command::Key(args) => key::run(args),
        #[cfg(feature = "service")]
        Command::Backup(args) => operator::back_up(args),
        #[cfg(feature = "service")]
        Command::Restore(args) => operator::restore(args),
        #[cfg(feature = "service")]
        Command::Migrate(args) => migrate::run(args),
        #[cfg(feature = "service")]
        Command::Verify(args) => operator::verify(args),
        #[cfg(feature = "service")]
        Command::Health(args) => operator::health(args),
        #[cfg(feature = "service")]
        Command::Openapi => {
            println!("{}", crate::service::http::openapi_json());
            Ok(())
        }
        Command::Completions(args) => {
            completions::run(&args, &Cli::command());
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
            ExitCode::from(exit_code(&error))
        }
    }
}

/// Exit code of an error: 2 for unusable input, 3 for a result that should not be used, otherwise 1.
fn exit_code(error: &anyhow::Error) -> u8 {
    match error {
        _ if error.is::<BadInput>() => 2,
        _ if error.is::<RejectedResult>() => 3,
        _ => 1,
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
    /// Lines without time, for a command that a person waits for.
    Plain,
    /// Lines with time, for the service.
    #[cfg(feature = "service")]
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
        Command::Serve(_) => LogForm::Text,
        #[cfg(feature = "service")]
        Command::RunJob | Command::ReadUpload => LogForm::Child,
        _ => LogForm::Plain,
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

    #[test]
    fn command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
