//! `wandless bench covariances`: what the covariances that a detector states are worth.
//!
//! Every simulated session has anisotropic errors of changing size. It is solved with their true covariances, with wrong ones and
//! without any; printed are the errors over those without.
//!
//! The confidences of the presets' noise fall with the errors themselves and tell most of what stated sizes would: with them true
//! covariances are worth 3 %, with realistic errors two fifths.

use super::evaluated::evaluated;
use crate::cli::noise::NoiseName;
use crate::cli::output_folder::make_free;
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::Alignment;
use crate::geometry::PixelCovariance;
use crate::pipeline::Options;
use crate::session::formats::native::write_folder;
use crate::session::{Detection, Keypoint, Session};
use crate::simulation::{Bodies, Preset, SimulationConfig, Tracks, simulate, write_truth};
use anyhow::Context;
use clap::builder::PossibleValuesParser;
use nalgebra::Matrix2;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Arguments of `bench covariances`.
#[derive(Debug, clap::Args)]
pub(super) struct CovariancesArgs {
    /// Output folder for the sessions, all results and covariances.json; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// Number of sessions
    #[arg(long, default_value_t = 5)]
    count: u64,
    /// Seed of the first session; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of people
    #[arg(long, default_value_t = 2)]
    people: usize,
    /// Number of cameras
    #[arg(long, default_value_t = 6)]
    views: usize,
    /// Length in frames
    #[arg(long, default_value_t = 300)]
    frames: usize,
    /// Kind of the detector's errors; their rates are those of the preset `paper`
    #[arg(long, value_enum, default_value_t = NoiseName::Real)]
    noise: NoiseName,
    /// Only the variants whose names are given, besides the one without covariances
    #[arg(long, num_args = 1.., value_parser = PossibleValuesParser::new(VARIANTS.map(|variant| variant.name)))]
    only: Vec<String>,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// A change of what the detector states.
struct Variant {
    name: &'static str,
    change: fn(&mut Detection),
}

/// The solve that all others are compared with.
const IGNORED: &str = "ignored";

const VARIANTS: [Variant; 5] = [
    Variant { name: "true", change: |_| {} },
    Variant { name: "times 10", change: |detection| scale(detection, |_| 10.0) },
    Variant { name: "times 0.1", change: |detection| scale(detection, |_| 0.1) },
    Variant { name: "times 10 or 0.1", change: |detection| scale(detection, of_column) },
    Variant { name: "exchanged", change: exchange },
];

/// The errors of a solve.
#[derive(Debug, Clone, Copy, Serialize)]
struct Errors {
    camera_deg: f64,
    root12_mm: f64,
    /// How far stated sizes and shapes counted, 0 to 1.
    exponents: [f64; 2],
}

/// The errors of a variant over those without covariances, means over the sessions (geometric).
#[derive(Debug, Serialize)]
struct Row {
    variant: &'static str,
    camera_angle_ratio: f64,
    root12_ratio: f64,
    exponents: [f64; 2],
}

pub(super) fn run(args: &CovariancesArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    make_free(&args.out)?;
    let is_wanted = |variant: &&Variant| args.only.is_empty() || args.only.iter().any(|name| *name == variant.name);
    let variants: Vec<&Variant> = VARIANTS.iter().filter(is_wanted).collect();
    let mut ratios: Vec<Vec<[f64; 4]>> = vec![Vec::new(); variants.len()];
    for seed in args.seed..args.seed + args.count {
        let (session, folder) = simulated(args, seed)?;
        let errors = |name: &str, change: fn(&mut Detection)| {
            let mut changed = session.clone();
            changed.views.iter_mut().flat_map(|view| view.frames.iter_mut().flatten()).for_each(change);
            solved(&changed, &folder, name)
        };
        let without = errors(IGNORED, |detection| scale(detection, |_| f64::NAN))?;
        println!("seed {seed}: {IGNORED}: camera {:.4} deg, root12 {:.2} mm", without.camera_deg, without.root12_mm);
        for (variant, ratios) in variants.iter().zip(&mut ratios) {
            let with = errors(variant.name, variant.change)?;
            let (camera, root12) = (with.camera_deg / without.camera_deg, with.root12_mm / without.root12_mm);
            println!(
                "seed {seed}: {}: camera {camera:.3}, root12 {root12:.3} times, exponents {:.2?}",
                variant.name, with.exponents
            );
            ratios.push([camera, root12, with.exponents[0], with.exponents[1]]);
        }
    }
    let rows: Vec<Row> = variants.iter().zip(&ratios).map(|(variant, ratios)| row(variant.name, ratios)).collect();
    for row in &rows {
        println!(
            "{}: camera angle {:.3}, root12 {:.3} times, exponents {:.2?}",
            row.variant, row.camera_angle_ratio, row.root12_ratio, row.exponents
        );
    }
    let path = args.out.join("covariances.json");
    std::fs::write(&path, serde_json::to_string_pretty(&rows)? + "\n").with_context(|| path.display().to_string())
}

fn row(variant: &'static str, ratios: &[[f64; 4]]) -> Row {
    let mean = |value: &dyn Fn(&[f64; 4]) -> f64| ratios.iter().map(value).sum::<f64>() / ratios.len().max(1) as f64;
    Row {
        variant,
        camera_angle_ratio: mean(&|ratios| ratios[0].ln()).exp(),
        root12_ratio: mean(&|ratios| ratios[1].ln()).exp(),
        exponents: [mean(&|ratios| ratios[2]), mean(&|ratios| ratios[3])],
    }
}

/// A session with stated covariances, and its folder. Default bodies: with others the body model's misfit would hide the detector's
/// errors.
fn simulated(args: &CovariancesArgs, seed: u64) -> anyhow::Result<(Session, PathBuf)> {
    let preset = SimulationConfig::preset(Preset::Paper);
    let mut config = SimulationConfig {
        seed,
        people: args.people,
        views: args.views,
        frames: args.frames,
        tracks: Tracks::None,
        bodies: Bodies::Default,
        noise: args.noise.of(preset.noise),
        ..preset
    };
    config.noise.covariances = true;
    let simulated = simulate(&config)?;
    let folder = args.out.join(seed.to_string());
    let written = write_folder(&simulated.session, &folder).and_then(|()| write_truth(&simulated, &folder));
    written.with_context(|| folder.display().to_string())?;
    Ok((simulated.session, folder))
}

fn solved(session: &Session, folder: &Path, name: &str) -> anyhow::Result<Errors> {
    let out = folder.join(name.replace(' ', "-"));
    let found = evaluated(session, &Options::default(), "", &folder.join("gt"), Alignment::Sim3, &out)?;
    let stages = &found.result.report.stages;
    let exponent = |name: &str| stages.iter().find_map(|stage| stage.metrics.get(name)).copied().unwrap_or(0.0);
    Ok(Errors {
        camera_deg: found.errors.cameras.and_then(|cameras| cameras.sim3.angle_deg).unwrap_or(f64::NAN),
        root12_mm: found.errors.poses.and_then(|poses| poses.mpjpe.root12).unwrap_or(f64::NAN),
        exponents: ["covariance_size_exponent", "covariance_shape_exponent"].map(exponent),
    })
}

/// 10 or 0.1 by the column of the pixel: as good as random.
fn of_column(keypoint: &Keypoint) -> f64 {
    if keypoint.pixel.x.rem_euclid(2.0) < 1.0 { 10.0 } else { 0.1 }
}

/// Multiplies the covariance of each keypoint; NaN removes it.
fn scale(detection: &mut Detection, factor: fn(&Keypoint) -> f64) {
    for keypoint in &mut detection.keypoints {
        let jacobian = Matrix2::identity() * factor(keypoint).sqrt();
        keypoint.covariance = keypoint.covariance.and_then(|covariance| covariance.mapped(&jacobian));
    }
}

/// Gives each keypoint the covariance of another one.
fn exchange(detection: &mut Detection) {
    let mut given: Vec<&mut Option<PixelCovariance>> =
        detection.keypoints.iter_mut().map(|keypoint| &mut keypoint.covariance).filter(|own| own.is_some()).collect();
    let original: Vec<Option<PixelCovariance>> = given.iter().map(|own| **own).collect();
    for (k, own) in given.iter_mut().enumerate() {
        **own = original[(k + 5) % original.len()];
    }
}
