//! The options of a job in the OpenAPI document: descriptions, defaults, units and ranges from the table of options.

use crate::pipeline::option_reference::{field_text, paragraph};
use crate::pipeline::option_table::{Choice, Field, Form, Kind, OPTION_TABLE};
use serde_json::{Value, json};

/// Describes every option and the types that options name.
pub(super) fn describe(schemas: &mut Value) {
    for row in OPTION_TABLE {
        let property = &mut schemas["Options"]["properties"][row.name];
        property["description"] = json!(paragraph(row));
        property["default"] = row.default();
        if !row.unit.is_empty() {
            property["x-unit"] = json!(row.unit);
        }
        limit(property, &row.kind);
        let named = property["$ref"].as_str().or_else(|| property["items"]["$ref"].as_str());
        let named = named.and_then(|reference| reference.rsplit('/').next()).map(str::to_owned);
        match (row.kind, named) {
            (Kind::Choice(choices) | Kind::Choices(choices), Some(name)) => list(&mut schemas[name], choices),
            (Kind::Choice(choices), None) => {
                let property = &mut schemas["Options"]["properties"][row.name];
                property.as_object_mut().map(|property| property.remove("pattern"));
                property["enum"] = choices.iter().map(|choice| choice.value).collect();
            }
            (Kind::Forms(forms), Some(name)) => describe_forms(&mut schemas[name], forms, "from", "Scale"),
            (Kind::Actions(forms), Some(name)) => describe_forms(&mut schemas[name], forms, "action", "Correction"),
            _ => {}
        }
    }
    schemas["Options"]["examples"] = json!([
        { "people": 3, "fps": 25, "scale": { "from": "height", "metres": 1.82, "who": "tallest" }, "exports": ["glb", "bvh"] },
        { "extrinsics": "fixed" },
    ]);
}

/// Adds the meanings of an enumeration's values.
fn list(schema: &mut Value, choices: &[Choice]) {
    let meanings: Vec<String> =
        choices.iter().map(|choice| format!("`{}`: {}", choice.value, choice.meaning)).collect();
    schema["description"] = json!(format!("{}.", meanings.join("; ")));
}

/// Describes each form, which the field `tag` selects, and its fields; `noun` ends the names of the types.
fn describe_forms(schema: &mut Value, forms: &[Form], tag: &str, noun: &str) {
    for described in schema["oneOf"].as_array_mut().into_iter().flatten() {
        let from = described["properties"][tag]["enum"][0].clone();
        let Some(form) = forms.iter().find(|form| from == form.from) else { continue };
        described["description"] = json!(form.meaning);
        described["title"] = json!(title(form.from, noun)); // names the type in generated clients
        described["additionalProperties"] = json!(false);
        for field in form.fields {
            let property = &mut described["properties"][field.name];
            property["description"] = json!(field_text(field));
            limit(property, &field.kind);
            if let Field { kind: Kind::TwoCameras, .. } = field {
                (property["minItems"], property["maxItems"]) = (json!(2), json!(2));
            }
        }
    }
}

/// `camera_distance` as `CameraDistanceScale`.
fn title(from: &str, noun: &str) -> String {
    let capitalised = |word: &str| {
        let mut letters = word.chars();
        letters.next().map(|first| first.to_ascii_uppercase()).into_iter().chain(letters).collect::<String>()
    };
    from.split('_').map(capitalised).chain([noun.to_owned()]).collect()
}

/// Adds the range of a number.
fn limit(property: &mut Value, kind: &Kind) {
    match kind {
        Kind::Whole { min, .. } => property["minimum"] = json!(min),
        Kind::Number { range: [min, max], .. } if max.is_finite() => {
            (property["minimum"], property["maximum"]) = (json!(min), json!(max));
        }
        Kind::Number { range: [min, _], .. } => property["exclusiveMinimum"] = json!(min),
        _ => {}
    }
}
