//! The noise of a real detector has the figures that its source shows.

use super::projection::{Projected, Projector, apparent_size};
use super::rig::RigCamera;
use super::scene::SimulatedScene;
use super::*;
use crate::body::skeleton::KeypointConvention;
use crate::session::Keypoint;
use nalgebra::Vector2;

const FPS: f64 = 25.0;
/// Larger errors, of the person's size, are outliers or flips and not part of the drift. Nine times the median error; the limit
/// of the source is six times its median, which contains errors of the true joints.
const OUTLIER_OF_SIZE: f64 = 0.1;

/// A person before four cameras of 25 Hz for two minutes.
fn long_take() -> SimulationConfig {
    SimulationConfig {
        people: 1,
        views: 4,
        frames: 3000,
        fps: FPS,
        convention: KeypointConvention::Body25,
        noise: NoiseConfig::preset(Preset::Paper).with_real_errors(),
        ..SimulationConfig::preset(Preset::Paper)
    }
}

/// Long take with selected noise.
fn long_take_with(noise: NoiseConfig) -> SimulationConfig {
    SimulationConfig { noise, ..long_take() }
}

/// Real noise without whole detections, for one kind of error at a time.
const KEYPOINTS_ALONE: RealNoise = RealNoise { ghosts: 0.0, half_detection_rate: 0.0, merged_limb_rate: 0.0 };

/// A keypoint in one frame with a detection.
#[derive(Clone, Copy)]
struct Sample {
    projected: Projected,
    /// Error of the reported point, of the person's size, and its confidence; `None` if the point is missing.
    found: Option<(Vector2<f64>, f64)>,
}

/// All samples of one keypoint of a person in a view, by frame; `None` without a detection.
struct Series {
    keypoint: &'static str,
    samples: Vec<Option<Sample>>,
}

fn series_of(simulated: &Simulated) -> Vec<Series> {
    let (session, truth) = (&simulated.session, &simulated.truth);
    let projector = Projector::new(session.convention);
    let scene = SimulatedScene {
        details: Vec::new(),
        joints: truth.joints.clone(),
        keypoints: truth.keypoints.clone(),
        convention: session.convention,
        exists: vec![true; session.n_frames],
    };
    let names = session.convention.names();
    let mut all = Vec::new();
    for (v, view) in session.views.iter().enumerate() {
        let camera_from_world = truth.cameras[v];
        let camera = RigCamera { id: view.id.clone(), intrinsics: view.intrinsics, camera_from_world };
        for person in 0..truth.people.len() {
            let mut of_person: Vec<Series> =
                names.iter().map(|keypoint| Series { keypoint, samples: vec![None; session.n_frames] }).collect();
            for (f, detections) in view.frames.iter().enumerate() {
                let Some(d) = truth.identities[v][f].iter().position(|p| *p == Some(person)) else { continue };
                let projected = projector.project(&scene, f, person, &camera);
                let size = apparent_size(&projected);
                for (k, series) in of_person.iter_mut().enumerate() {
                    let (keypoint, projected) = (&detections[d].keypoints[k], projected[k]);
                    let found = || ((keypoint.pixel - projected.pixel) / size, keypoint.confidence);
                    series.samples[f] = Some(Sample { projected, found: keypoint.is_present().then(found) });
                }
            }
            all.append(&mut of_person);
        }
    }
    all
}

fn series(config: &SimulationConfig) -> Vec<Series> {
    series_of(&simulate(config).unwrap())
}

impl Series {
    /// Error in a frame, of the person's size, if it is not gross.
    fn error(&self, frame: usize) -> Option<Vector2<f64>> {
        let (error, _) = self.samples[frame]?.found?;
        (error.norm() < OUTLIER_OF_SIZE).then_some(error)
    }
}

fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    values.into_iter().for_each(|value| (sum, n) = (sum + value, n + 1.0));
    sum / n
}

/// Autocorrelation of errors over all series after `lag` frames; the mean is that of all views and people: 0.
fn autocorrelation(all: &[Series], lag: usize) -> f64 {
    let pairs = all
        .iter()
        .flat_map(|series| (lag..series.samples.len()).filter_map(move |f| series.error(f - lag).zip(series.error(f))));
    let (mut product, mut square) = (0.0, 0.0);
    for (before, after) in pairs {
        product += before.dot(&after);
        square += 0.5 * (before.norm_squared() + after.norm_squared());
    }
    product / square
}

/// A state of a sample; `None`: not to be counted.
type State = fn(&Sample) -> Option<bool>;

/// Probability that `state` holds `lag` frames after it held.
fn persistence(all: &[Series], lag: usize, state: State) -> f64 {
    let state = |series: &Series, f: usize| series.samples[f].as_ref().and_then(state);
    let pairs = all.iter().flat_map(|series| {
        (lag..series.samples.len()).filter_map(move |f| state(series, f - lag).zip(state(series, f)))
    });
    mean(pairs.filter(|(before, _)| *before).map(|(_, after)| f64::from(u8::from(after))))
}

/// Share of samples with a state for which it holds.
fn share(all: &[Series], state: State) -> f64 {
    mean(
        all.iter().flat_map(|series| series.samples.iter().flatten().filter_map(state)).map(|s| f64::from(u8::from(s))),
    )
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    order.into_iter().enumerate().for_each(|(rank, i)| ranks[i] = rank as f64 / values.len() as f64 - 0.5);
    ranks
}

/// The source's figures. Sampling error of two minutes and four views: 0.01 to 0.02.
#[test]
fn errors_have_the_measured_autocorrelation() {
    let all = series(&long_take());
    let measured = [(1, 0.84), (5, 0.63), (10, 0.53), (25, 0.38), (50, 0.23), (100, 0.07)];
    let found = measured.map(|(lag, _)| autocorrelation(&all, lag));
    assert!(found.iter().zip(measured).all(|(found, (_, measured))| (found - measured).abs() < 0.03), "{found:.3?}");
    let preset = series(&long_take_with(NoiseConfig::preset(Preset::Paper)));
    assert!(autocorrelation(&preset, 25) < 0.05);
}

#[test]
fn autocorrelation_does_not_depend_on_the_frame_rate() {
    let all = series(&SimulationConfig { fps: 50.0, ..long_take() });
    let measured = [(2, 0.84), (10, 0.63), (20, 0.53), (50, 0.38)];
    let found = measured.map(|(lag, _)| autocorrelation(&all, lag));
    assert!(found.iter().zip(measured).all(|(found, (_, measured))| (found - measured).abs() < 0.04), "{found:.3?}");
}

/// Over the 12 s of the source, 23 % of the variance is constant per person, view and keypoint.
#[test]
fn a_part_of_the_error_is_constant_over_12_seconds() {
    let (mut constant, mut total) = (0.0, 0.0);
    for series in series(&long_take()) {
        for start in (0..series.samples.len()).step_by(300) {
            let errors: Vec<Vector2<f64>> = (start..start + 300).filter_map(|f| series.error(f)).collect();
            if errors.len() > 50 {
                let n = errors.len() as f64;
                constant += (errors.iter().sum::<Vector2<f64>>() / n).norm_squared() * n;
                total += errors.iter().map(Vector2::norm_squared).sum::<f64>();
            }
        }
    }
    let found = constant / total;
    assert!((found - 0.23).abs() < 0.06, "{found}");
}

#[test]
fn hips_err_three_times_as_much_as_the_nose() {
    let all = series(&long_take());
    let level = |part: &str| {
        let of_part = all.iter().filter(|series| series.keypoint.contains(part));
        mean(of_part.flat_map(|s| (0..s.samples.len()).filter_map(|f| s.error(f))).map(|e| e.norm_squared())).sqrt()
    };
    let ratio = level("hip") / level("nose");
    assert!((2.5..3.5).contains(&ratio), "{ratio}");
    assert!(level("wrist") > 1.2 * level("nose") && level("knee") < level("hip"));
}

/// Source: rank correlation -0.41, mean 0.75, standard deviation 0.14.
#[test]
fn confidence_hardly_depends_on_the_error() {
    let all = series(&long_take());
    let points: Vec<(f64, f64)> = all
        .iter()
        .flat_map(|s| s.samples.iter().flatten().filter_map(|s| s.found))
        .map(|(e, c)| (e.norm(), c))
        .collect();
    let (errors, confidences): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
    // Ranks from -0.5 to 0.5 have the variance 1/12.
    let spearman = 12.0 * mean(ranks(&errors).iter().zip(ranks(&confidences)).map(|(a, b)| a * b));
    assert!((spearman + 0.41).abs() < 0.05, "{spearman}");
    let middle = mean(confidences.iter().copied());
    let sd = mean(confidences.iter().map(|c| (c - middle).powi(2))).sqrt();
    assert!((middle - 0.75).abs() < 0.04 && (sd - 0.14).abs() < 0.03, "{middle}, standard deviation {sd}");
}

#[test]
fn outliers_last_a_third_of_a_second() {
    let is_outlier: State = |sample| sample.found.map(|(error, _)| error.norm() > 1e-3);
    let noise = NoiseConfig { outlier_rate: 0.02, outlier_of_size: 0.2, ..NoiseConfig::NONE };
    let real = series(&long_take_with(NoiseConfig { real: Some(KEYPOINTS_ALONE), ..noise }));
    // 2 % of the points that are seen, 8 % of the few that are hidden.
    let found = share(&real, is_outlier);
    assert!((0.018..0.028).contains(&found), "{found}");
    // Some 800 outliers: one standard error is 0.02.
    let lasting = persistence(&real, 8, is_outlier);
    assert!((lasting - (-0.32_f64 * 3.0).exp()).abs() < 0.06, "{lasting}");
    assert!(persistence(&series(&long_take_with(noise)), 8, is_outlier) < 0.08);
}

#[test]
fn holes_last_longer_than_missing_joints_of_presets() {
    let is_missing: State =
        |sample| (sample.projected.in_view && !sample.projected.turned_away).then_some(sample.found.is_none());
    let noise = NoiseConfig { missed_joint_rate: 0.02, ..NoiseConfig::NONE };
    let real = series(&long_take_with(NoiseConfig { real: Some(KEYPOINTS_ALONE), ..noise }));
    // 2 % in single frames, 0.04 holes a second of 0.9 s, more holes where points are hidden.
    let found = share(&real, is_missing);
    assert!((0.045..0.075).contains(&found), "{found}");
    let after = |secs: f64| persistence(&real, (secs * FPS) as usize, is_missing);
    // A hole is the cause of two thirds of the missing points; 80 % of the holes last 0.2 s, 33 % one second.
    assert!((0.4..0.7).contains(&after(0.2)) && (0.2..0.4).contains(&after(1.0)), "{}, {}", after(0.2), after(1.0));
    let presets = series(&long_take_with(noise));
    assert!(persistence(&presets, 5, is_missing) < 0.04);
}

#[test]
fn a_face_is_reported_until_it_is_turned_away() {
    let all = series(&long_take_with(NoiseConfig { real: Some(KEYPOINTS_ALONE), ..NoiseConfig::NONE }));
    let nose = || all.iter().filter(|s| s.keypoint == "nose").flat_map(|s| s.samples.iter().flatten());
    assert!(nose().all(|s| s.found.is_none() == (s.projected.turned_away || !s.projected.in_view)));
    // 107 to 180 degrees from the cameras of a ring: two fifths.
    let away = mean(nose().map(|s| f64::from(u8::from(s.projected.turned_away))));
    assert!((0.25..0.55).contains(&away), "{away}");
    assert!(
        all.iter()
            .filter(|s| s.keypoint == "neck")
            .flat_map(|s| s.samples.iter().flatten())
            .all(|s| !s.projected.turned_away)
    );
}

#[test]
fn ghosts_stay_at_a_place_for_half_a_second() {
    let real = RealNoise { ghosts: RealNoise::MEASURED.ghosts, ..KEYPOINTS_ALONE };
    let noise = NoiseConfig { real: Some(real), ..NoiseConfig::NONE };
    let Simulated { session, truth, .. } = simulate(&long_take_with(noise)).unwrap();
    let (mut n, mut ghosts) = (0, std::collections::BTreeMap::new());
    for (v, view) in session.views.iter().enumerate() {
        for (f, detections) in view.frames.iter().enumerate() {
            let people = truth.identities[v][f].iter();
            for (detection, _) in detections.iter().zip(people).filter(|(_, person)| person.is_none()) {
                n += 1;
                ghosts.entry((v, detection.track_id.unwrap())).or_insert_with(Vec::new).push((f, detection));
            }
        }
    }
    assert_eq!(truth.statistics.ghosts, Some(n));
    assert!(truth.statistics.det_rate <= 1.0);
    // 0.12 around every camera, of which some half are in the image.
    let per_frame = n as f64 / (session.views.len() * session.n_frames) as f64;
    assert!((0.03..0.09).contains(&per_frame), "{per_frame}");
    let spans = || ghosts.values().map(|g| (g[g.len() - 1].0 - g[0].0 + 1) as f64 / FPS);
    // Some fifty ghosts: one standard error is 14 %.
    assert!((0.3..0.75).contains(&mean(spans())), "{} s, {} ghosts", mean(spans()), ghosts.len());
    for frames in ghosts.values() {
        for pair in frames.windows(2) {
            let size = |d: &crate::session::Detection| {
                projection::size_of(d.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel))
            };
            let both = pair[0].1.keypoints.iter().zip(&pair[1].1.keypoints);
            // Seven standard deviations of a difference; a size is that of the reported points alone.
            let near = |(a, b): (&Keypoint, &Keypoint)| (a.pixel - b.pixel).norm() < 0.6 * size(pair[0].1);
            assert!(both.filter(|(a, b)| a.is_present() && b.is_present()).all(near));
        }
    }
}

#[test]
fn half_detections_lack_knees_and_feet() {
    let real = RealNoise { half_detection_rate: 0.05, ..KEYPOINTS_ALONE };
    let all = series(&long_take_with(NoiseConfig { real: Some(real), ..NoiseConfig::NONE }));
    let missing = |parts: &[&str]| {
        let of_parts: Vec<Sample> = all
            .iter()
            .filter(|series| parts.iter().any(|part| series.keypoint.contains(part)))
            .flat_map(|series| series.samples.iter().flatten().copied())
            .collect();
        mean(of_parts.iter().filter(|s| s.projected.in_view).map(|s| f64::from(u8::from(s.found.is_none()))))
    };
    // Points that are hidden have holes, too.
    let (legs, others) = (missing(&["knee", "ankle", "toe", "heel"]), missing(&["hip", "shoulder", "elbow", "wrist"]));
    assert!(others < 0.02 && (legs - others - 0.05).abs() < 0.01, "{legs} of the legs, {others} of the rest");
}

#[test]
fn overlapping_people_exchange_arms_and_legs_alone() {
    let real = RealNoise { merged_limb_rate: RealNoise::MEASURED.merged_limb_rate, ..KEYPOINTS_ALONE };
    let config = SimulationConfig {
        people: 2,
        frames: 300,
        motion: MotionSource::Dance,
        noise: NoiseConfig { real: Some(real), ..NoiseConfig::NONE },
        ..long_take()
    };
    let simulated = simulate(&config).unwrap();
    let merged = simulated.truth.statistics.merged_limbs.unwrap();
    // Dancers within arms' reach overlap in about half of the frames of a view: 0.15 of some 600.
    assert!((30..200).contains(&merged), "{merged}");
    let all = series_of(&simulated);
    // Without other noise a point that is off its projection is a point of the other person.
    let n_foreign = |parts: &[&str]| {
        let of_parts = all.iter().filter(|series| parts.iter().any(|part| series.keypoint.contains(part)));
        let found = of_parts.flat_map(|series| series.samples.iter().flatten().filter_map(|s| s.found));
        found.filter(|(error, _)| error.norm() > 0.002).count()
    };
    assert_eq!(n_foreign(&["nose", "eye", "ear", "neck", "shoulder", "hip"]), 0);
    let (elbows, knees) = (n_foreign(&["elbow"]), n_foreign(&["knee"]));
    assert!(elbows > 5 && knees > 5 && elbows + knees <= merged, "{elbows} elbows and {knees} knees of {merged}");
}

#[test]
fn only_real_noise_appears_in_written_parameters() {
    let params = |noise: NoiseConfig| serde_json::to_value(SimulationConfig { noise, ..long_take() }).unwrap();
    let preset = NoiseConfig::preset(Preset::Paper);
    assert_eq!(params(preset)["noise"].get("real"), None);
    assert_eq!(params(preset.with_real_errors())["noise"]["real"]["ghosts"], 0.12);
    let short = SimulationConfig { frames: 2, noise: preset, ..long_take() };
    let statistics = serde_json::to_value(simulate(&short).unwrap().truth.statistics).unwrap();
    assert_eq!((statistics.get("ghosts"), statistics.get("merged_limbs")), (None, None));
}
