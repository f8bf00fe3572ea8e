//! `wandless backup`, `restore`, `verify` and `health`: commands for operators.

use super::bad_input::BadInput;
use super::client::without_userinfo;
use crate::service::safety;
use crate::service::settings::DEFAULT_DATA;
use anyhow::{Context, bail};
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `backup`.
#[derive(Debug, clap::Args)]
pub(super) struct BackupArgs {
    /// Backup folder; must be empty or not exist
    to: PathBuf,
    /// Data folder of the service
    #[arg(long, default_value = DEFAULT_DATA)]
    data: PathBuf,
}

/// Arguments of `restore`.
#[derive(Debug, clap::Args)]
pub(super) struct RestoreArgs {
    /// Backup folder
    from: PathBuf,
    /// New data folder; must be empty or not exist
    #[arg(long, default_value = DEFAULT_DATA)]
    data: PathBuf,
}

/// Arguments of `verify`.
#[derive(Debug, clap::Args)]
pub(super) struct VerifyArgs {
    /// Data folder or backup folder
    #[arg(default_value = DEFAULT_DATA)]
    folder: PathBuf,
}

/// Arguments of `health`.
#[derive(Debug, clap::Args)]
pub(super) struct HealthArgs {
    /// URL of the service
    #[arg(long, default_value = "http://127.0.0.1:8700")]
    server: String,
}

/// Runs `backup`.
pub(super) fn back_up(args: BackupArgs) -> anyhow::Result<()> {
    if !args.data.is_dir() {
        return Err(BadInput(format!("{}: the data folder does not exist", args.data.display())).into());
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let files = runtime.block_on(safety::back_up(&args.data, &args.to))?;
    println!("{}: {files} files", args.to.display());
    Ok(())
}

/// Runs `restore`.
pub(super) fn restore(args: RestoreArgs) -> anyhow::Result<()> {
    let files = safety::restore(&args.from, &args.data)?;
    println!("{}: {files} files; start the service with --data {0}", args.data.display());
    Ok(())
}

/// Runs `verify`; exit code 1 if a file is damaged.
pub(super) fn verify(args: VerifyArgs) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let report = runtime.block_on(safety::verify(&args.folder))?;
    for stray in &report.strays {
        println!("stray: {stray}");
    }
    for damage in &report.damages {
        println!("damaged: {damage}");
    }
    println!("{} checked, {} damaged, {} strays", report.checked, report.damages.len(), report.strays.len());
    if report.damages.is_empty() { Ok(()) } else { bail!("{} is damaged", args.folder.display()) }
}

/// Runs `health`; exit code 1 if the service is not ready.
pub(super) fn health(args: HealthArgs) -> anyhow::Result<()> {
    let config = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(5))).build();
    let (server, _) = without_userinfo(&args.server); // readiness needs no key
    let url = format!("{}/readyz", server.trim_end_matches('/'));
    ureq::Agent::new_with_config(config).get(&url).call().with_context(|| url.clone())?;
    Ok(())
}
