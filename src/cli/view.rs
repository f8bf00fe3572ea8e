//! `wandless view`: opens the viewer on a result folder, without a service.

use super::bad_input::BadInput;
use super::serve::StopSignals;
use crate::service::http::result_viewer::{JOB, ResultFolder, has_page};
use anyhow::{Context, bail};
use std::io::IsTerminal;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

/// Serves the viewer of one result folder on the loopback until Ctrl-C. Nothing can be changed through it.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Result folder of `reconstruct` or `submit`
    result: PathBuf,
    /// Port on 127.0.0.1; 0 picks a free one
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Print the address only, do not open a browser
    #[arg(long)]
    no_browser: bool,
}

/// Runs the command.
///
/// # Errors
/// [`BadInput`] if the folder does not hold a result.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    if !has_page() {
        bail!("this program was built without its viewer; install Node.js 20.19 or later and build it again");
    }
    let folder = ResultFolder::open(&args.result).map_err(|error| BadInput(error.to_string()))?;
    Runtime::new()?.block_on(async {
        let mut signals = StopSignals::listen()?;
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
        let listener = TcpListener::bind(address).await.with_context(|| address.to_string())?;
        let url = format!("http://{}/#/jobs/{JOB}", listener.local_addr()?);
        println!("{url}\nstop with Ctrl-C");
        if !args.no_browser && std::io::stdout().is_terminal() {
            open_browser(&url);
        }
        Ok(folder.serve(listener, async move { signals.next().await }).await?)
    })
}

/// Opens the address in the user's browser; without one the printed address remains.
fn open_browser(url: &str) {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let opened =
        Command::new(program).arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    if let Err(error) = opened {
        tracing::debug!(program, %error, "no browser was opened");
    }
}
