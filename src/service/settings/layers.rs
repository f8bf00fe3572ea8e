//! Settings from their layers: defaults, then a file, then the environment, then the command line; the last word counts.

use super::Settings;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Why the settings cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no TOML.
    #[error("{}: {reason}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the line.
        reason: String,
    },
    /// A word of the environment or the command line names nothing that can be set.
    #[error("{word}: expected <section>.<key>=<value>")]
    Word {
        /// The word.
        word: String,
    },
    /// A name or a value is not one of the settings.
    #[error("settings: {reason}")]
    Meaning {
        /// Which, and what was expected.
        reason: String,
    },
}

/// Layers of settings, each over the ones before it.
#[derive(Debug, Default)]
pub struct Layers {
    table: Table,
}

impl Layers {
    /// Lays a TOML file over what is there.
    ///
    /// # Errors
    /// When it cannot be read or is no TOML.
    pub fn file(mut self, path: &Path) -> Result<Self, SettingsError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| SettingsError::File { path: path.to_owned(), source })?;
        let table: Table = text
            .parse()
            .map_err(|error| SettingsError::Syntax { path: path.to_owned(), reason: format!("{error}") })?;
        merge(&mut self.table, table);
        Ok(self)
    }

    /// Lays variables over what is there: `WANDLESS_DATA`, `WANDLESS_LISTEN`, and `WANDLESS_<SECTION>__<KEY>`.
    ///
    /// # Errors
    /// When a variable has more than two parts.
    pub fn environment(mut self, variables: impl IntoIterator<Item = (String, String)>) -> Result<Self, SettingsError> {
        let mut ours: Vec<(String, String)> =
            variables.into_iter().filter(|(name, _)| name.starts_with("WANDLESS_")).collect();
        ours.sort();
        for (name, value) in ours {
            let key = name["WANDLESS_".len()..].to_ascii_lowercase().replace("__", ".");
            let is_setting = key.contains('.') || ["data", "listen", "cors_origins", "drain_limit_s"].contains(&&*key);
            if is_setting {
                self = self.word(&key, &value)?;
            }
        }
        Ok(self)
    }

    /// Lays one setting over what is there: `key` as `listen` or `limits.max_wait_s`, `value` as TOML or as plain text.
    ///
    /// # Errors
    /// When the key has more than two parts.
    pub fn word(mut self, key: &str, value: &str) -> Result<Self, SettingsError> {
        let refused = || SettingsError::Word { word: format!("{key}={value}") };
        let is_name = |name: &str| !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        let value = parsed(value);
        let layer = match key.split('.').collect::<Vec<_>>().as_slice() {
            [key] if is_name(key) => Table::from_iter([((*key).to_owned(), value)]),
            [section, key] if is_name(section) && is_name(key) => {
                let inner = Table::from_iter([((*key).to_owned(), value)]);
                Table::from_iter([((*section).to_owned(), Value::Table(inner))])
            }
            _ => return Err(refused()),
        };
        merge(&mut self.table, layer);
        Ok(self)
    }

    /// The settings, defaults where no layer says otherwise.
    ///
    /// # Errors
    /// When a name is unknown or a value of the wrong kind.
    pub fn settings(self) -> Result<Settings, SettingsError> {
        let meaning = |reason: String| SettingsError::Meaning { reason };
        let mut settings: Settings = Value::Table(self.table)
            .try_into()
            .map_err(|error: toml::de::Error| meaning(error.message().to_owned()))?;
        settings.program = std::env::current_exe().map_err(|error| meaning(format!("the own program: {error}")))?;
        if settings.jobs.concurrent == 0 {
            return Err(meaning("jobs.concurrent is 0; give 1 or more".to_owned()));
        }
        if settings.limits.max_connections == 0 {
            return Err(meaning("limits.max_connections is 0; give 1 or more".to_owned()));
        }
        Ok(settings)
    }
}

/// `value` as TOML has it (numbers, lists, quoted texts), as plain text otherwise.
fn parsed(value: &str) -> Value {
    let document = format!("value = {value}");
    let parsed = document.parse::<Table>().ok().filter(|table| table.len() == 1);
    parsed.and_then(|mut table| table.remove("value")).unwrap_or_else(|| Value::String(value.to_owned()))
}

fn merge(below: &mut Table, above: Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => {
                below.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn pair(name: &str, value: &str) -> (String, String) {
        (name.to_owned(), value.to_owned())
    }

    #[test]
    fn the_last_layer_has_the_last_word() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wandless.toml");
        std::fs::write(&path, "listen = \"127.0.0.1:1\"\n[limits]\nmax_wait_s = 7\nmax_queued = 3\n").unwrap();
        let environment = [
            pair("WANDLESS_LIMITS__MAX_WAIT_S", "8"),
            pair("WANDLESS_DATA", "/srv/takes"),
            pair("WANDLESS_LOG", "debug"),
            pair("HOME", "/root"),
        ];
        let layers = Layers::default().file(&path).unwrap().environment(environment).unwrap();
        let settings = layers.word("limits.max_wait_s", "0.5").unwrap().settings().unwrap();
        assert_eq!(settings.limits.max_wait, Duration::from_millis(500));
        assert_eq!((settings.limits.max_queued, settings.listen.port()), (3, 1));
        assert_eq!(settings.data, Path::new("/srv/takes"));
        assert_eq!(settings.limits.max_json_bytes, 1 << 20, "what nobody sets keeps its default");
    }

    #[test]
    fn unknown_names_and_wrong_values_are_refused() {
        for (key, value) in
            [("limits.max_wiat_s", "1"), ("limits.max_wait_s", "-1"), ("jobs.concurrent", "0"), ("x", "1")]
        {
            assert!(Layers::default().word(key, value).unwrap().settings().is_err(), "{key}");
        }
        assert!(Layers::default().word("a.b.c", "1").is_err());
    }

    #[test]
    fn what_is_printed_can_be_read_again() {
        let text = toml::to_string(&Settings::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wandless.toml");
        std::fs::write(&path, &text).unwrap();
        let again = Layers::default().file(&path).unwrap().settings().unwrap();
        assert_eq!(toml::to_string(&again).unwrap(), text);
    }
}
