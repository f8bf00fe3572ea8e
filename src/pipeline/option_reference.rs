//! The reference of the options, derived from the table: the page `docs/options.md`, the list of `wandless options` and the
//! document from which the viewer builds its dialog.

use super::option_table::{Choice, Field, Form, Kind, OPTION_TABLE, OptionRow};
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// The page `docs/options.md`.
pub fn options_page() -> String {
    let mut page = String::from(
        "# Options of a job\n\n\
         An option has the same name in `options` of `POST /v1/jobs`, in the file of `--options` and in the Python client. \
         A flag of `wandless reconstruct` and `wandless submit` overrides the file. Unknown keys are refused. \
         This page is generated: `wandless options --markdown > docs/options.md`.\n\n\
         | option | flag | type | default | range | unit | effect |\n|---|---|---|---|---|---|---|\n",
    );
    for row in OPTION_TABLE {
        let flags = flags(row).iter().map(|flag| format!("`{flag}`")).collect::<Vec<_>>().join(", ");
        let (kind, range) = (row.kind.name(), row.kind.range());
        let cells = [format!("`{}`", row.name), flags, kind.to_owned(), format!("`{}`", row.default()), range];
        let _ = writeln!(page, "| {} | {} | {} |", cells.join(" | "), row.unit, row.effect);
    }
    for row in OPTION_TABLE {
        match row.kind {
            Kind::Choice(choices) | Kind::Choices(choices) => {
                let _ = write!(page, "\n## Values of `{}`\n\n| value | meaning |\n|---|---|\n", row.name);
                for Choice { value, meaning, .. } in choices {
                    let _ = writeln!(page, "| `{value}` | {meaning} |");
                }
            }
            Kind::Forms(forms) => {
                let _ = write!(
                    page,
                    "\n## Forms of `{}`\n\n| `from` | meaning | other fields |\n|---|---|---|\n",
                    row.name
                );
                for form in forms {
                    let fields: Vec<String> = form.fields.iter().map(field_text).collect();
                    let _ = writeln!(page, "| `{}` | {} | {} |", form.from, form.meaning, fields.join("; "));
                }
            }
            Kind::Actions(forms) => {
                let _ = write!(
                    page,
                    "\n## Actions of `{}`\n\n| `action` | effect | other fields |\n|---|---|---|\n",
                    row.name
                );
                for form in forms {
                    let fields: Vec<String> = form.fields.iter().map(field_text).collect();
                    let _ = writeln!(page, "| `{}` | {} | {} |", form.from, form.meaning, fields.join("; "));
                }
            }
            _ => {}
        }
    }
    page.push_str(
        "\n## Example\n\n```json\n{\"people\": 3, \"fps\": 25, \"scale\": {\"from\": \"height\", \"metres\": 1.82, \
         \"who\": \"tallest\"}, \"exports\": [\"glb\", \"bvh\"]}\n```\n\nThe same as flags: \
         `--people 3 --fps 25 --height 1.82 --exports glb,bvh`.\n",
    );
    page
}

/// The list that `wandless options` prints.
pub fn options_list() -> String {
    let mut list = String::new();
    for row in OPTION_TABLE {
        let _ = writeln!(list, "{} ({}, default {})", row.name, row.kind.name(), row.default());
        let _ = writeln!(list, "    {}", row.effect);
        let range = row.kind.range();
        if !range.is_empty() {
            let unit = if row.unit.is_empty() { String::new() } else { format!(" {}", row.unit) };
            let _ = writeln!(list, "    values: {range}{unit}");
        }
        let _ = writeln!(list, "    flags:  {}\n", flags(row).join(", "));
    }
    list
}

/// The table as the viewer reads it.
pub fn options_document() -> Value {
    Value::Array(OPTION_TABLE.iter().map(row_document).collect())
}

/// The flags of an option with their values, as `--help` shows them.
pub fn flags(row: &OptionRow) -> Vec<String> {
    match row.kind {
        Kind::Forms(forms) => {
            let own = forms.iter().filter(|form| !form.flag[0].is_empty());
            own.map(|Form { flag: [flag, value], .. }| format!("--{flag} {value}")).collect()
        }
        _ => vec![format!("--{} {}", row.flag, value_name(row))],
    }
}

/// The value of an option's flag, as `--help` shows it.
pub fn value_name(row: &OptionRow) -> &'static str {
    match row.kind {
        Kind::Switch => "true,false",
        Kind::Whole { .. } => "N",
        Kind::Number { .. } => "NUMBER",
        Kind::Choices(_) => "NAME,…",
        Kind::Actions(_) => "FILE",
        Kind::Text | Kind::TwoCameras | Kind::Frame | Kind::Numbers | Kind::Choice(_) | Kind::Forms(_) => "NAME",
    }
}

/// Effect, range, unit and default of an option in one paragraph.
pub fn paragraph(row: &OptionRow) -> String {
    let mut text = row.effect.to_owned();
    match row.kind {
        Kind::Choice(choices) | Kind::Choices(choices) => text.push_str(&values_text(choices)),
        Kind::Forms(forms) | Kind::Actions(forms) => {
            let forms = forms.iter().map(|form| format!("`{}`: {}", form.from, form.meaning));
            let _ = write!(text, " {}.", forms.collect::<Vec<_>>().join("; "));
        }
        Kind::Whole { .. } | Kind::Number { .. } => {
            let _ = write!(text, " Range: {} {}", row.kind.range(), row.unit);
            text.truncate(text.trim_end().len());
            text.push('.');
        }
        Kind::Switch | Kind::Text | Kind::TwoCameras | Kind::Frame | Kind::Numbers => {}
    }
    let _ = write!(text, " Default: `{}`.", row.default());
    text
}

/// The values of a choice with their meanings as a sentence.
fn values_text(choices: &[Choice]) -> String {
    let values = choices.iter().map(|choice| format!("`{}`: {}", choice.value, choice.meaning));
    format!(" {}.", values.collect::<Vec<_>>().join("; "))
}

/// A field of a form with range and unit.
pub fn field_text(field: &Field) -> String {
    let range = field.kind.range();
    let range = if range.is_empty() { String::new() } else { format!(", {range} {}", field.unit) };
    format!("`{}`: {}{}", field.name, field.effect, range.trim_end())
}

fn row_document(row: &OptionRow) -> Value {
    let mut document = kind_document(&row.kind);
    document.insert("name".to_owned(), json!(row.name));
    document.insert("label".to_owned(), json!(row.label));
    document.insert("unit".to_owned(), json!(row.unit));
    document.insert("effect".to_owned(), json!(row.effect));
    document.insert("default".to_owned(), row.default());
    document.insert("common".to_owned(), json!(row.is_common));
    Value::Object(document)
}

fn kind_document(kind: &Kind) -> Map<String, Value> {
    let choices = |choices: &[Choice]| -> Value {
        choices.iter().map(|choice| json!({ "value": choice.value, "meaning": choice.meaning })).collect()
    };
    let (name, rest) = match kind {
        Kind::Switch => ("switch", json!({})),
        Kind::Whole { min, .. } => ("whole", json!({ "min": min })),
        Kind::Number { range: [min, max], .. } => {
            ("number", json!({ "min": min, "max": max.is_finite().then_some(max) }))
        }
        Kind::Text => ("text", json!({})),
        Kind::TwoCameras => ("two_cameras", json!({})),
        Kind::Frame => ("frame", json!({})),
        Kind::Numbers => ("numbers", json!({})),
        Kind::Choice(values) => ("choice", json!({ "values": choices(values) })),
        Kind::Choices(values) => ("choices", json!({ "values": choices(values) })),
        Kind::Forms(forms) => ("forms", json!({ "forms": forms.iter().map(form_document).collect::<Vec<_>>() })),
        Kind::Actions(forms) => ("actions", json!({ "forms": forms.iter().map(form_document).collect::<Vec<_>>() })),
    };
    let mut document = Map::from_iter([("kind".to_owned(), json!(name))]);
    document.extend(rest.as_object().cloned().unwrap_or_default());
    document
}

fn form_document(form: &Form) -> Value {
    let field = |field: &Field| {
        let mut document = kind_document(&field.kind);
        document.insert("name".to_owned(), json!(field.name));
        document.insert("unit".to_owned(), json!(field.unit));
        document.insert("effect".to_owned(), json!(field.effect));
        Value::Object(document)
    };
    json!({ "from": form.from, "meaning": form.meaning, "fields": form.fields.iter().map(field).collect::<Vec<_>>() })
}
