//! The data folder of a command beside a service: named by a flag, or by the settings that the service reads, too.

use super::bad_input::BadInput;
use super::serve::layers;
use std::path::{Path, PathBuf};

/// Flags that name a data folder.
#[derive(Debug, clap::Args)]
pub(super) struct DataFolder {
    /// Data folder of the service [default: that of the settings, ./wandless-data]
    #[arg(long)]
    data: Option<PathBuf>,
    /// TOML file with the settings of the service; the environment variable WANDLESS_DATA overrides it
    #[arg(long)]
    config: Option<PathBuf>,
}

/// Refuses a data folder that does not exist, for commands that must not create one.
///
/// # Errors
/// [`BadInput`] with the remedy.
pub(super) fn require_folder(data: &Path) -> Result<(), BadInput> {
    match data.is_dir() {
        true => Ok(()),
        false => {
            let remedy = "name it as --help says, or with WANDLESS_DATA";
            Err(BadInput(format!("{}: the data folder does not exist; {remedy}", data.display())))
        }
    }
}

impl DataFolder {
    /// The folder. The settings are read only where no flag names it: a backup must not fail because of another setting.
    ///
    /// # Errors
    /// [`BadInput`] for settings that cannot be read.
    pub(super) fn path(self) -> Result<PathBuf, BadInput> {
        if let Some(data) = self.data {
            return Ok(data);
        }
        let settings = layers(self.config.as_deref()).and_then(|layers| layers.settings());
        Ok(settings.map_err(|error| BadInput(error.to_string()))?.data)
    }
}
