//! `wandless serve`: runs the service until a stop signal.

use super::bad_input::BadInput;
use crate::service::settings::Role;
use crate::service::settings::layers::{Layers, SettingsError};
use crate::service::{self, ServeError, Settings};
use clap::ValueEnum;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Arguments of `serve`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Data folder with the database, uploads and results [default: ./wandless-data]
    #[arg(long)]
    data: Option<PathBuf>,
    /// Address to listen on; port 0 picks a free port [default: 127.0.0.1:8700]
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// What this process does; other roles than `all` need a PostgreSQL server (store.url) [default: all]
    #[arg(long, value_enum)]
    role: Option<Role>,
    /// TOML file with settings; environment variables (WANDLESS_LIMITS__MAX_WAIT_S=…) and flags override it
    #[arg(long)]
    config: Option<PathBuf>,
    /// One setting, for example limits.max_wait_s=20; can be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the settings with all defaults as TOML and exit
    #[arg(long)]
    print_settings: bool,
    /// Format of the log on stderr
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    pub(super) log_format: LogFormat,
}

/// Format of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum LogFormat {
    /// Human-readable lines
    Text,
    /// One JSON object per line
    Json,
}

/// A graceful stop that takes longer than this is aborted.
const HARD_STOP: Duration = Duration::from_secs(30);

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let print = args.print_settings;
    let settings = settings(args).map_err(|error| BadInput(error.to_string()))?;
    if print {
        print!("{}", toml::to_string(&settings)?);
        return Ok(());
    }
    let runtime = Runtime::new()?;
    let done = runtime.block_on(serve(settings));
    runtime.shutdown_timeout(Duration::from_secs(1)); // a blocked file operation must not delay the exit
    done
}

/// Merges the settings; later sources override earlier ones: defaults, file, environment, flags.
fn settings(args: Args) -> Result<Settings, SettingsError> {
    let mut layers = layers(args.config.as_deref())?;
    for word in &args.set {
        let (key, value) = word.split_once('=').ok_or_else(|| SettingsError::Word { word: word.clone() })?;
        layers = layers.word(key.trim(), value.trim())?;
    }
    if let Some(role) = args.role {
        let name = role.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
        layers = layers.word("role", &name)?;
    }
    let mut settings = layers.settings()?;
    settings.data = args.data.unwrap_or(settings.data);
    settings.listen = args.listen.unwrap_or(settings.listen);
    Ok(settings)
}

/// The settings of the file and of the environment.
pub(super) fn layers(config: Option<&Path>) -> Result<Layers, SettingsError> {
    let mut layers = Layers::default();
    if let Some(file) = config {
        layers = layers.file(file)?;
    }
    let variables =
        std::env::vars_os().filter_map(|(key, value)| Some((key.into_string().ok()?, value.into_string().ok()?)));
    layers.environment(variables)
}

async fn serve(settings: Settings) -> anyhow::Result<()> {
    let mut signals = StopSignals::listen()?; // before the address is printed, so that no signal is missed
    let running = service::start(settings).await.map_err(|error| match error {
        ServeError::NotLoopback { .. } | ServeError::Network(_) => BadInput(error.to_string()).into(),
        other => anyhow::Error::from(other),
    })?;
    println!("wandless serves http://{}", running.address);
    signals.next().await;
    tracing::info!("stopping; a second signal stops immediately");
    tokio::select! {
        () = running.stop() => tracing::info!("stopped"),
        () = signals.next() => {}
        () = tokio::time::sleep(HARD_STOP) => tracing::warn!("stopped: the graceful stop took too long"),
    }
    Ok(())
}

/// Listener for SIGTERM and SIGINT.
pub(super) struct StopSignals {
    terminate: Signal,
    interrupt: Signal,
}

impl StopSignals {
    /// Starts listening. From now on neither signal ends the process by itself.
    pub(super) fn listen() -> std::io::Result<Self> {
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? })
    }

    /// Returns at the next signal.
    pub(super) async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}
