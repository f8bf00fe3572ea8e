//! The options of a job as flags, one per row of the table of options.

use super::bad_input::BadInput;
use crate::pipeline::Options;
use crate::pipeline::option_reference::{paragraph, value_name};
use crate::pipeline::option_table::{Field, Form, Kind, OPTION_TABLE, OptionRow};
use crate::session::parser_errors::in_json_words;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, ArgMatches, Command, FromArgMatches};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Heading of the flags in `--help`.
const HEADING: &str = "Options of the job";

/// The flags that were given, by the key of their option.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct OptionFlags(Map<String, Value>);

/// Where the options of a job come from.
#[derive(Debug, Default, clap::Args)]
pub(super) struct OptionArgs {
    /// JSON file with options of the job; flags override it
    #[arg(long, help_heading = HEADING)]
    options: Option<PathBuf>,
    #[command(flatten)]
    flags: OptionFlags,
}

impl OptionArgs {
    /// Reads the options: defaults, then the file, then the flags.
    ///
    /// # Errors
    /// [`BadInput`] if the file cannot be read or a value is refused.
    pub(super) fn read(&self) -> anyhow::Result<Options> {
        let mut options = self.options.as_deref().map(read_object).transpose()?.unwrap_or_default();
        options.extend(self.flags.0.clone());
        let place = self.options.as_ref().map_or_else(|| "options".to_owned(), |file| file.display().to_string());
        let refused = |error: serde_json::Error| {
            BadInput(format!("{place}: {}; `wandless options` lists names, types and ranges", in_json_words(&error)))
        };
        Ok(serde_json::from_value(Value::Object(options)).map_err(refused)?)
    }

    /// Whether a flag for `option` was given.
    pub(super) fn has_flag(&self, option: &str) -> bool {
        self.flags.0.contains_key(option)
    }
}

fn read_object(file: &Path) -> Result<Map<String, Value>, BadInput> {
    let bad = |reason: String| BadInput(format!("{}: {reason}; give a JSON object of options", file.display()));
    let text = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    serde_json::from_slice(&text).map_err(|error| bad(in_json_words(&error)))
}

impl clap::Args for OptionFlags {
    fn augment_args(command: Command) -> Command {
        OPTION_TABLE.iter().flat_map(arguments).fold(command, Command::arg)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for OptionFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = |row: &OptionRow| Some((row.name.to_owned(), value_of(row, matches)?));
        Ok(Self(OPTION_TABLE.iter().filter_map(given).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0.extend(Self::from_arg_matches(matches)?.0);
        Ok(())
    }
}

/// The flags of one option.
fn arguments(row: &'static OptionRow) -> Vec<Arg> {
    let argument = |flag: &'static str, value: &'static str, help: String| {
        Arg::new(flag).long(flag).value_name(value).help(help).help_heading(HEADING)
    };
    if let Kind::Forms(forms) = row.kind {
        let with_flag: Vec<&Form> = forms.iter().filter(|form| !form.flag[0].is_empty()).collect();
        let names: Vec<&str> = with_flag.iter().map(|form| form.flag[0]).collect();
        let of_form = |form: &&'static Form| {
            let others: Vec<&str> = names.iter().copied().filter(|name| *name != form.flag[0]).collect();
            let help = format!("{} Here: {}", row.effect, form.meaning);
            argument(form.flag[0], form.flag[1], help)
                .conflicts_with_all(others)
                .value_parser(|text: &str| form_value(form, text))
        };
        return with_flag.iter().map(of_form).collect();
    }
    let argument = argument(row.flag, value_name(row), row.effect.to_owned()).long_help(paragraph(row));
    vec![match row.kind {
        Kind::Choice(choices) => {
            let values = choices.iter().map(|choice| PossibleValue::new(choice.value));
            argument.value_parser(PossibleValuesParser::new(values).map(Value::from)).hide_possible_values(true)
        }
        Kind::Choices(choices) => {
            let values = choices.iter().map(|choice| PossibleValue::new(choice.value).aliases(choice.aliases));
            let parser = PossibleValuesParser::new(values).map(Value::from);
            argument.value_parser(parser).value_delimiter(',').hide_possible_values(true)
        }
        Kind::Actions(_) => argument.value_parser(|file: &str| list_in(Path::new(file))),
        _ => argument.value_parser(|text: &str| plain_value(&row.kind, text)),
    }]
}

/// The value of an option's flag; `None` if it was not given.
fn value_of(row: &OptionRow, matches: &ArgMatches) -> Option<Value> {
    match row.kind {
        Kind::Forms(forms) => {
            let flags = forms.iter().map(|form| form.flag[0]).filter(|flag| !flag.is_empty());
            flags.filter_map(|flag| matches.get_one::<Value>(flag)).next().cloned()
        }
        Kind::Choices(_) => matches.get_many::<Value>(row.flag).map(|values| values.cloned().collect()),
        _ => matches.get_one::<Value>(row.flag).cloned(),
    }
}

/// The list in a JSON file.
fn list_in(file: &Path) -> Result<Value, String> {
    let text = std::fs::read(file).map_err(|error| error.to_string())?;
    let list: Vec<Value> = serde_json::from_slice(&text)
        .map_err(|error| format!("{}; expected a JSON list of objects", in_json_words(&error)))?;
    Ok(list.into())
}

/// The JSON value of a flag's text.
fn plain_value(kind: &Kind, text: &str) -> Result<Value, String> {
    let expected = |what: String| format!("expected {what}");
    match kind {
        Kind::Switch => text.parse::<bool>().map(Value::from).map_err(|_| expected("true or false".to_owned())),
        Kind::Whole { min, .. } => {
            let number = text.parse::<u64>().ok().filter(|number| number >= min);
            number.map(Value::from).ok_or_else(|| expected(format!("a whole number of {min} or more")))
        }
        Kind::Number { range: [min, max], .. } => {
            let number = text.parse::<f64>().ok().filter(|number| (min..=max).contains(&number) && number.is_finite());
            number.map(Value::from).ok_or_else(|| expected(format!("a number, {}", kind.range())))
        }
        _ => Ok(Value::from(text)),
    }
}

/// The object of a form from the parts of its flag, separated by commas; missing texts get their usual value.
fn form_value(form: &Form, text: &str) -> Result<Value, String> {
    let mut parts = text.split(',').map(str::trim);
    let mut object = Map::from_iter([("from".to_owned(), json!(form.from))]);
    for Field { name, kind, .. } in form.fields {
        let value = match (kind, parts.next()) {
            (Kind::TwoCameras, Some(first)) => json!([first, parts.next().ok_or("expected two cameras")?]),
            (Kind::Text, None) => json!("tallest"), // the only text of a form: the person of a known height
            (_, Some(part)) => plain_value(kind, part)?,
            (_, None) => return Err(format!("expected {}", form.flag[1])),
        };
        object.insert((*name).to_owned(), value);
    }
    match parts.next() {
        None => Ok(Value::Object(object)),
        Some(_) => Err(format!("expected {}", form.flag[1])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::arguments::arguments_of;
    use crate::pipeline::config::{Extrinsics, ScaleSource};
    use crate::session::reconstruction::ExportFormat;

    fn read(words: &[&str]) -> anyhow::Result<Options> {
        arguments_of::<OptionArgs>([&["submit"], words].concat())?.read()
    }

    #[test]
    fn flags_become_options() {
        let options = read(&[
            "--people", "3", "--fps", "29.97", "--extrinsics", "fixed", "--up", "z", "--denoise", "false", "--exports",
            "glb,bvh", "--height", "1.82", "--body", "studio",
        ])
        .unwrap();
        assert_eq!((options.people, options.fps, options.extrinsics), (Some(3), Some(29.97), Extrinsics::Fixed));
        assert_eq!((options.denoise, options.body.as_str()), (false, "studio"));
        assert_eq!(options.exports, [ExportFormat::Glb, ExportFormat::Bvh]);
        assert_eq!(options.scale, ScaleSource::Height { metres: 1.82, who: "tallest".to_owned() });
        let formats = read(&["--exports", "mot"]).unwrap().exports;
        assert_eq!(formats, [ExportFormat::JointAngles], "a name that `export --to` takes was refused");
        let options = read(&["--camera-distance", "left, right,4.5"]).unwrap();
        let cameras = ["left", "right"].map(str::to_owned);
        assert_eq!(options.scale, ScaleSource::CameraDistance { cameras, metres: 4.5 });
        assert_eq!(read(&[]).unwrap(), Options::default());
    }

    #[test]
    fn wrong_values_are_refused_with_the_range() {
        let refusal = |words: &[&str]| read(words).unwrap_err().to_string();
        assert!(refusal(&["--people", "0"]).contains("1 or more"));
        assert!(refusal(&["--height", "182"]).contains("0.5 to 2.6"));
        assert!(refusal(&["--extrinsics", "guess"]).contains("estimate"));
        assert!(refusal(&["--height", "1.8", "--camera-distance", "a,b,3"]).contains("cannot be used with"));
        assert!(refusal(&["--camera-distance", "a,b"]).contains("CAMERA,CAMERA,METRES"));
    }

    #[test]
    fn flags_override_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("options.json");
        std::fs::write(&file, r#"{"people": 2, "seed": 7}"#).unwrap();
        let options = read(&["--options", file.to_str().unwrap(), "--people", "4"]).unwrap();
        assert_eq!((options.people, options.seed), (Some(4), 7));
        std::fs::write(&file, r#"{"poeple": 2}"#).unwrap();
        let error = read(&["--options", file.to_str().unwrap()]).unwrap_err();
        assert!(error.is::<BadInput>() && error.to_string().contains("poeple"), "{error}");
    }
}
