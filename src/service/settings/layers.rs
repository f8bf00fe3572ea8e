//! Settings from layers: defaults, then a file, then the environment, then the command line; later layers take precedence.
//!
//! Why not figment: it adds seven crates and toml 0.8 beside toml 1.2 for the 60 lines here (last release 2024).

use super::Settings;
use super::ranges::check;
use crate::session::parser_errors::in_toml_words;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Why the settings are invalid.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A variable or an argument does not name a setting.
    #[error("{word}: expected <section>.<key>=<value>")]
    Word {
        /// The variable or argument.
        word: String,
    },
    /// A layer contains an unknown key or an invalid value.
    #[error("{layer}: {reason}")]
    Invalid {
        /// The file, the variable or the argument.
        layer: String,
        /// Which key, and what was expected.
        reason: String,
    },
}

/// Merged layers of settings.
#[derive(Debug, Default)]
pub struct Layers {
    table: Table,
}

impl Layers {
    /// Adds a TOML file.
    ///
    /// # Errors
    /// When the file cannot be read, is not TOML, or contains an unknown key or an invalid value.
    pub fn file(mut self, path: &Path) -> Result<Self, SettingsError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| SettingsError::File { path: path.to_owned(), source })?;
        let invalid = |error: toml::de::Error| SettingsError::Invalid {
            layer: path.display().to_string(),
            reason: in_toml_words(&error.to_string()),
        };
        toml::from_str::<Settings>(&text).map_err(invalid)?; // names key and line
        merge(&mut self.table, text.parse().map_err(invalid)?);
        Ok(self)
    }

    /// Adds environment variables: `WANDLESS_DATA`, `WANDLESS_LISTEN`, and `WANDLESS_<SECTION>__<KEY>`.
    ///
    /// # Errors
    /// When a variable has more than two parts, an unknown key or an invalid value.
    pub fn environment(mut self, variables: impl IntoIterator<Item = (String, String)>) -> Result<Self, SettingsError> {
        let mut ours: Vec<(String, String)> =
            variables.into_iter().filter(|(name, _)| name.starts_with("WANDLESS_")).collect();
        ours.sort();
        for (name, value) in ours {
            let key = name["WANDLESS_".len()..].to_ascii_lowercase().replace("__", ".");
            let is_setting = key.contains('.')
                || ["data", "listen", "role", "cors_origins", "allowed_hosts", "drain_limit_s"].contains(&&*key);
            if is_setting {
                self = self.word(&key, &value)?;
            }
        }
        Ok(self)
    }

    /// Adds one setting: `key` is `listen` or `limits.max_wait_s`, `value` is TOML or plain text.
    ///
    /// # Errors
    /// When the key has more than two parts or is unknown, or the value is invalid.
    pub fn word(mut self, key: &str, value: &str) -> Result<Self, SettingsError> {
        let word = format!("{key}={value}");
        let is_name = |name: &str| !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        let value = parsed(value);
        let layer = match key.split('.').collect::<Vec<_>>().as_slice() {
            [key] if is_name(key) => Table::from_iter([((*key).to_owned(), value)]),
            [section, key] if is_name(section) && is_name(key) => {
                let inner = Table::from_iter([((*key).to_owned(), value)]);
                Table::from_iter([((*section).to_owned(), Value::Table(inner))])
            }
            _ => return Err(SettingsError::Word { word }),
        };
        Settings::deserialize(Value::Table(layer.clone()))
            .map_err(|error| SettingsError::Invalid { layer: word, reason: in_toml_words(error.message()) })?;
        merge(&mut self.table, layer);
        Ok(self)
    }

    /// Returns the settings; keys that no layer sets have their defaults.
    ///
    /// # Errors
    /// When a value is outside its range, or the path of the running program is unknown.
    pub fn settings(self) -> Result<Settings, SettingsError> {
        let invalid = |reason: String| SettingsError::Invalid { layer: "settings".to_owned(), reason };
        let mut settings =
            Settings::deserialize(Value::Table(self.table)).map_err(|error| invalid(in_toml_words(error.message())))?;
        settings.program =
            std::env::current_exe().map_err(|error| invalid(format!("path of the running program: {error}")))?;
        check(&settings).map_err(invalid)?;
        Ok(settings)
    }
}

/// Parses `value` as TOML (numbers, lists, quoted texts); anything else is plain text.
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
    fn later_layers_override_earlier_ones() {
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
        assert_eq!(settings.limits.max_json_bytes, 1 << 20, "keys without a layer keep their default");
    }

    #[test]
    fn rejects_unknown_keys_and_invalid_values_by_name() {
        for (key, value) in [
            ("limits.max_wait_s", "soon"),
            ("limits.max_wiat_s", "1"),
            ("limits.max_wait_s", "-1"),
            ("x", "1"),
            ("a.b.c", "1"),
        ] {
            let error = Layers::default().word(key, value).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{key}={value}: ")) && !error.contains("f64"), "{error}");
        }
        assert!(Layers::default().word("jobs.concurrent", "0").unwrap().settings().is_err());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wandless.toml");
        std::fs::write(&path, "[limits]\nmax_wiat_s = 7\n").unwrap();
        let error = Layers::default().file(&path).unwrap_err().to_string();
        assert!(error.contains("wandless.toml") && error.contains("line 2") && error.contains("max_wiat_s"), "{error}");
    }

    #[test]
    fn accepts_the_earlier_name_of_max_crashes() {
        let settings = Layers::default().word("jobs.max_deaths", "5").unwrap().settings().unwrap();
        assert_eq!(settings.jobs.max_crashes, 5);
    }

    #[test]
    fn printed_settings_can_be_read_again() {
        let text = toml::to_string(&Settings::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wandless.toml");
        std::fs::write(&path, &text).unwrap();
        let again = Layers::default().file(&path).unwrap().settings().unwrap();
        assert_eq!(toml::to_string(&again).unwrap(), text);
    }
}
