//! Body segments that indicate a person's size, and their measurement on triangulated keypoints.

use super::skeleton::KeypointConvention;
use crate::optim::robust::{NORMAL_SIGMA_OF_MAD, median, quantile};
use nalgebra::Vector3;

const SIDES: [&str; 2] = ["left", "right"];

/// A part of the body between two joints, or pairs of joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Segment {
    /// Hip to knee.
    Thigh,
    /// Knee to ankle.
    Shank,
    /// Shoulder to elbow.
    UpperArm,
    /// Elbow to wrist.
    Forearm,
    /// Middle of the hips to middle of the shoulders, back straight.
    Trunk,
    /// Middle of the shoulders to middle of the ears, neck straight.
    Head,
}

impl Segment {
    /// All segments.
    pub const ALL: [Self; 6] = [Self::Thigh, Self::Shank, Self::UpperArm, Self::Forearm, Self::Trunk, Self::Head];

    /// Keypoints at its ends, without the side.
    pub fn ends(self) -> [&'static str; 2] {
        match self {
            Self::Thigh => ["hip", "knee"],
            Self::Shank => ["knee", "ankle"],
            Self::UpperArm => ["shoulder", "elbow"],
            Self::Forearm => ["elbow", "wrist"],
            Self::Trunk => ["hip", "shoulder"],
            Self::Head => ["shoulder", "ear"],
        }
    }

    /// Standard deviation of the log ratio between a detector's length and the anatomical one: 16 mm of thigh, 10 mm of
    /// shank and upper arm, 8 mm of forearm (displacements along the bone; those across it hardly change its length),
    /// 28 mm of trunk (hips and shoulders, and a back that is never quite straight), 17 mm of neck and head (shoulders, and
    /// what a detector takes for the ear).
    pub fn detector_bias(self) -> f64 {
        match self {
            Self::Thigh => 0.04,
            Self::Shank => 0.025,
            Self::UpperArm => 0.04,
            Self::Forearm => 0.03,
            Self::Trunk => 0.06,
            Self::Head => 0.08,
        }
    }

    /// The vectors along this segment, of both sides or of the midline; `point` returns the ends by name.
    pub fn along(self, point: impl Fn(&str) -> Option<Vector3<f64>>) -> Vec<Vector3<f64>> {
        let [left, right] = SIDES.map(|side| {
            let [a, b] = self.ends().map(|end| point(&format!("{side}_{end}")));
            Some(b? - a?)
        });
        self.of_sides(left, right)
    }

    /// The vectors along this segment from those of both sides.
    fn of_sides(self, left: Option<Vector3<f64>>, right: Option<Vector3<f64>>) -> Vec<Vector3<f64>> {
        match (self.bends(), left, right) {
            (true, Some(left), Some(right)) => vec![(left + right) / 2.0],
            (true, ..) => Vec::new(),
            (false, left, right) => left.into_iter().chain(right).collect(),
        }
    }

    /// Whether it lies on the midline and bends; limb segments are rigid.
    fn bends(self) -> bool {
        matches!(self, Self::Trunk | Self::Head)
    }

    /// The quantile of the lengths over time that is its true length: segments that bend are longest when straight.
    fn quantile(self) -> f64 {
        if self.bends() { 0.9 } else { 0.5 }
    }
}

/// A segment's measured length in the cameras' unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredSegment {
    /// The segment.
    pub segment: Segment,
    /// Median over frames and both sides (of trunk and head the ninth decile), the cameras' unit.
    pub length: f64,
    /// Standard error of the length's logarithm.
    pub sigma_log: f64,
    /// Number of lengths behind it.
    pub n_samples: usize,
}

/// Ninth decile of the normal distribution, standard deviations.
const NINTH_DECILE: f64 = 1.2816;

/// Robust lengths of a person's segments from triangulated keypoints (`points[frame][keypoint]`, any unit).
///
/// The standard error is that of the median under noise of the observed median absolute deviation, with one independent
/// sample in ten (a detector's error drifts). For segments that bend, the ninth decile is exact if lengths differ by bending
/// alone, and 1.28 deviations too long if they differ by noise alone: half of that is subtracted and added to the error.
/// Segments with fewer than five lengths are left out.
pub fn measured_segments(points: &[Vec<Option<Vector3<f64>>>], convention: KeypointConvention) -> Vec<MeasuredSegment> {
    let measured = |segment: Segment| {
        let keypoints = SIDES.map(|side| segment.ends().map(|end| convention.index_of(&format!("{side}_{end}"))));
        let length_in = |row: &Vec<Option<Vector3<f64>>>| {
            let [left, right] = keypoints.map(|ends| {
                let [a, b] = ends.map(|keypoint| row.get(keypoint?).copied().flatten());
                Some(b? - a?)
            });
            segment.of_sides(left, right).into_iter().map(|v| v.norm())
        };
        let mut lengths: Vec<f64> = points.iter().flat_map(length_in).filter(|l| l.is_finite() && *l > 0.0).collect();
        let n_samples = lengths.len();
        if n_samples < 5 {
            return None;
        }
        let length = quantile(&mut lengths, segment.quantile())?;
        let middle = median(&mut lengths)?;
        let mut deviations: Vec<f64> = lengths.iter().map(|l| (l / middle).ln().abs()).collect();
        let spread = NORMAL_SIGMA_OF_MAD * median(&mut deviations)?;
        let too_long = if segment.bends() { 0.5 * NINTH_DECILE * spread } else { 0.0 };
        let sigma_log = (1.2533 * spread / (n_samples as f64 / 10.0).max(1.0).sqrt()).hypot(too_long);
        Some(MeasuredSegment { segment, length: length * (-too_long).exp(), sigma_log, n_samples })
    };
    Segment::ALL.into_iter().filter_map(measured).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn measures_bones_despite_outliers_and_gaps() {
        let convention = KeypointConvention::Coco17;
        let at = |name: &str| convention.index_of(name).unwrap();
        let mut points = vec![vec![None; 17]; 40];
        for (t, row) in points.iter_mut().enumerate().filter(|(t, _)| t % 3 != 0) {
            row[at("left_hip")] = Some(Vector3::zeros());
            let length = if t % 7 == 0 { 9.0 } else { 2.0 + 0.01 * (t % 5) as f64 };
            row[at("left_knee")] = Some(Vector3::new(0.0, -length, 0.0));
        }
        let segments = measured_segments(&points, convention);
        assert_eq!((segments.len(), segments[0].segment), (1, Segment::Thigh));
        assert!((segments[0].length - 2.02).abs() < 0.021);
    }

    /// 5 % of noise on a straight back: the ninth decile alone is 6.6 % too long.
    #[test]
    fn noise_lengthens_a_straight_back_by_half_its_decile() {
        let convention = KeypointConvention::Coco17;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut row = |_| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            let height = 0.5 * (0.05 * noise).exp();
            let mut row = vec![None; 17];
            for (name, x, y) in [("hip", 0.1, 0.0), ("shoulder", 0.2, height)] {
                row[convention.index_of(&format!("left_{name}")).unwrap()] = Some(Vector3::new(x, y, 0.0));
                row[convention.index_of(&format!("right_{name}")).unwrap()] = Some(Vector3::new(-x, y, 0.0));
            }
            row
        };
        let points: Vec<_> = (0..2000).map(&mut row).collect();
        let trunk = measured_segments(&points, convention)[0];
        let error = (trunk.length / 0.5).ln();
        assert!((0.02..0.045).contains(&error) && error < 1.3 * trunk.sigma_log, "{error} {}", trunk.sigma_log);
    }

    #[test]
    fn a_bending_back_has_its_straight_length() {
        let convention = KeypointConvention::Coco17;
        let row = |t: usize| {
            let mut row = vec![None; 17];
            let height = if t.is_multiple_of(5) { 0.5 } else { 0.4 };
            for (name, place) in [("hip", 0.0), ("shoulder", height)] {
                for (side, x) in [("left", 0.15), ("right", -0.15)] {
                    row[convention.index_of(&format!("{side}_{name}")).unwrap()] = Some(Vector3::new(x, place, 0.0));
                }
            }
            row
        };
        let segments = measured_segments(&(0..50).map(row).collect::<Vec<_>>(), convention);
        assert_eq!((segments.len(), segments[0].segment), (1, Segment::Trunk));
        assert!((segments[0].length - 0.5).abs() < 1e-12);
    }
}
