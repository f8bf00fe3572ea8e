//! `wandless backup`, `restore`, `verify` and `health`: commands for operators.

use super::bad_input::BadInput;
use super::client::{server_url, without_userinfo};
use super::data_folder::{DataFolder, require_folder};
use super::serve::layers;
use crate::service::safety;
use crate::service::settings::Settings;
use crate::service::store::Store;
#[cfg(feature = "scale")]
use crate::service::store::new_id;
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Arguments of `backup`.
#[derive(Debug, clap::Args)]
pub(super) struct BackupArgs {
    /// Backup folder; must be empty or not exist
    to: PathBuf,
    #[command(flatten)]
    data: DataFolder,
}

/// Arguments of `restore`.
#[derive(Debug, clap::Args)]
pub(super) struct RestoreArgs {
    /// Backup folder; the data folder must be empty or not exist
    from: PathBuf,
    #[command(flatten)]
    data: DataFolder,
}

/// Arguments of `verify`.
#[derive(Debug, clap::Args)]
pub(super) struct VerifyArgs {
    /// Data folder or backup folder; without it that of the settings, or the database and the object store that they name
    folder: Option<PathBuf>,
    /// TOML file with the settings of the service; environment variables (WANDLESS_STORE__URL=…) override it
    #[arg(long)]
    config: Option<PathBuf>,
    /// Bring back objects that rows name and the bucket has only as earlier versions
    #[arg(long)]
    undelete: bool,
}

/// Arguments of `health`.
#[derive(Debug, clap::Args)]
pub(super) struct HealthArgs {
    /// URL of the service
    #[arg(long, default_value = "http://127.0.0.1:8700", value_parser = server_url)]
    server: String,
}

/// Runs `backup`.
pub(super) fn back_up(args: BackupArgs) -> anyhow::Result<()> {
    let data = args.data.path()?;
    require_folder(&data)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let files = runtime.block_on(safety::back_up(&data, &args.to))?;
    println!("{}: {files} files", args.to.display());
    Ok(())
}

/// Runs `restore`.
pub(super) fn restore(args: RestoreArgs) -> anyhow::Result<()> {
    let data = args.data.path()?;
    let files = safety::restore(&args.from, &data)?;
    println!("{}: {files} files; start the service with --data {0}", data.display());
    Ok(())
}

/// Runs `verify`; exit code 1 if a file is damaged.
pub(super) fn verify(args: VerifyArgs) -> anyhow::Result<()> {
    let settings = layers(args.config.as_deref()).and_then(|layers| layers.settings());
    let settings = settings.map_err(|error| BadInput(error.to_string()))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    match args.folder {
        None if settings.store.url != "sqlite:" => runtime.block_on(verify_shared(settings, args.undelete)),
        _ if args.undelete => Err(BadInput(
            "--undelete is for objects of a bucket: name the database and the bucket in the settings".to_owned(),
        )
        .into()),
        folder => runtime.block_on(verify_folder(&folder.unwrap_or(settings.data))),
    }
}

/// Reads every object that a row names.
#[cfg(feature = "scale")]
async fn verify_shared(mut settings: Settings, undelete: bool) -> anyhow::Result<()> {
    let scratch = std::env::temp_dir().join(new_id("wandless-verify"));
    settings.data.clone_from(&scratch); // the service on this machine holds its own folder
    let store = Store::open_for(&settings).await?;
    let report = safety::verify_shared(&store, undelete).await;
    store.close().await;
    let _ = std::fs::remove_dir_all(&scratch); // a folder of temporary files
    let report = report?;
    for damage in &report.damages {
        println!("damaged: {damage}");
    }
    let (checked, restored, damaged) = (report.checked, report.restored, report.damages.len());
    println!("{checked} objects checked, {restored} brought back, {damaged} damaged");
    match report.unversioned {
        Some(reason) => bail!("no object can be brought back: {reason}"),
        None if damaged > 0 => bail!("{damaged} objects are damaged"),
        None => Ok(()),
    }
}

#[cfg(not(feature = "scale"))]
async fn verify_shared(settings: Settings, _: bool) -> anyhow::Result<()> {
    Store::open_for(&settings).await?; // says that this build has no other database
    bail!("nothing was verified")
}

async fn verify_folder(folder: &Path) -> anyhow::Result<()> {
    require_folder(folder)?;
    let report = safety::verify(folder).await?;
    for stray in &report.strays {
        println!("stray: {stray}");
    }
    for damage in &report.damages {
        println!("damaged: {damage}");
    }
    println!("{} checked, {} damaged, {} strays", report.checked, report.damages.len(), report.strays.len());
    if report.damages.is_empty() { Ok(()) } else { bail!("{} is damaged", folder.display()) }
}

/// Runs `health`; exit code 1 if the service is not ready.
pub(super) fn health(args: HealthArgs) -> anyhow::Result<()> {
    let config = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(5))).build();
    let (server, _) = without_userinfo(&args.server); // readiness needs no key
    let url = format!("{}/readyz", server.trim_end_matches('/'));
    ureq::Agent::new_with_config(config).get(&url).call().with_context(|| url.clone())?;
    Ok(())
}
