//! `wandless migrate`: brings a database to the tables of this release, or moves a stopped service of one machine to PostgreSQL and an
//! object store.

use super::bad_input::BadInput;
use super::serve::layers;
use crate::service::Settings;
use crate::service::store::Store;
use std::path::PathBuf;

/// Arguments of `migrate`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// TOML file with the settings of the service; environment variables (WANDLESS_STORE__URL=…) override it
    #[arg(long)]
    config: Option<PathBuf>,
    /// Data folder of the service [default: ./wandless-data]
    #[arg(long)]
    data: Option<PathBuf>,
    /// Data folder of a stopped service that is moved to the database and the object store of the settings; it is only read
    #[arg(long, value_name = "DATA")]
    from: Option<PathBuf>,
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let settings = layers(args.config.as_deref()).and_then(|layers| layers.settings());
    let mut settings = settings.map_err(|error| BadInput(error.to_string()))?;
    settings.data = args.data.unwrap_or(settings.data);
    let runtime = tokio::runtime::Runtime::new()?;
    match args.from {
        Some(from) => runtime.block_on(transfer(from, settings)),
        None => runtime.block_on(migrate(&settings)),
    }
}

/// Runs the migrations that the database does not have. The object store is not opened: nothing changes there.
async fn migrate(settings: &Settings) -> anyhow::Result<()> {
    let store = Store::open_beside(settings).await?;
    println!(
        "the database has the tables of wandless {} (migration {})",
        env!("CARGO_PKG_VERSION"),
        store.newest_migration()
    );
    store.close().await;
    Ok(())
}

#[cfg(not(feature = "scale"))]
async fn transfer(_: PathBuf, _: Settings) -> anyhow::Result<()> {
    Err(BadInput("--from needs a program that was built with the feature `scale`".to_owned()).into())
}

#[cfg(feature = "scale")]
async fn transfer(from: PathBuf, settings: Settings) -> anyhow::Result<()> {
    use crate::service::transfer::{self, TransferError};
    use std::time::Instant;

    if settings.store.url == "sqlite:" {
        return Err(BadInput(TransferError::NoServer.to_string()).into());
    }
    let start = Instant::now();
    let last = std::cell::Cell::new(Instant::now());
    let moved = transfer::transfer(&from, &settings, |files| {
        if last.get().elapsed().as_secs() >= 2 {
            last.set(Instant::now());
            eprintln!("{} of {} files, {} MB", files.done, files.total, files.bytes / 1_000_000);
        }
    });
    let moved = moved.await.map_err(|error| match error {
        TransferError::NoDatabase { .. } | TransferError::NotEmpty { .. } => BadInput(error.to_string()).into(),
        other => anyhow::Error::from(other),
    })?;
    for (table, rows) in moved.rows.iter().filter(|(_, rows)| *rows > 0) {
        println!("{table}: {rows} rows");
    }
    for place in &moved.replaced {
        println!("{place}: U+0000, which PostgreSQL cannot store, was replaced by U+FFFD in one text");
    }
    if moved.bodies > 0 {
        println!("bodies: {} are not moved; mount {} on every node", moved.bodies, from.join("bodies").display());
    }
    println!(
        "files: {}, {} bytes ({} had been stored before); every row and every byte was read back and compared, in {:.1} s",
        moved.files,
        moved.bytes,
        moved.known_files,
        start.elapsed().as_secs_f64()
    );
    println!(
        "start no service on {} any more: it would run the waiting jobs and call their webhooks again",
        from.display()
    );
    Ok(())
}
