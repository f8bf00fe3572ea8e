//! `wandless simulate`: simulates a session with exact ground truth.

use super::bad_input::BadInput;
use super::noise::NoiseName;
use super::output_folder::require_free;
use crate::body::dense_landmarks::checked_table;
use crate::body::skeleton::KeypointConvention;
use crate::session::formats::native::{self, landmarks_from_json};
use crate::simulation::{
    Bodies, HandNoise, Lens, MotionSource, Preset, SimulationConfig, Statistics, Tracks, random_rig_config,
};
use crate::simulation::{simulate, write_truth};
use anyhow::Context;
use clap::ValueEnum;
use std::path::PathBuf;
use std::sync::Arc;

/// Simulates people, cameras and detectors; writes a session with its ground truth in `gt/`.
///
/// Options that are not given take the value of the preset. The same arguments give the same bytes.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Output folder; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// Difficulty; `random` draws cameras and people from the seed
    #[arg(long, value_enum, default_value_t = PresetName::Paper)]
    preset: PresetName,
    /// Kind of the errors; their rates are those of the preset
    #[arg(long, value_enum, default_value_t = NoiseName::Presets)]
    noise: NoiseName,
    /// Anisotropic errors of changing size, whose covariances the detector states
    #[arg(long)]
    covariances: bool,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of people
    #[arg(long)]
    people: Option<usize>,
    /// Number of cameras
    #[arg(long)]
    views: Option<usize>,
    /// Length in frames
    #[arg(long)]
    frames: Option<usize>,
    /// Frames per second
    #[arg(long)]
    fps: Option<f64>,
    /// Keypoint convention
    #[arg(long, value_parser = parse_convention)]
    convention: Option<KeypointConvention>,
    /// Landmarks behind the keypoints: a file of `body landmarks`; needs --default-bodies or --individual-bodies
    #[arg(long, value_name = "FILE", requires = "skin")]
    landmarks: Option<PathBuf>,
    /// Scope of track ids: the same person in all views, per view, or none
    #[arg(long, value_enum)]
    tracks: Option<TracksName>,
    /// Use default bodies of random shapes instead of the stick figures of the simulator
    #[arg(long, group = "skin")]
    default_bodies: bool,
    /// Like --default-bodies, with individual joint positions inside the body and a biased keypoint detector
    #[arg(long, group = "skin")]
    individual_bodies: bool,
    /// Procedural motion (walk, turn, crouch, sit, reach, gesture) instead of samples of the motion prior
    #[arg(long, conflicts_with = "motion")]
    procedural: bool,
    /// Two people dance within arm's reach of each other
    #[arg(long, conflicts_with_all = ["motion", "procedural"])]
    dance: bool,
    /// People run straight through the middle at this speed, m/s
    #[arg(long, conflicts_with_all = ["motion", "procedural", "dance"], value_name = "M_PER_S")]
    running: Option<f64>,
    /// Motion files in the AMASS layout, one per person, instead of samples of the motion prior
    #[arg(long, num_args = 1..)]
    motion: Vec<PathBuf>,
    /// Distance of the cameras from the centre, m
    #[arg(long)]
    radius: Option<f64>,
    /// Height of the cameras, m
    #[arg(long)]
    height: Option<f64>,
    /// Horizontal field of view, degrees
    #[arg(long)]
    fov: Option<f64>,
    /// Image width and height, px
    #[arg(long, num_args = 2, value_names = ["WIDTH", "HEIGHT"])]
    size: Option<Vec<u32>>,
    /// Identity swaps per view per minute
    #[arg(long)]
    swaps_per_minute: Option<f64>,
    /// Share of the frames of a view in which two hands are exchanged, for conventions with hands
    #[arg(long, value_name = "SHARE")]
    hand_swaps: Option<f64>,
    /// Lens distortion
    #[arg(long, value_enum)]
    lens: Option<LensName>,
    /// Time offset of each camera in frames, in the order of the cameras
    #[arg(long, num_args = 1.., allow_negative_numbers = true, value_name = "FRAMES")]
    offset: Vec<f64>,
}

/// Values of `--lens`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)] // clap would print them; `Lens` documents them
pub(super) enum LensName {
    Pinhole,
    WideAngle,
    Fisheye,
}

/// Values of `--preset`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)] // clap would print them; `Preset` documents them
pub(super) enum PresetName {
    Easy,
    Paper,
    Hard,
    Random,
}

/// Values of `--tracks`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)] // clap would print them; `Tracks` documents them
pub(super) enum TracksName {
    Consistent,
    PerView,
    None,
}

/// Simulates and writes the session; prints statistics of its difficulty (JSON).
///
/// # Errors
/// [`BadInput`] for numbers out of range, unreadable motion files and a folder that holds other files; errors of the file system.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    println!("{}", serde_json::to_string_pretty(&simulate_into_folder(&args)?)?);
    Ok(())
}

/// Simulates and writes the session; returns statistics of its difficulty.
///
/// # Errors
/// As [`run`].
pub(super) fn simulate_into_folder(args: &Args) -> anyhow::Result<Statistics> {
    require_free(&args.out)?;
    let mut config = config(args);
    if let Some(path) = &args.landmarks {
        let shown = |error: &dyn std::fmt::Display| BadInput(format!("{}: {error}", path.display()));
        let bytes = std::fs::read(path).map_err(|error| shown(&error))?;
        let (name, stated) = landmarks_from_json(&bytes).map_err(|error| shown(&error))?;
        let table = checked_table(&name, &stated).map_err(|error| shown(&error))?;
        (config.convention, config.dense) = (table.base, table.dense.map(Arc::new));
    }
    let simulated = simulate(&config).map_err(|error| BadInput(error.to_string()))?;
    let write =
        || native::write_folder(&simulated.session, &args.out).and_then(|()| write_truth(&simulated, &args.out));
    write().with_context(|| format!("cannot write {}", args.out.display()))?;
    Ok(simulated.truth.statistics)
}

fn config(args: &Args) -> SimulationConfig {
    let mut config = match args.preset {
        PresetName::Easy => SimulationConfig::preset(Preset::Easy),
        PresetName::Paper => SimulationConfig::preset(Preset::Paper),
        PresetName::Hard => SimulationConfig::preset(Preset::Hard),
        PresetName::Random => random_rig_config(args.seed),
    };
    config.seed = args.seed;
    config.noise = args.noise.of(config.noise);
    config.noise.covariances = args.covariances;
    if args.default_bodies {
        config.bodies = Bodies::Default;
    }
    if args.individual_bodies {
        config.bodies = Bodies::Individual;
    }
    config.motion = match args {
        Args { procedural: true, .. } => MotionSource::Procedural,
        Args { dance: true, .. } => MotionSource::Dance,
        Args { running: Some(speed), .. } => MotionSource::Running { speed: *speed },
        _ => MotionSource::Prior,
    };
    if !args.motion.is_empty() {
        config.people = args.motion.len();
        config.motion = MotionSource::Files(args.motion.clone());
    }
    set(&mut config.people, args.people);
    set(&mut config.views, args.views);
    set(&mut config.frames, args.frames);
    set(&mut config.fps, args.fps);
    set(&mut config.convention, args.convention);
    set(&mut config.rig.radius, args.radius);
    set(&mut config.rig.height, args.height);
    set(&mut config.rig.fov_deg, args.fov);
    set(&mut config.noise.swaps_per_minute, args.swaps_per_minute);
    if let Some(swap_rate) = args.hand_swaps {
        config.hands = Some(HandNoise { swap_rate, ..HandNoise::default() });
    }
    let lens = args.lens.map(|name| match name {
        LensName::Pinhole => Lens::Pinhole,
        LensName::WideAngle => Lens::WideAngle,
        LensName::Fisheye => Lens::Fisheye,
    });
    set(&mut config.rig.lens, lens);
    if !args.offset.is_empty() {
        config.time_offsets.clone_from(&args.offset);
    }
    if let Some([width, height]) = args.size.as_deref() {
        (config.rig.image_width, config.rig.image_height) = (*width, *height);
    }
    let tracks = args.tracks.map(|name| match name {
        TracksName::Consistent => Tracks::Consistent,
        TracksName::PerView => Tracks::PerView,
        TracksName::None => Tracks::None,
    });
    set(&mut config.tracks, tracks);
    config
}

/// Overwrites `field` if a value is given.
fn set<T>(field: &mut T, given: Option<T>) {
    if let Some(value) = given {
        *field = value;
    }
}

pub(super) fn parse_convention(name: &str) -> Result<KeypointConvention, String> {
    KeypointConvention::parse(name).ok_or_else(|| {
        let known: Vec<&str> = KeypointConvention::ALL.into_iter().map(KeypointConvention::name).collect();
        format!("one of {} expected", known.join(", "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::arguments::arguments_of;
    use crate::session::upload::{UploadLimits, read_path};
    use crate::simulation::NoiseConfig;

    fn args(line: &str) -> Args {
        arguments_of(format!("simulate {line}").split_whitespace().map(str::to_owned)).unwrap()
    }

    #[test]
    fn arguments_override_the_preset() {
        let given =
            config(&args("--out x --preset hard --people 2 --size 640 480 --tracks per-view --convention halpe26"));
        assert_eq!((given.people, given.views, given.rig.image_height), (2, 5, 480));
        assert_eq!((given.tracks, given.convention), (Tracks::PerView, KeypointConvention::Halpe26));
        assert_eq!(config(&args("--out x --preset random --seed 4 --procedural")), random_rig_config(4));
        assert_eq!(config(&args("--offset 0 -14 6.3 --out x")).time_offsets, [0.0, -14.0, 6.3]);
        assert_eq!(config(&args("--out x")).motion, MotionSource::Prior);
        assert_eq!(config(&args("--out x")).noise, NoiseConfig::preset(Preset::Paper));
        let real = NoiseConfig::preset(Preset::Easy).with_real_errors();
        assert_eq!(config(&args("--out x --preset easy --noise real")).noise, real);
        assert!(arguments_of::<Args>(["simulate", "--out", "x", "--convention", "tail"]).is_err());
    }

    #[test]
    fn a_folder_of_another_session_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let simulated = |line: &str| {
            let mut args = args(&format!("--out x --frames 5 {line}"));
            args.out = folder.path().to_owned();
            simulate_into_folder(&args)
        };
        assert!(simulated("--people 0").unwrap_err().is::<BadInput>(), "a number out of range is wrong usage");
        simulated("--views 3").unwrap();
        let error = simulated("--views 2").unwrap_err();
        assert!(error.is::<BadInput>() && error.to_string().contains("not empty"), "{error}");
        assert!(arguments_of::<Args>(["simulate", "--out", "x", "--landmarks", "l.json"]).is_err());
        args("--out x --landmarks l.json --individual-bodies");
    }

    #[test]
    fn written_session_reads_back_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        for (k, noise) in ["presets", "real", "presets --covariances", "real --covariances"].into_iter().enumerate() {
            let mut args = args(&format!("--out x --preset hard --frames 40 --noise {noise}"));
            args.out = folder.path().join(k.to_string());
            let out = args.out.clone();
            let simulated = simulate(&config(&args)).unwrap();
            run(args).unwrap();
            let read = read_path(&out, &UploadLimits::default()).unwrap();
            assert_eq!(read.session, simulated.session);
            // The only warning says that `gt/` is not part of an upload.
            assert!(read.warnings.iter().all(|warning| warning.contains("gt/")), "{:?}", read.warnings);
        }
    }
}
