//! Metric scale from people: what their limb bones measure against what adults' limbs measure.
//!
//! Trunk, shoulder and hip widths are left out: the trunk bends, and detectors place hips and shoulders by the skin.
//! The reference lengths are the default body's at beta 0 (ANSUR II and de Leva, see [`mod@super::default_body`]), men and
//! women half and half. How a detector's joints lie against these is known badly (knee and hip 30 to 50 mm off, ankle
//! 1 to 15 mm, of varying direction: Needham et al. 2021, Sci. Rep. 11:20673): no correction is made, the doubt is in
//! the interval.

use super::model::{Betas, BodyModel};
use super::skeleton::{JOINT_NAMES, KeypointConvention};
use crate::optim::robust::median;
use nalgebra::{DMatrix, DVector, Vector3};

/// A limb bone, left and right taken together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LimbBone {
    /// Hip to knee.
    Thigh,
    /// Knee to ankle.
    Shank,
    /// Shoulder to elbow.
    UpperArm,
    /// Elbow to wrist.
    Forearm,
}

impl LimbBone {
    /// All four.
    pub const ALL: [Self; 4] = [Self::Thigh, Self::Shank, Self::UpperArm, Self::Forearm];

    /// Keypoints (and joints) at its ends, without the side.
    pub fn ends(self) -> [&'static str; 2] {
        match self {
            Self::Thigh => ["hip", "knee"],
            Self::Shank => ["knee", "ankle"],
            Self::UpperArm => ["shoulder", "elbow"],
            Self::Forearm => ["elbow", "wrist"],
        }
    }

    /// Standard deviation of the log ratio between a detector's length and the anatomical one: 16 mm of thigh, 10 mm of
    /// shank and upper arm, 8 mm of forearm (displacements along the bone; those across it hardly change its length).
    fn detector_bias(self) -> f64 {
        match self {
            Self::Thigh => 0.04,
            Self::Shank => 0.025,
            Self::UpperArm => 0.04,
            Self::Forearm => 0.03,
        }
    }
}

/// Part of the detector's bias that all bones share, as a log ratio.
const COMMON_BIAS: f64 = 0.01;

/// A bone's length in the cameras' own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredBone {
    /// Which.
    pub bone: LimbBone,
    /// Median over frames and both sides, own unit.
    pub length: f64,
    /// Standard error of the length's logarithm.
    pub sigma_log: f64,
    /// Lengths behind the median.
    pub n_samples: usize,
}

/// Robust lengths of a person's limb bones from triangulated keypoints (`points[frame][keypoint]`, any unit).
///
/// Median over frames and sides; the standard error is that of the median under noise of the observed median absolute
/// deviation, with one independent sample in ten (a detector's error drifts). Bones seen fewer than five times are left out.
pub fn measured_limbs(points: &[Vec<Option<Vector3<f64>>>], convention: KeypointConvention) -> Vec<MeasuredBone> {
    let measured = |bone: LimbBone| {
        let mut lengths: Vec<f64> = Vec::new();
        for side in ["left", "right"] {
            let [a, b] = bone.ends().map(|end| convention.index_of(&format!("{side}_{end}")));
            let (Some(a), Some(b)) = (a, b) else { continue };
            let both = |row: &Vec<Option<Vector3<f64>>>| Some(((*row.get(a)?)? - (*row.get(b)?)?).norm());
            lengths.extend(points.iter().filter_map(both).filter(|l| l.is_finite() && *l > 0.0));
        }
        let n_samples = lengths.len();
        if n_samples < 5 {
            return None;
        }
        let length = median(&mut lengths)?;
        let mut deviations: Vec<f64> = lengths.iter().map(|l| (l / length).ln().abs()).collect();
        let spread = 1.4826 * median(&mut deviations)?;
        let sigma_log = 1.2533 * spread / (n_samples as f64 / 10.0).max(1.0).sqrt();
        Some(MeasuredBone { bone, length, sigma_log, n_samples })
    };
    LimbBone::ALL.into_iter().filter_map(measured).collect()
}

/// The factor from the cameras' own unit to metres.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaleEstimate {
    /// Metres per unit.
    pub scale: f64,
    /// Where the true factor lies with 95 % certainty, for adults.
    pub interval95: [f64; 2],
    /// What it rests on, one sentence.
    pub evidence: String,
}

/// Estimates the metric scale from the limbs of one or more people; `None` without any measured bone.
///
/// Generalised least squares of `y = s + e` over all people's bones, `y = log(reference / measured)`. The covariance of
/// `e` has the differences between adults (from the model's betas, which are independent between people: stature and
/// proportions), the detector's bias (the same for all people), and the measurement. So a person seen well counts more,
/// several people narrow the interval down to the detector's bias and not below. People who fit the others badly (a
/// child, a double) are loosened by Huber's weight at 2 standard deviations.
pub fn scale_from_people(model: &BodyModel, people: &[Vec<MeasuredBone>]) -> Option<ScaleEstimate> {
    let limbs: Vec<Limb> = LimbBone::ALL.into_iter().map(|bone| reference_limb(model, bone)).collect();
    let rows: Vec<(usize, &MeasuredBone)> =
        people.iter().enumerate().flat_map(|(p, bones)| bones.iter().map(move |b| (p, b))).collect();
    if rows.is_empty() {
        return None;
    }
    let ratios =
        DVector::from_iterator(rows.len(), rows.iter().map(|(_, b)| (limbs[b.bone as usize].length / b.length).ln()));
    let mut looseness = vec![1.0; people.len()];
    let mut mean = solve_mean(&ratios, &covariance(&rows, &limbs, &looseness))?;
    for _ in 0..ROBUST_ROUNDS {
        for (p, looseness) in looseness.iter_mut().enumerate() {
            let own: Vec<usize> = (0..rows.len()).filter(|&i| rows[i].0 == p).collect();
            let own_rows: Vec<(usize, &MeasuredBone)> = own.iter().map(|&i| rows[i]).collect();
            let own_ratios = DVector::from_iterator(own.len(), own.iter().map(|&i| ratios[i]));
            let alone = covariance(&own_rows, &limbs, &vec![1.0; people.len()]);
            let Some(person) = solve_mean(&own_ratios, &alone) else { continue };
            let distance = (person.value - mean.value).abs() / person.variance.sqrt();
            *looseness = (distance / 2.0).max(1.0);
        }
        mean = solve_mean(&ratios, &covariance(&rows, &limbs, &looseness))?;
    }
    let half = 1.96 * mean.variance.sqrt();
    let n_seen = people.iter().filter(|bones| !bones.is_empty()).count();
    let n_samples: usize = rows.iter().map(|(_, b)| b.n_samples).sum();
    let who = if n_seen == 1 { "1 person" } else { &format!("{n_seen} people") };
    Some(ScaleEstimate {
        scale: mean.value.exp(),
        interval95: [(mean.value - half).exp(), (mean.value + half).exp()],
        evidence: format!(
            "limb bones of {who} ({n_samples} lengths) against those of adults; between adults and by the detector's \
             habits the scale is uncertain to {:.1} %",
            100.0 * half
        ),
    })
}

/// Re-weightings of people; Huber's weights settle in a few.
const ROBUST_ROUNDS: usize = 5;

/// A limb bone of the mean body.
struct Limb {
    /// m.
    length: f64,
    /// Change of the length's logarithm per beta.
    log_per_beta: Betas,
}

fn reference_limb(model: &BodyModel, bone: LimbBone) -> Limb {
    let [a, b] = bone.ends().map(|end| {
        let is_end = |name: &&str| name.strip_prefix("left_") == Some(end);
        JOINT_NAMES.iter().position(is_end).expect("limb ends are named as joints of the skeleton")
    });
    let between = model.rest_joints[b] - model.rest_joints[a];
    let length = between.norm();
    let directions = model.shape_directions[b] - model.shape_directions[a];
    Limb { length, log_per_beta: directions.tr_mul(&between) / (length * length) }
}

fn covariance(rows: &[(usize, &MeasuredBone)], limbs: &[Limb], looseness: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
        let ((p, a), (q, b)) = (rows[i], rows[j]);
        let mut value = COMMON_BIAS * COMMON_BIAS;
        if a.bone == b.bone {
            value += a.bone.detector_bias().powi(2);
        }
        if p == q {
            value += limbs[a.bone as usize].log_per_beta.dot(&limbs[b.bone as usize].log_per_beta) * looseness[p];
        }
        if i == j {
            // 0.2 % keeps the matrix regular also for exact lengths.
            value += a.sigma_log.powi(2) + 0.002 * 0.002;
        }
        value
    })
}

/// A mean and its variance.
struct Mean {
    value: f64,
    variance: f64,
}

/// `s = 1^T C^-1 y / 1^T C^-1 1`, variance `1 / 1^T C^-1 1`.
fn solve_mean(values: &DVector<f64>, covariance: &DMatrix<f64>) -> Option<Mean> {
    let weights = covariance.clone().cholesky()?.solve(&DVector::repeat(values.len(), 1.0));
    let total = weights.sum();
    let value = weights.dot(values) / total;
    (value.is_finite() && total > 0.0).then_some(Mean { value, variance: 1.0 / total })
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// People drawn from the population, seen by a detector drawn from its biases, in units of 1 / `scale` m.
    fn people(n_people: usize, scale: f64, seed: u64) -> Vec<Vec<MeasuredBone>> {
        let model = default_body();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let common = COMMON_BIAS * normal();
        let biases = LimbBone::ALL.map(|bone| common + bone.detector_bias() * normal());
        (0..n_people)
            .map(|_| {
                let betas = Betas::from_fn(|_, _| normal());
                let measured = |bone: LimbBone| {
                    let limb = reference_limb(&model, bone);
                    let log = limb.log_per_beta.dot(&betas) + biases[bone as usize];
                    MeasuredBone { bone, length: limb.length * log.exp() / scale, sigma_log: 0.003, n_samples: 500 }
                };
                LimbBone::ALL.map(measured).to_vec()
            })
            .collect()
    }

    /// 95 % of 400 draws have a binomial standard deviation of 1.1 %.
    #[test]
    fn the_interval_covers_the_truth_as_often_as_it_says() {
        for n_people in [1, 2, 4] {
            let mut covered = 0;
            let mut squares = 0.0;
            for seed in 0..400 {
                let estimate = scale_from_people(&default_body(), &people(n_people, 2.5, seed)).unwrap();
                covered += usize::from(estimate.interval95[0] < 2.5 && 2.5 < estimate.interval95[1]);
                squares += (estimate.scale / 2.5).ln().powi(2);
            }
            let sd = (squares / 400.0_f64).sqrt();
            println!("{n_people} people: sd {:.2} %, covered {:.3}", sd * 100.0, covered as f64 / 400.0);
            assert!((0.91..=0.98).contains(&(covered as f64 / 400.0)));
            assert!((0.025..0.065).contains(&sd));
        }
    }

    #[test]
    fn a_child_among_adults_moves_the_scale_little() {
        let adults = people(4, 1.0, 3);
        let alone = scale_from_people(&default_body(), &adults).unwrap();
        let mut with_child = adults.clone();
        with_child.push(adults[0].iter().map(|b| MeasuredBone { length: 0.6 * b.length, ..*b }).collect());
        let both = scale_from_people(&default_body(), &with_child).unwrap();
        assert!((both.scale / alone.scale).ln().abs() < 0.05, "{} and {}", alone.scale, both.scale);
    }

    #[test]
    fn bones_are_measured_in_the_middle_of_noise_and_holes() {
        let convention = KeypointConvention::Coco17;
        let at = |name: &str| convention.index_of(name).unwrap();
        let mut points = vec![vec![None; 17]; 40];
        for (t, row) in points.iter_mut().enumerate().filter(|(t, _)| t % 3 != 0) {
            row[at("left_hip")] = Some(Vector3::zeros());
            let length = if t % 7 == 0 { 9.0 } else { 2.0 + 0.01 * (t % 5) as f64 };
            row[at("left_knee")] = Some(Vector3::new(0.0, -length, 0.0));
        }
        let bones = measured_limbs(&points, convention);
        assert_eq!((bones.len(), bones[0].bone), (1, LimbBone::Thigh));
        assert!((bones[0].length - 2.02).abs() < 0.021);
        assert!(scale_from_people(&default_body(), &[Vec::new()]).is_none());
        assert!(scale_from_people(&default_body(), &[Vec::new(), bones]).is_some());
    }
}
