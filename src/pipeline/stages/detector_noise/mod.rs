//! Measurement of the detector noise as a function of confidence, on this session: what one detector calls 0.9 another
//! calls 0.6, and an error three times as large has a ninth of the weight.
//!
//! The rays of one keypoint in two views, detected with confidences a and b, pass each other at a gap that is normal with
//! variance $\sigma^2(a) + \sigma^2(b)$, independent of the triangulated point and its weights. Keypoints are divided by
//! confidence into equal groups, pairs of rays into the cells of two groups. The median gap of each cell gives its
//! variance, and these sums give the variance of each group. The error must not rise with confidence: groups that violate
//! this are pooled (isotonic regression by pooling adjacent violators).

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::geometry::epipolar::{PluckerRay, ray_ray_distance};
use crate::matching::normalized::NormalizedDetection;
use crate::optim::robust::{NORMAL_SIGMA_OF_MAD, median};
use crate::session::{PersonTrack, Session};
use rayon::prelude::*;

/// Sine of the angle between two rays below which their gap is not used.
const MIN_SINE: f64 = 0.2;

/// Average number of pairs of rays in a cell: their median is known to 10 %, and every group has many cells.
const PER_CELL: usize = 100;

/// Largest and smallest number of groups.
const MAX_GROUPS: usize = 12;
const MIN_GROUPS: usize = 3;

/// Approximate largest number of pairs of rays: some 3,000 a cell, whose median is known to 2 %. More add no information; 100,000
/// left angles of cameras 0.5 to 1.9 % larger.
const MAX_GAPS: usize = 250_000;

/// Smallest factor: a fifth of the published noise is 4 mm on the body, which no detector reaches.
const MIN_FACTOR: f64 = 0.2;

/// Detector noise measured on the repaired detections of `session` under these cameras; `None` with too few of them.
pub fn measured_noise(session: &Session, cameras: &[Option<Rigid>], tracks: &[PersonTrack]) -> Option<DetectorNoise> {
    let published = DetectorNoise::published(session.convention);
    let knots = knots(gaps(session, cameras, tracks, published.sigmas_m()))?;
    Some(published.with_knots(knots))
}

/// Knots of confidence (rising) and the logarithm of the factor on the published standard deviations.
fn knots(gaps: Vec<Gap>) -> Option<Vec<[f64; 2]>> {
    let n_groups = ((2 * gaps.len() / PER_CELL) as f64).sqrt() as usize;
    if n_groups < MIN_GROUPS {
        return None;
    }
    let groups = Groups::cut(&gaps, n_groups.min(MAX_GROUPS));
    let variances = variances(&groups, gaps);
    let rows = groups.means.iter().zip(&groups.sizes).zip(variances);
    let groups = rows.filter(|((_, n), _)| **n > 0).map(|((confidence, n), variance)| Group {
        confidence: *confidence,
        ln_factor: variance.sqrt().max(MIN_FACTOR).ln(),
        n: *n as f64,
    });
    Some(pooled(groups).into_iter().map(|g| [g.confidence, g.ln_factor]).collect())
}

/// Gap between two rays of one keypoint; in single precision, since there are many, whose median is known to 2 %.
#[derive(Debug, Clone, Copy)]
struct Gap {
    confidences: [f32; 2],
    /// Distance of the rays in units of the keypoint's published standard deviation.
    sigmas: f32,
}

fn gaps(session: &Session, cameras: &[Option<Rigid>], tracks: &[PersonTrack], sigmas_m: &[f64]) -> Vec<Gap> {
    let n_pairs: usize = tracks.iter().flat_map(|track| &track.detections).map(|assignment| n_pairs(assignment)).sum();
    let stride = (n_pairs * sigmas_m.len()).div_ceil(MAX_GAPS).max(1);
    let of_frame = |frame: usize| {
        let mut gaps = Vec::new();
        for track in tracks {
            let assignment = frame.checked_sub(track.first.0).and_then(|t| track.detections.get(t));
            let seen: Vec<Vec<KeypointRay>> =
                rays(session, cameras, frame, assignment.map_or(&[], Vec::as_slice)).collect();
            for (i, one) in seen.iter().enumerate() {
                seen[..i].iter().for_each(|other| add_gaps(sigmas_m, one, other, &mut gaps));
            }
        }
        gaps
    };
    let frames: Vec<usize> = frames_with_pairs(session.n_frames, tracks).step_by(stride).collect();
    frames.into_par_iter().flat_map_iter(of_frame).collect()
}

/// Frames in which two views see some person: detectors may run on every second frame only.
fn frames_with_pairs(n_frames: usize, tracks: &[PersonTrack]) -> impl Iterator<Item = usize> {
    let assignment = |track: &PersonTrack, frame: usize| {
        let t = frame.checked_sub(track.first.0)?;
        track.detections.get(t).map(|assignment| n_pairs(assignment))
    };
    (0..n_frames).filter(move |&frame| tracks.iter().any(|track| assignment(track, frame).is_some_and(|n| n > 0)))
}

/// Number of pairs of views that see a person in one frame.
fn n_pairs(assignment: &[Option<usize>]) -> usize {
    let n = assignment.iter().flatten().count();
    n * n.saturating_sub(1) / 2
}

/// A keypoint's ray in the world and its confidence; `None` where it is not detected.
type KeypointRay = Option<(PluckerRay, f64)>;

/// The rays of each view's detection.
fn rays<'a>(
    session: &'a Session,
    cameras: &'a [Option<Rigid>],
    frame: usize,
    assignment: &'a [Option<usize>],
) -> impl Iterator<Item = Vec<KeypointRay>> + 'a {
    let n_keypoints = session.convention.names().len();
    assignment.iter().enumerate().filter_map(move |(v, detection)| {
        let (camera, view) = (cameras[v].as_ref()?, &session.views[v]);
        let seen = NormalizedDetection::from_detection(view, &view.frames[frame][(*detection)?], n_keypoints);
        let keypoints = seen.normalized.iter().zip(&seen.confidence);
        Some(
            keypoints
                .map(|(normalized, c)| (*c > 0.0).then(|| (PluckerRay::through(camera, normalized), *c)))
                .collect(),
        )
    })
}

fn add_gaps(sigmas_m: &[f64], one: &[KeypointRay], other: &[KeypointRay], gaps: &mut Vec<Gap>) {
    for ((one, other), sigma_m) in one.iter().zip(other).zip(sigmas_m) {
        let (Some((first, a)), Some((second, b))) = (one, other) else { continue };
        if first.direction.cross(&second.direction).norm() > MIN_SINE {
            let sigmas = (ray_ray_distance(first, second) / sigma_m) as f32;
            gaps.push(Gap { confidences: [*a as f32, *b as f32], sigmas });
        }
    }
}

/// Confidences divided into groups of equal size.
struct Groups {
    /// Upper bounds of all groups but the last.
    bounds: Vec<f32>,
    means: Vec<f64>,
    sizes: Vec<usize>,
}

impl Groups {
    fn cut(gaps: &[Gap], n_groups: usize) -> Self {
        let mut all: Vec<f32> = gaps.iter().flat_map(|gap| gap.confidences).collect();
        all.par_sort_unstable_by(f32::total_cmp);
        let mut bounds: Vec<f32> = (1..n_groups).map(|i| all[i * all.len() / n_groups]).collect();
        bounds.dedup();
        let mut groups = Self { means: vec![0.0; bounds.len() + 1], sizes: vec![0; bounds.len() + 1], bounds };
        for confidence in all {
            let group = groups.of(confidence);
            groups.means[group] += f64::from(confidence);
            groups.sizes[group] += 1;
        }
        groups.means.iter_mut().zip(&groups.sizes).for_each(|(sum, n)| *sum /= (*n).max(1) as f64);
        groups
    }

    fn of(&self, confidence: f32) -> usize {
        self.bounds.partition_point(|bound| *bound < confidence)
    }
}

/// Iterations of [`variances`]; further ones do not change the digits.
const N_ROUNDS: usize = 200;

/// The variance of each group from the variances of the cells, which are sums of two groups: least squares of relative
/// errors by multiplicative steps, which keep variances positive.
fn variances(groups: &Groups, gaps: Vec<Gap>) -> Vec<f64> {
    let n = groups.means.len();
    let mut cells = vec![Vec::new(); n * n];
    for gap in gaps {
        let [a, b] = gap.confidences.map(|c| groups.of(c));
        cells[a.max(b) * n + a.min(b)].push(f64::from(gap.sigmas));
    }
    let sums: Vec<(usize, usize, f64, f64)> = cells
        .par_iter_mut()
        .enumerate()
        .filter_map(|(i, cell)| {
            let sum = (median(cell)? * NORMAL_SIGMA_OF_MAD).powi(2).max(1e-6);
            Some((i / n, i % n, sum, cell.len() as f64 / (sum * sum)))
        })
        .collect();
    let mut variances = vec![0.5; n];
    for _ in 0..N_ROUNDS {
        let (mut target, mut model) = (vec![0.0; n], vec![1e-12; n]);
        for &(a, b, sum, weight) in &sums {
            for group in [a, b] {
                target[group] += weight * sum;
                model[group] += weight * (variances[a] + variances[b]);
            }
        }
        for (variance, (target, model)) in variances.iter_mut().zip(target.iter().zip(&model)) {
            *variance = (*variance * target / model).max(1e-4);
        }
    }
    variances
}

/// Keypoints of similar confidence.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Group {
    /// Mean confidence.
    confidence: f64,
    ln_factor: f64,
    n: f64,
}

impl Group {
    fn with(self, other: Self) -> Self {
        let n = self.n + other.n;
        let mean = |a: f64, b: f64| (a * self.n + b * other.n) / n;
        let confidence = mean(self.confidence, other.confidence);
        Self { confidence, ln_factor: mean(self.ln_factor, other.ln_factor), n }
    }
}

/// Pools adjacent groups until the error falls as confidence rises.
fn pooled(groups: impl Iterator<Item = Group>) -> Vec<Group> {
    let mut pooled: Vec<Group> = Vec::new();
    for mut group in groups {
        while let Some(before) = pooled.last().filter(|before| before.ln_factor <= group.ln_factor).copied() {
            group = before.with(group);
            pooled.pop();
        }
        pooled.push(group);
    }
    pooled
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::KeypointConvention;
    use crate::session::{FrameIndex, PersonId};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    /// Gaps of keypoints whose errors are `factor(confidence)` times the published ones; one in twenty is an outlier.
    fn simulated(n: usize, confidence: impl Fn(&mut ChaCha8Rng) -> f64, factor: impl Fn(f64) -> f64) -> Vec<Gap> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(0.0, 1.0).unwrap();
        let gap = |_| {
            let confidences = [confidence(&mut rng), confidence(&mut rng)];
            let wrong = if rng.random_bool(0.05) { 20.0 } else { 1.0 };
            let error: f64 = confidences.map(|c| factor(c) * normal.sample(&mut rng)).iter().sum();
            Gap { confidences: confidences.map(|c| c as f32), sigmas: (error * wrong).abs() as f32 }
        };
        (0..n).map(gap).collect()
    }

    /// Half of the outliers lie beyond the median and move it by 5 % at most; medians of 2,000 are known to 3 %.
    #[test]
    fn noise_per_confidence_is_measured_from_pairs_of_views() {
        let truth = |c: f64| 3.0 - 2.6 * c;
        let gaps = simulated(150_000, |rng| rng.random_range(0.2..1.0), truth);
        let noise = DetectorNoise::published(KeypointConvention::Coco17).with_knots(knots(gaps).unwrap());
        for confidence in [0.3, 0.5, 0.7, 0.9] {
            let (found, truth) = (noise.factor(confidence), truth(confidence));
            assert!((found / truth - 1.0).abs() < 0.15, "{confidence}: {found} for {truth}");
        }
    }

    /// Of detections in every second frame none was found where every second frame was looked at.
    #[test]
    fn frames_without_detections_are_not_sampled() {
        let of_frame = |frame: usize| vec![(frame % 2 == 1).then_some(0); 2];
        let detections = (0..20).map(of_frame).collect();
        let track = PersonTrack { person: PersonId(0), first: FrameIndex(10), detections };
        let found: Vec<usize> = frames_with_pairs(40, &[track]).step_by(2).collect();
        assert_eq!(found, [11, 15, 19, 23, 27]);
    }

    #[test]
    fn constant_confidence_gives_one_knot() {
        let found = knots(simulated(20_000, |_| 1.0, |_| 0.7)).unwrap();
        assert_eq!(found.len(), 1);
        assert!((found[0][1].exp() / 0.7 - 1.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn too_few_pairs_give_no_measurement() {
        assert_eq!(knots(simulated(300, |rng| rng.random_range(0.2..1.0), |_| 1.0)), None);
    }

    #[test]
    fn noise_never_rises_with_confidence() {
        let group = |confidence, ln_factor| Group { confidence, ln_factor, n: 1.0 };
        let raw = [group(0.2, 1.0), group(0.4, 0.2), group(0.6, 0.6), group(0.8, -0.5)];
        let found = pooled(raw.into_iter());
        assert_eq!(found.len(), 3);
        assert!((found[1].confidence - 0.5).abs() < 1e-12 && (found[1].ln_factor - 0.4).abs() < 1e-12);
    }

    #[test]
    fn factor_of_perfect_detections_is_bounded() {
        let found = knots(simulated(20_000, |rng| rng.random_range(0.2..1.0), |_| 0.0)).unwrap();
        assert!(found.iter().all(|[_, ln]| (ln.exp() - MIN_FACTOR).abs() < 1e-9), "{found:?}");
    }
}
