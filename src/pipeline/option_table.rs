//! The table of options: name, type, unit, range and effect of every option of a job.
//!
//! OpenAPI, the flags of the command line, `docs/options.md` and the dialog of the viewer derive from this table, so that they
//! cannot differ. Defaults are not repeated here: they come from [`Options::default`].

use super::config::Options;
use super::corrections::forms::CORRECTION_FORMS;
use super::option_kind::choice;
pub use super::option_kind::{Choice, Field, Form, Kind};
use crate::body::scale::HEIGHT_RANGE;
use crate::session::recording::FPS_RANGE;
use serde_json::Value;

/// One option of a job.
#[derive(Debug, Clone, Copy)]
pub struct OptionRow {
    /// Key in `options`.
    pub name: &'static str,
    /// Label in the viewer's dialog.
    pub label: &'static str,
    /// Type and range of its values.
    pub kind: Kind,
    /// Unit; empty where it has none.
    pub unit: &'static str,
    /// What the option does, in one or two sentences.
    pub effect: &'static str,
    /// Name of the flag without `--`; empty where the forms of the option have flags of their own.
    pub flag: &'static str,
    /// Whether most recordings need a decision about it: the viewer's dialog shows the others on request.
    pub is_common: bool,
}

/// Every option, in the order of its documentation.
pub const OPTION_TABLE: &[OptionRow] = &[
    OptionRow {
        name: "people",
        label: "People",
        kind: Kind::Whole { min: 1, or_null: true },
        unit: "people",
        effect: "Number of people in the recording, where it is known. Without it the number is estimated.",
        flag: "people",
        is_common: true,
    },
    OptionRow {
        name: "fps",
        label: "Frame rate",
        kind: Kind::Number { range: FPS_RANGE, or_null: true },
        unit: "frames per second",
        effect: "Frame rate of the recording; it replaces the rate in the session. Detectors write none: without this \
                 option and without `fps` in session.json 30 is assumed.",
        flag: "fps",
        is_common: true,
    },
    OptionRow {
        name: "extrinsics",
        label: "Camera poses",
        kind: Kind::Choice(&[
            choice("estimate", "estimated from the people; R and t of the session are ignored"),
            choice("fixed", "R and t of the session, unchanged; the result stays in their world"),
            choice(
                "refine",
                "refined: R and t of the session count as known to 20 mm and 0.3 degrees per axis; the result stays \
                 in their world",
            ),
        ]),
        unit: "",
        effect: "Positions and orientations of the cameras. `fixed` and `refine` need R and t of every camera; a single \
                 camera needs `fixed`.",
        flag: "extrinsics",
        is_common: true,
    },
    OptionRow {
        name: "intrinsics",
        label: "Focal lengths",
        kind: Kind::Choice(&[
            choice("fixed", "K and distortion of the session, unchanged"),
            choice(
                "refine_focal",
                "one factor of the focal length per camera is estimated together with poses and people, for focal \
                 lengths that may be wrong by some per cent; those that the recording does not contradict stay",
            ),
            choice(
                "estimate",
                "estimated from the people, from nothing but image sizes or from guesses that are up to half off; always \
                 where a camera has no K",
            ),
        ]),
        unit: "",
        effect: "Focal lengths of the cameras. `refine_focal` and `estimate` need two or more cameras; the first does not go \
                 with `extrinsics: fixed`, the second needs `extrinsics: estimate`.",
        flag: "intrinsics",
        is_common: true,
    },
    OptionRow {
        name: "sync",
        label: "Synchronisation",
        kind: Kind::Choice(&[
            choice("given", "`time_offset_s` of the session's cameras; 0 where it is missing"),
            choice(
                "estimate",
                "estimated from the motion, to fractions of a frame and with the drift of clocks, starting from those of the session",
            ),
        ]),
        unit: "",
        effect: "Time offsets between the cameras.",
        flag: "sync",
        is_common: true,
    },
    OptionRow {
        name: "repair",
        label: "Mistakes in the files",
        kind: Kind::Choice(&[
            choice("suggest", "each is named with its remedy; the files are solved as they are"),
            choice(
                "auto",
                "those with a single remedy are undone and the recording is solved again: mirrored images and y upwards, left and \
                 right exchanged in one camera, coordinates from 0 to 1, time offsets, focal lengths",
            ),
        ]),
        unit: "",
        effect: "What is done about probable mistakes that the recording itself shows.",
        flag: "repair",
        is_common: false,
    },
    OptionRow {
        name: "scale",
        label: "Metric scale",
        kind: Kind::Forms(&[
            Form {
                from: "body",
                meaning: "limb lengths and statures of adults; with unknown cameras its error is some 3 %",
                flag: ["", ""],
                fields: &[],
            },
            Form {
                from: "height",
                meaning: "the standing height of one person is known",
                flag: ["height", "METRES[,TRACK_ID]"],
                fields: &[
                    Field {
                        name: "metres",
                        kind: Kind::Number { range: HEIGHT_RANGE, or_null: false },
                        unit: "m",
                        effect: "height without shoes",
                    },
                    Field {
                        name: "who",
                        kind: Kind::Text,
                        unit: "",
                        effect: "`tallest`, or the track id that the session gives to the person's detections",
                    },
                ],
            },
            Form {
                from: "camera_distance",
                meaning: "the distance between two cameras is known",
                flag: ["camera-distance", "CAMERA,CAMERA,METRES"],
                fields: &[
                    Field { name: "cameras", kind: Kind::TwoCameras, unit: "", effect: "ids of the two cameras" },
                    Field {
                        name: "metres",
                        kind: Kind::Number { range: [0.0, f64::INFINITY], or_null: false },
                        unit: "m",
                        effect: "distance of their centres",
                    },
                ],
            },
        ]),
        unit: "",
        effect: "Source of the metric scale.",
        flag: "",
        is_common: true,
    },
    OptionRow {
        name: "up_axis",
        label: "Up axis",
        kind: Kind::Choice(&[
            choice("y", "y up, as in most animation programs"),
            choice("z", "z up, as in Blender, AMASS and most simulators"),
        ]),
        unit: "",
        effect: "Up axis of the result's world.",
        flag: "up",
        is_common: true,
    },
    OptionRow {
        name: "body",
        label: "Body model",
        kind: Kind::Text,
        unit: "",
        effect: "Body model that is fitted: `default`, or a name that the operator registered with `wandless body add`. \
                 `reconstruct` reads the model from a file instead.",
        flag: "body",
        is_common: false,
    },
    OptionRow {
        name: "denoise",
        label: "Repair identity swaps and left-right flips, reject inconsistent joints",
        kind: Kind::Switch,
        unit: "",
        effect: "Repairs detections: identity swaps and left-right flips are undone, joints that contradict the other \
                 cameras are rejected. Off: identities from association and tracking alone.",
        flag: "denoise",
        is_common: false,
    },
    OptionRow {
        name: "motion_prior",
        label: "Motion prior",
        kind: Kind::Choice(&[
            choice("denoiser", "likely poses and standing feet; joints that no camera shows for a while are completed"),
            choice(
                "latent",
                "codes of a motion autoencoder, fitted together with the cameras, as in the paper; for comparison",
            ),
            choice("pose", "likely poses and standing feet"),
            choice("none", "smoothness alone"),
        ]),
        unit: "",
        effect: "What is known of human motion beside the cameras. JSON may have `true` and `false` for `denoiser` and `none`.",
        flag: "motion-prior",
        is_common: false,
    },
    OptionRow {
        name: "collision",
        label: "Collision resolution between bodies",
        kind: Kind::Switch,
        unit: "",
        effect: "Moves bodies that reach into each other apart.",
        flag: "collision",
        is_common: false,
    },
    OptionRow {
        name: "seed",
        label: "Seed",
        kind: Kind::Whole { min: 0, or_null: false },
        unit: "",
        effect: "Seed of every random choice. The same session, options and seed give the same bytes.",
        flag: "seed",
        is_common: false,
    },
    OptionRow {
        name: "corrections",
        label: "Corrections",
        kind: Kind::Actions(CORRECTION_FORMS),
        unit: "",
        effect: "Corrections of identities and exclusions, applied in this order to the people of a solve without corrections. Numbers \
                 of people stay as they are; frames have the session's numbers. With given camera poses a height is refused.",
        flag: "corrections",
        is_common: false,
    },
    OptionRow {
        name: "exports",
        label: "Export formats in addition to JSON",
        kind: Kind::Choices(&[
            choice(
                "smpl_npz",
                "poses and shapes of every person in AMASS's layout (72 and 156 wide, with hands also SMPL-X's 165)",
            ),
            choice("easymocap", "EasyMocap's keypoints and SMPL parameters"),
            choice("glb", "cameras and people, skinned and animated, as a glTF scene"),
            choice(
                "bvh",
                "skeletons as BVH, one file per person, also with HumanIK's, Mixamo's and Unreal's joint names",
            ),
            choice(
                "fbx",
                "people, skinned and animated, as FBX: all in one file, and one file per person with these names",
            ),
            choice("usd", "cameras and people, skinned and animated, as a USD scene and as a package"),
            choice(
                "trc",
                "joint centres and keypoints as OpenSim's TRC with a set-up of its inverse kinematics, one file per person",
            ),
            choice("c3d", "joint centres and keypoints as C3D, one file per person"),
            choice(
                "joint_angles",
                "joint angles with standard deviations as CSV, and OpenSim's .mot, one file per person",
            )
            .or(&["mot", "angles_csv"]),
            choice("opencv_yaml", "cameras as OpenCV's intri.yml and extri.yml"),
            choice("calib_toml", "cameras as Pose2Sim's Calib.toml"),
            choice("anipose_toml", "cameras as anipose's calibration.toml"),
            choice("colmap", "cameras as COLMAP's text model"),
            choice("chan", "one .chan file per camera, for Nuke and Blender"),
            choice("blender", "a Python script that builds the scene in Blender"),
        ]),
        unit: "",
        effect: "Formats that are written in addition to the JSON files.",
        flag: "exports",
        is_common: false,
    },
];

impl OptionRow {
    /// The row of an option.
    pub fn named(name: &str) -> Option<&'static Self> {
        OPTION_TABLE.iter().find(|row| row.name == name)
    }

    /// The value that the option has where it is not given.
    pub fn default(&self) -> Value {
        serde_json::to_value(Options::default()).map_or(Value::Null, |all| all[self.name].clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A valid value of every choice and form of a row.
    fn values(row: &OptionRow) -> Vec<Value> {
        match row.kind {
            Kind::Switch => vec![json!(true), json!(false)],
            Kind::Whole { min, or_null } => [json!(min)].into_iter().chain(or_null.then_some(Value::Null)).collect(),
            Kind::Number { range, .. } => vec![json!(range[0])],
            Kind::Text | Kind::TwoCameras | Kind::Frame | Kind::Numbers => vec![json!("default")],
            Kind::Choice(choices) => choices.iter().map(|choice| json!(choice.value)).collect(),
            Kind::Choices(choices) => choices.iter().map(|choice| json!([choice.value])).collect(),
            Kind::Actions(forms) => {
                let with_fields = |form: &Form| crate::pipeline::corrections::forms::example(form);
                forms.iter().map(|form| json!([with_fields(form)])).collect()
            }
            Kind::Forms(forms) => forms
                .iter()
                .map(|form| {
                    let value = |field: &Field| match field.kind {
                        Kind::Number { .. } => json!(1.5),
                        Kind::TwoCameras => json!(["a", "b"]),
                        _ => json!("tallest"),
                    };
                    let fields = form.fields.iter().map(|field| (field.name.to_owned(), value(field)));
                    Value::Object([("from".to_owned(), json!(form.from))].into_iter().chain(fields).collect())
                })
                .collect(),
        }
    }

    #[test]
    fn table_has_every_option_once() {
        let all = serde_json::to_value(Options::default()).unwrap();
        let mut names: Vec<&str> = OPTION_TABLE.iter().map(|row| row.name).collect();
        names.sort_unstable();
        let mut known: Vec<&str> = all.as_object().unwrap().keys().map(String::as_str).collect();
        known.sort_unstable();
        assert_eq!(names, known);
    }

    #[test]
    fn every_listed_value_is_a_valid_option() {
        for row in OPTION_TABLE {
            for value in values(row) {
                let options = json!({ row.name: value });
                let read: Result<Options, _> = serde_json::from_value(options.clone());
                let read = read.unwrap_or_else(|error| panic!("{options}: {error}"));
                assert_eq!(serde_json::to_value(read).unwrap()[row.name], value);
            }
        }
    }

    #[test]
    fn rows_are_described_in_whole_sentences() {
        for row in OPTION_TABLE {
            assert!(row.effect.ends_with('.') && !row.label.is_empty(), "{}", row.name);
            let has_own_flags = matches!(row.kind, Kind::Forms(_));
            assert_eq!(row.flag.is_empty(), has_own_flags, "{}", row.name);
        }
    }
}
