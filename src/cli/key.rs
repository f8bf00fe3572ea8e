//! `wandless key create|list|revoke`: API keys. Works on a data folder whether or not its service is running.

use super::bad_input::BadInput;
use super::data_folder::require_folder;
use super::serve::layers;
use crate::service::store::keys::{self, Scope};
use crate::service::store::{Store, Tenant};
use anyhow::Context;
use clap::Subcommand;
use std::path::PathBuf;

/// Arguments of `key`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    action: Action,
    /// Data folder of the service [default: ./wandless-data]
    #[arg(long, global = true)]
    data: Option<PathBuf>,
    /// TOML file with the settings of the service; environment variables (WANDLESS_STORE__URL=…) override it
    #[arg(long, global = true)]
    config: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Create a key and print it; it cannot be shown again
    Create {
        /// Tenant whose sessions and jobs the key gives access to
        #[arg(long, default_value = "default")]
        tenant: String,
        /// Label of the key in lists
        #[arg(long, default_value = "")]
        name: String,
        /// Permissions: read, write, metrics
        #[arg(long, value_delimiter = ',', default_value = "read,write")]
        scopes: Vec<String>,
    },
    /// List all keys, without their secrets
    List,
    /// Revoke a key; requests with it are rejected from now on
    Revoke {
        /// Id of the key, as shown by `list`
        id: String,
    },
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(act(args))
}

async fn act(args: Args) -> anyhow::Result<()> {
    let settings = layers(args.config.as_deref()).and_then(|layers| layers.settings());
    let mut settings = settings.map_err(|error| BadInput(error.to_string()))?;
    settings.data = args.data.unwrap_or(settings.data);
    if !matches!(args.action, Action::Create { .. }) && settings.store.url == "sqlite:" {
        require_folder(&settings.data)?; // a mistyped folder would be created, and have no keys
    }
    let store = Store::open_beside(&settings).await?;
    match args.action {
        Action::Create { tenant, name, scopes } => create(&store, &tenant, &name, &scopes).await?,
        Action::List => list(&store).await?,
        Action::Revoke { id } => {
            if !keys::revoke(&store, &id).await? {
                return Err(BadInput(format!("{id}: no active key has this id; see `wandless key list`")).into());
            }
        }
    }
    store.close().await;
    Ok(())
}

async fn create(store: &Store, tenant: &str, name: &str, scopes: &[String]) -> anyhow::Result<()> {
    let tenant = Tenant::parse(tenant).with_context(|| {
        BadInput(format!("{tenant:?}: a tenant name has 1 to 64 characters: letters, digits, '-', '_', '.'"))
    })?;
    let scope = |text: &String| {
        Scope::parse(text).with_context(|| BadInput(format!("{text:?} is not a scope; use read, write or metrics")))
    };
    let scopes: Vec<Scope> = scopes.iter().map(scope).collect::<anyhow::Result<_>>()?;
    let key = keys::create(store, &tenant, name, &scopes).await?;
    eprintln!("key {} of tenant {}; store it now, it is not shown again:", key.id, tenant.name());
    println!("{}", key.token);
    Ok(())
}

async fn list(store: &Store) -> anyhow::Result<()> {
    for key in keys::list(store).await? {
        let scopes: Vec<&str> = key.scopes.iter().map(|scope| scope.name()).collect();
        let state = key.revoked_at.map_or("active".to_owned(), |at| format!("revoked {at}"));
        println!(
            "{}  {}  {}  {}  {}  {}",
            key.id,
            key.tenant.name(),
            scopes.join(","),
            key.created_at,
            state,
            key.name
        );
    }
    Ok(())
}
