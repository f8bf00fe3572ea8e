//! Hypotheses of the relative pose of two cameras, each fitted to whole tracklets and scored on sampled frames of both views.

use super::normalized::NormalizedView;
use super::pair_score::{MatchedPair, PairObservations, PairScore, VOTE_RADIUS, score_pair, vote};
use super::point_pairs::PointPairs;
use super::tracklets::{Tracklet, longest};
use crate::body::detector_profile::DETECTOR;
use crate::estimation::essential::{EssentialEstimate, refine_essential};
use crate::geometry::epipolar::essential_from_pose;
use crate::geometry::{Rigid, rotation};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Data and numbers of hypotheses.
#[derive(Debug, Clone)]
pub struct HypothesisConfig {
    /// Number of longest tracklets per view that are paired; 7 bound the cost to 49 fits per pair of views.
    pub n_tracklets: usize,
    /// Fewest frames that two tracklets must share: 5 are a sixth of a second at 30 fps.
    pub min_overlap: usize,
    /// Most frames used of an overlap, evenly spread.
    pub max_frames: usize,
    /// Most point pairs of one robust fit, drawn at random: bounds the cost of a fit.
    pub max_points: usize,
    /// Epipolar tolerance of the fit, rad: 6 px at a focal length of 1,060 px. It grows with the errors on people nearer than 4 m.
    pub tolerance: f64,
    /// Minimal samples of a rough fit, and of a thorough one.
    pub iterations: [usize; 2],
    /// Number of pairs of tracklets with most support in rough fits, which are fitted thoroughly.
    pub n_singles: usize,
    /// Number of rough two-person fits, on the best pairs of tracklet pairs, and of those among them that are fitted thoroughly.
    pub n_unions: [usize; 2],
    /// Number of hypotheses that are re-fitted on all detections that match under them.
    pub n_refits: usize,
    /// Most point pairs of one re-fit, evenly spread over the frames: four times those of a fit.
    pub max_refit_points: usize,
    /// Number of hypotheses kept for a pair of views.
    pub n_kept: usize,
}

impl Default for HypothesisConfig {
    fn default() -> Self {
        Self {
            n_tracklets: 7,
            min_overlap: 5,
            max_frames: 60,
            max_points: 150,
            tolerance: 0.0057,
            // Thorough fits to all 49 pairs and 24 unions found the same cameras in three times the time on 40 random captures.
            iterations: [25, 150],
            n_singles: 10,
            n_unions: [24, 6],
            n_refits: 14,
            max_refit_points: 600,
            n_kept: 6,
        }
    }
}

/// A relative pose with its score; the translation is in metres, as far as the lengths of bones determine them.
#[derive(Debug, Clone)]
pub struct PairHypothesis {
    /// From the first camera of the pair to the second.
    pub second_from_first: Rigid,
    /// Score of the pose.
    pub score: PairScore,
}

/// A camera pair with its tracklets.
pub struct CameraPair<'a> {
    /// Detections of the first and the second camera.
    pub views: [&'a NormalizedView; 2],
    /// Their tracklets.
    pub tracklets: [&'a [Tracklet]; 2],
    /// Detections on which every hypothesis is scored.
    pub observations: PairObservations<'a>,
}

/// Fewest point pairs of a re-fit: four times the five of a minimal sample.
const MIN_REFIT_POINTS: usize = 20;

/// Proposes relative poses of a camera pair, best first.
pub fn pair_hypotheses(pair: &CameraPair, seed: u64, config: &HypothesisConfig) -> Vec<PairHypothesis> {
    let singles = single_fits(pair, seed, config);
    let unions = union_fits(&singles, seed, config);
    let fits = singles.iter().chain(&unions);
    let mut hypotheses: Vec<PairHypothesis> = fits.map(|fit| scored(pair, fit.fit.second_from_first)).collect();
    sort_best_first(&mut hypotheses);
    hypotheses.truncate(config.n_refits);
    let mut refitted: Vec<PairHypothesis> = hypotheses.iter().map(|h| refit(pair, h, config)).collect();
    refitted.extend(hypotheses);
    best_of(refitted, config.n_kept)
}

/// The best `n` that differ, best first.
pub fn best_of(mut hypotheses: Vec<PairHypothesis>, n: usize) -> Vec<PairHypothesis> {
    sort_best_first(&mut hypotheses);
    distinct(hypotheses, n)
}

/// A robust fit to the points of one or two pairs of tracklets.
struct TrackletFit {
    /// The tracklets of each pair.
    pairs: Vec<[usize; 2]>,
    points: PointPairs,
    seed: u64,
    fit: EssentialEstimate,
}

impl TrackletFit {
    /// From few samples; `None` where no pose has any support.
    fn rough(pairs: Vec<[usize; 2]>, points: PointPairs, seed: u64, config: &HypothesisConfig) -> Option<Self> {
        let fit = points.fit(config.tolerance, config.iterations[0], seed)?;
        Some(Self { pairs, points, seed, fit })
    }

    fn is_disjoint(&self, other: &Self) -> bool {
        (0..2).all(|side| self.pairs.iter().all(|own| other.pairs.iter().all(|o| o[side] != own[side])))
    }
}

/// The `n` fits with most support, each from all of its samples. Most pairs of tracklets are of two persons, which few samples show.
fn most_supported(mut fits: Vec<TrackletFit>, n: usize, config: &HypothesisConfig) -> Vec<TrackletFit> {
    sort_most_supported(&mut fits);
    fits.truncate(n);
    for TrackletFit { points, seed, fit, .. } in &mut fits {
        let thorough = points.fit(config.tolerance, config.iterations[1], *seed);
        *fit = thorough.filter(|thorough| thorough.support > fit.support).unwrap_or(*fit);
    }
    sort_most_supported(&mut fits);
    fits
}

fn sort_most_supported(fits: &mut [TrackletFit]) {
    fits.sort_by(|x, y| y.fit.support.total_cmp(&x.fit.support).then_with(|| x.pairs.cmp(&y.pairs)));
}

/// Fits to pairs of long tracklets that overlap.
fn single_fits(pair: &CameraPair, seed: u64, config: &HypothesisConfig) -> Vec<TrackletFit> {
    let mut fits = Vec::new();
    let longest = [0, 1].map(|side| longest(pair.tracklets[side], config.n_tracklets));
    for &a in &longest[0] {
        for &b in &longest[1] {
            let item_seed = mix(seed, (a as u64) << 32 | b as u64);
            let points = point_pairs(pair, a, b, item_seed, config);
            fits.extend(TrackletFit::rough(vec![[a, b]], points, item_seed, config));
        }
    }
    most_supported(fits, config.n_singles, config)
}

/// Fits to the union of two tracklet pairs: a single person determines the pose only weakly.
fn union_fits(singles: &[TrackletFit], seed: u64, config: &HypothesisConfig) -> Vec<TrackletFit> {
    let mut unions: Vec<(f64, usize, usize)> = Vec::new();
    for i in 0..singles.len() {
        for j in (0..i).filter(|&j| singles[i].is_disjoint(&singles[j])) {
            unions.push((singles[i].fit.support.min(singles[j].fit.support), i, j));
        }
    }
    unions.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    unions.truncate(config.n_unions[0]);
    let rough = |(_, i, j): (f64, usize, usize)| {
        let (one, other) = (&singles[i], &singles[j]);
        let points = one.points.joined(&other.points);
        let pairs = one.pairs.iter().chain(&other.pairs).copied().collect();
        TrackletFit::rough(pairs, points, mix(seed, 1 << 63 | (i as u64) << 32 | j as u64), config)
    };
    most_supported(unions.into_iter().filter_map(rough).collect(), config.n_unions[1], config)
}

/// Confident point pairs from well-spread frames of the overlap of two tracklets.
fn point_pairs(pair: &CameraPair, a: usize, b: usize, seed: u64, config: &HypothesisConfig) -> PointPairs {
    let (first, second) = (&pair.tracklets[0][a], &pair.tracklets[1][b]);
    let shared = first.shared_with(second);
    if shared.len() < config.min_overlap {
        return PointPairs::default();
    }
    let n_frames = shared.len().min(config.max_frames);
    let mut points = PointPairs::default();
    for i in 0..n_frames {
        let (frame, p, q) = shared[i * shared.len() / n_frames];
        points.add(&pair.views[0].frames[frame][p], &pair.views[1].frames[frame][q], DETECTOR.confident);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    points.reduced(|pairs| {
        for i in 0..pairs.len().min(config.max_points) {
            let j = rng.random_range(i..pairs.len());
            pairs.swap(i, j);
        }
        pairs.truncate(config.max_points);
    })
}

/// Scores a pose and scales its translation to metres by the lengths of bones.
fn scored(pair: &CameraPair, second_from_first: Rigid) -> PairHypothesis {
    let score = score_pair(&pair.observations, &second_from_first);
    let metres = score.log_metres.exp();
    let metric = Rigid { translation: second_from_first.translation * metres, ..second_from_first };
    PairHypothesis { second_from_first: metric, score: PairScore { log_metres: 0.0, ..score } }
}

/// Re-fits a hypothesis, twice, on all points of all detections that match under it.
fn refit(pair: &CameraPair, hypothesis: &PairHypothesis, config: &HypothesisConfig) -> PairHypothesis {
    let mut pose = hypothesis.second_from_first;
    for radius in [VOTE_RADIUS, config.tolerance] {
        let (matches, _) = vote(&pair.observations, &essential_from_pose(&pose));
        let points = evenly_spread(matched_points(&matches), config.max_refit_points);
        if points.pairs.len() < MIN_REFIT_POINTS {
            break;
        }
        let unit = Rigid { translation: pose.translation.normalize(), ..pose };
        pose = refine_essential(&unit, &points.pairs, None, radius * points.mean_error_scale(), 10);
    }
    scored(pair, pose)
}

fn matched_points(matches: &[MatchedPair]) -> PointPairs {
    let mut points = PointPairs::default();
    matches.iter().for_each(|m| points.add(m.first, m.second, DETECTOR.judged));
    points
}

/// At most `n` of some pairs.
fn evenly_spread(points: PointPairs, n: usize) -> PointPairs {
    let stride = points.pairs.len().div_ceil(n).max(1);
    points.reduced(|pairs| *pairs = pairs.iter().copied().step_by(stride).collect())
}

fn sort_best_first(hypotheses: &mut [PairHypothesis]) {
    hypotheses.sort_by(|a, b| b.score.quality.total_cmp(&a.score.quality));
}

/// The best hypotheses that differ by more than [`SAME_POSE_DEG`].
fn distinct(ordered: Vec<PairHypothesis>, n: usize) -> Vec<PairHypothesis> {
    let mut kept: Vec<PairHypothesis> = Vec::new();
    for h in ordered {
        let same = |k: &PairHypothesis| is_same_pose(&k.second_from_first, &h.second_from_first, SAME_POSE_DEG);
        if kept.len() < n && h.score.quality > 0.0 && !kept.iter().any(same) {
            kept.push(h);
        }
    }
    kept
}

/// Noise of hypotheses, degrees: of the rotation, and of the direction of the baseline.
pub(super) const SAME_POSE_DEG: [f64; 2] = [6.0, 15.0];

/// Whether two relative poses differ by less than these angles in rotation and in the direction of the baseline.
pub(super) fn is_same_pose(one: &Rigid, other: &Rigid, [rotation_deg, baseline_deg]: [f64; 2]) -> bool {
    rotation::angle_between(&one.rotation, &other.rotation) < rotation_deg.to_radians()
        && one.translation.angle(&other.translation) < baseline_deg.to_radians()
}

/// Combines two seeds into one: the finaliser of SplitMix64.
pub fn mix(seed: u64, item: u64) -> u64 {
    let mut x = seed ^ item.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
