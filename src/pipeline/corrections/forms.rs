//! The actions of corrections and their fields, for the table of options.

use crate::body::scale::HEIGHT_RANGE;
use crate::pipeline::option_kind::{Field, Form, Kind};

const fn action(name: &'static str, meaning: &'static str, fields: &'static [Field]) -> Form {
    Form { from: name, meaning, flag: ["", ""], fields }
}

const fn field(name: &'static str, kind: Kind, effect: &'static str) -> Field {
    Field { name, kind, unit: "", effect }
}

/// The number of a person.
const NUMBER: Kind = Kind::Whole { min: 0, or_null: false };

const PERSON: Field = field("person", NUMBER, "number of the person in the result");

/// Every action, in the order of its documentation.
pub const CORRECTION_FORMS: &[Form] = &[
    action(
        "rename",
        "names a person",
        &[PERSON, field("name", Kind::Text, "name of 1 to 64 characters, which scenes and reports then show")],
    ),
    action(
        "merge",
        "several people are one; the number of the first one stays",
        &[field("people", Kind::Numbers, "two or more people; a camera may not show two of them in the same frame")],
    ),
    action(
        "split",
        "from a frame on a person is another one, with the next free number",
        &[PERSON, field("frame", Kind::Frame, "number of the first frame of the new person")],
    ),
    action(
        "exchange",
        "two people are exchanged from a frame on",
        &[
            field("people", Kind::Numbers, "the two people"),
            field("frame", Kind::Frame, "number of the first frame in which they are exchanged"),
            field("last_frame", Kind::Frame, "number of the last such frame; to the end without it"),
        ],
    ),
    action(
        "exclude_camera",
        "a camera is left out",
        &[field("camera", Kind::Text, "id of the camera; two others must stay")],
    ),
    action("exclude_person", "a person is left out, a reflection or a bystander for example", &[PERSON]),
    action(
        "exclude_frames",
        "detections in a range of frames are left out, those of one camera or of one person where these are named",
        &[
            field("frames", Kind::Numbers, "numbers of the first and the last frame"),
            field("camera", Kind::Text, "id of the only camera concerned"),
            field("person", NUMBER, "number of the only person concerned"),
        ],
    ),
    action(
        "set_height",
        "a person's standing height is known: the metric scale follows from it, from several by their mean",
        &[
            PERSON,
            Field {
                name: "metres",
                kind: Kind::Number { range: HEIGHT_RANGE, or_null: false },
                unit: "m",
                effect: "height without shoes",
            },
        ],
    ),
];

/// A valid correction with every field of its form.
#[cfg(test)]
pub(crate) fn example(form: &Form) -> serde_json::Value {
    use serde_json::{Map, Value, json};
    let value = |field: &Field| match (field.name, field.kind) {
        ("frame" | "last_frame" | "person", _) => json!(1),
        (_, Kind::Numbers) => json!([0, 1]),
        (_, Kind::Number { .. }) => json!(1.5),
        _ => json!("a"),
    };
    let fields = form.fields.iter().map(|field| (field.name.to_owned(), value(field)));
    Value::Object(Map::from_iter([("action".to_owned(), json!(form.from))].into_iter().chain(fields)))
}
