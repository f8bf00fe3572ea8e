//! `wandless serve`: the service until a signal.

use super::BadInput;
use crate::service::settings::{DEFAULT_DATA, DEFAULT_LISTEN};
use crate::service::{self, ServeError, Settings};
use anyhow::Context;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::signal::unix::{SignalKind, signal};

/// Arguments of `serve`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of the database, the uploads and the results
    #[arg(long, default_value = DEFAULT_DATA)]
    data: PathBuf,
    /// Address to listen on; port 0 takes a free one
    #[arg(long, default_value = DEFAULT_LISTEN)]
    listen: SocketAddr,
}

/// A stop that takes longer than this is cut.
const HARD_STOP: Duration = Duration::from_secs(30);

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let settings = Settings::new(args.data, args.listen).context("the path of this program")?;
    let runtime = Runtime::new()?;
    let done = runtime.block_on(serve(settings));
    runtime.shutdown_timeout(Duration::from_secs(1)); // a blocked file operation must not hold the end up
    done
}

async fn serve(settings: Settings) -> anyhow::Result<()> {
    let running = service::start(settings).await.map_err(|error| match error {
        ServeError::NotLoopback { .. } => BadInput(error.to_string()).into(),
        other => anyhow::Error::from(other),
    })?;
    println!("wandless serves http://{}", running.address);
    stop_signal().await?;
    tracing::info!("stopping; a second signal stops at once");
    tokio::select! {
        () = running.stop() => tracing::info!("stopped"),
        signal = stop_signal() => signal?,
        () = tokio::time::sleep(HARD_STOP) => tracing::warn!("stopped hard"),
    }
    Ok(())
}

/// Returns at the next SIGTERM or SIGINT.
pub(super) async fn stop_signal() -> std::io::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
    }
    Ok(())
}
