//! `wandless body`: inspects, registers and exports body models.

use super::bad_input::BadInput;
#[cfg(feature = "service")]
use super::data_folder::DataFolder;
use super::simulate::parse_convention;
use crate::body::dense_landmarks::{checked_table, spread_over_skin};
use crate::body::loader::{LandmarkTable, body_glb, body_npz, body_obj, load_body};
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention, PARENTS};
use crate::body::{Betas, BodyModel, default_body};
#[cfg(feature = "service")]
use crate::service::bodies;
use crate::session::formats::native::landmarks_json;
use anyhow::Context;
use std::path::{Path, PathBuf};

/// Arguments of `body`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Validate a body file and print its properties
    Info {
        /// SMPL .npz or .pkl file, or SMPL-H or SMPL-X .npz file [default: the embedded body]
        file: Option<PathBuf>,
        /// JSON file that maps face and foot keypoints to vertices of the body
        #[arg(long, requires = "file")]
        landmarks: Option<PathBuf>,
    },
    /// Register a body under a name for use in options.body
    #[cfg(feature = "service")]
    Add {
        /// Name of the body: a-z, 0-9, - and _
        name: String,
        /// SMPL .npz or .pkl file, or SMPL-H or SMPL-X .npz file
        file: PathBuf,
        /// JSON file that maps face and foot keypoints to vertices of the body
        #[arg(long)]
        landmarks: Option<PathBuf>,
        #[command(flatten)]
        data: DataFolder,
    },
    /// List the registered bodies
    #[cfg(feature = "service")]
    List {
        #[command(flatten)]
        data: DataFolder,
    },
    /// Write a table of landmarks that are spread over a body's skin, behind the keypoints of a convention
    Landmarks {
        /// Number of landmarks
        #[arg(long, default_value_t = 150)]
        count: usize,
        /// Output file; beside session.json it is read as landmarks.json
        #[arg(long)]
        out: PathBuf,
        /// Keypoint convention that comes first
        #[arg(long, value_parser = parse_convention, default_value = "coco17")]
        base: KeypointConvention,
        /// Number of the vertex to begin with
        #[arg(long, default_value_t = 0)]
        seed: usize,
        /// SMPL .npz or .pkl file, or SMPL-H or SMPL-X .npz file [default: the embedded body]
        #[arg(long)]
        body: Option<PathBuf>,
    },
    /// Export a body in its rest pose
    Export {
        /// Output file: .npz (SMPL layout), .obj or .glb (mesh)
        #[arg(long)]
        out: PathBuf,
        /// SMPL .npz or .pkl file, or SMPL-H or SMPL-X .npz file [default: the embedded body]
        #[arg(long)]
        body: Option<PathBuf>,
    },
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    match args.action {
        Action::Info { file, landmarks } => {
            print!("{}", description(&read_body(file.as_deref(), landmarks.as_deref())?));
            Ok(())
        }
        #[cfg(feature = "service")]
        Action::Add { name, file, landmarks, data } => {
            let table = read_table(landmarks.as_deref())?;
            let added = bodies::add(&bodies::folder(&data.path()?), &name, &file, &table);
            let model = added.map_err(|error| BadInput(format!("{}: {error}", file.display())))?;
            println!("{name}: sha256 {}", model.sha256());
            Ok(())
        }
        #[cfg(feature = "service")]
        Action::List { data } => {
            for body in bodies::list(&bodies::folder(&data.path()?))? {
                println!("{}: {}", body.name, body.file);
            }
            Ok(())
        }
        Action::Landmarks { count, out, base, seed, body } => {
            let table = spread_over_skin(&read_body(body.as_deref(), None)?, base, count, seed);
            let name = format!("{}+{count}", base.name());
            checked_table(&name, &table).map_err(|error| BadInput(error.to_string()))?;
            std::fs::write(&out, landmarks_json(&name, &table)?).with_context(|| out.display().to_string())
        }
        Action::Export { out, body } => {
            let bytes = exported(&read_body(body.as_deref(), None)?, &out)?;
            std::fs::write(&out, bytes).with_context(|| out.display().to_string())
        }
    }
}

/// Reads a body file with its landmark table; without a file the embedded body.
pub(super) fn read_body(file: Option<&Path>, landmarks: Option<&Path>) -> anyhow::Result<BodyModel> {
    let Some(file) = file else { return Ok(default_body()) };
    let table = read_table(landmarks)?;
    load_body(file, &table).map_err(|error| BadInput(format!("{}: {error}", file.display())).into())
}

/// Reads a landmark table; without a file an empty table.
fn read_table(landmarks: Option<&Path>) -> anyhow::Result<LandmarkTable> {
    let Some(path) = landmarks else { return Ok(LandmarkTable::default()) };
    let bad = |error: &dyn std::fmt::Display| BadInput(format!("{}: {error}", path.display()));
    let json = std::fs::read(path).map_err(|error| bad(&error))?;
    Ok(LandmarkTable::from_json(&json).map_err(|error| bad(&error))?)
}

fn exported(model: &BodyModel, out: &Path) -> anyhow::Result<Vec<u8>> {
    let surface = &model.surface;
    match out.extension().and_then(|extension| extension.to_str()) {
        Some("npz") => Ok(body_npz(surface, true)?),
        Some("obj") => Ok(body_obj(&surface.vertices, &surface.faces).into_bytes()),
        Some("glb") => Ok(body_glb(&surface.vertices, &surface.faces)),
        _ => Err(BadInput(format!("{}: the file name must end with .npz, .obj or .glb", out.display())).into()),
    }
}

fn description(model: &BodyModel) -> String {
    let surface = &model.surface;
    let ys = || surface.vertices.iter().map(|v| v.y);
    let height = ys().fold(f64::MIN, f64::max) - ys().fold(f64::MAX, f64::min);
    let mut text = format!(
        "{} (sha256 {})\n{} vertices, {} faces, {}, {:.1} l\nheight {height:.3} m; per beta {:+.3?} m\n",
        model.name,
        model.sha256(),
        surface.vertices.len(),
        surface.faces.len(),
        if surface.is_watertight() { "watertight" } else { "not watertight" },
        surface.volume(&surface.vertices) * 1e3,
        heights_per_beta(model, height),
    );
    for convention in KeypointConvention::ALL {
        let landmarks = model.landmarks_of(convention);
        let n_known = landmarks.iter().flatten().count();
        text += &format!("{}: {n_known} of {} keypoints\n", convention.name(), landmarks.len());
    }
    text += "bone lengths of this and of the embedded body (m), angle between the bones (degrees):\n";
    let embedded = default_body();
    for (j, parent) in PARENTS.iter().enumerate() {
        if let Some(p) = *parent {
            let bone = model.rest_joints[j] - model.rest_joints[p];
            let reference = embedded.rest_joints[j] - embedded.rest_joints[p];
            let angle_deg = bone.angle(&reference).to_degrees();
            let (length, reference_length) = (bone.norm(), reference.norm());
            text += &format!("  {:15} {length:.3} {reference_length:.3} {angle_deg:5.1}\n", JOINT_NAMES[j]);
        }
    }
    text
}

/// Change of the height for +1 of each shape coefficient, m.
fn heights_per_beta(model: &BodyModel, mean: f64) -> Vec<f64> {
    let height = |k: usize| {
        let vertices = model.surface.shaped(&Betas::ith(k, 1.0));
        let ys = || vertices.iter().map(|v| v.y);
        ys().fold(f64::MIN, f64::max) - ys().fold(f64::MAX, f64::min)
    };
    (0..10).map(|k| height(k) - mean).collect()
}
