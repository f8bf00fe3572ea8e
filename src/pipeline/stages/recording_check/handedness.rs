//! Handedness of people in space: noses, toes and knees point to where the left side, the right side and the trunk say is forward.
//!
//! Mirrored images, and exchanged labels of left and right, agree between cameras perfectly; only people look or bend
//! backwards then.

use crate::body::skeleton::KeypointConvention;
use crate::session::JointTrajectory;
use crate::session::recording::{Keypoint, View};
use nalgebra::Vector3;

/// What people show of the handedness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Handedness {
    /// Number of independent signs: features of one person that are clear in one second.
    pub n: usize,
    /// Share of them that point backwards, 0 to 1.
    pub backwards: f64,
}

/// Smallest distance in front of or behind the rest of the body that is a sign, m: above a detector's noise of a point.
/// Noses are 0.1 m before the ears, toes 0.15 m before the ankles, knees 0.05 to 0.3 m before a bent leg's straight line.
const MIN_DEPTH_M: f64 = 0.04;

/// A sign must be the same in this share of a second's frames.
const CLEAR: f64 = 0.7;
/// Frames with the feature in a second, as a share.
const MIN_FRAMES: f64 = 0.3;

/// Signs from which the handedness is known, and the share of backward ones that gives a mirrored world: a detector that takes a
/// person's back for the front in one second of ten makes a tenth of them wrong.
pub const MIN_SIGNS: usize = 8;
/// See [`MIN_SIGNS`].
pub const MIRRORED: f64 = 0.75;

/// Keypoints of the features.
struct Features {
    shoulders: [usize; 2],
    hips: [usize; 2],
    /// A point, and the two whose mean it lies in front of.
    in_front: Vec<(usize, [usize; 2])>,
}

impl Features {
    fn of(convention: KeypointConvention) -> Option<Self> {
        let at = |name: &str| convention.index_of(name);
        let pair = |part: &str| convention.sides_of(part);
        let mut in_front = Vec::new();
        in_front.extend(at("nose").zip(pair("ear")));
        for side in ["left", "right"] {
            let of_side = |part: &str| at(&format!("{side}_{part}"));
            in_front.extend(of_side("big_toe").zip(of_side("ankle")).map(|(toe, ankle)| (toe, [ankle, ankle])));
            let leg = of_side("hip").zip(of_side("ankle"));
            in_front.extend(of_side("knee").zip(leg).map(|(knee, (hip, ankle))| (knee, [hip, ankle])));
        }
        Some(Self { shoulders: pair("shoulder")?, hips: pair("hip")?, in_front })
    }

    /// For each feature whether it points forward (1), backwards (-1), or is not clear (0).
    fn signs(&self, points: &[Option<Vector3<f64>>]) -> Option<Vec<i32>> {
        let at = |k: usize| points.get(k).copied().flatten();
        let both = |[a, b]: [usize; 2]| Some((at(a)?, at(b)?));
        let ((ls, rs), (lh, rh)) = (both(self.shoulders)?, both(self.hips)?);
        let (to_left, up) = (ls - rs + (lh - rh), ls + rs - (lh + rh));
        let forward = to_left.cross(&up).try_normalize(1e-6)?;
        let sign = |&(point, behind): &(usize, [usize; 2])| {
            let depth = at(point).zip(both(behind)).map(|(p, (a, b))| (p - 0.5 * (a + b)).dot(&forward));
            depth.filter(|depth| depth.abs() > MIN_DEPTH_M).map_or(0, |depth| depth.signum() as i32)
        };
        Some(self.in_front.iter().map(sign).collect())
    }
}

/// The handedness of people; `None` where the convention lacks shoulders or hips.
pub fn handedness(convention: KeypointConvention, people: &[JointTrajectory], fps: f64) -> Option<Handedness> {
    let features = Features::of(convention)?;
    let second = (fps.round() as usize).max(1);
    let (mut n, mut n_backwards) = (0, 0);
    for block in people.iter().flat_map(|person| person.points.chunks(second)) {
        let signs: Vec<Vec<i32>> = block.iter().filter_map(|points| features.signs(points)).collect();
        for k in 0..features.in_front.len() {
            let count = |sign: i32| signs.iter().filter(|signs| signs[k] == sign).count();
            let (forward, backwards) = (count(1), count(-1));
            let all = forward + backwards;
            let is_clear = forward.max(backwards) as f64 >= CLEAR * all as f64;
            if is_clear && all as f64 >= MIN_FRAMES * second as f64 {
                n += 1;
                n_backwards += usize::from(backwards > forward);
            }
        }
    }
    Some(Handedness { n, backwards: n_backwards as f64 / n.max(1) as f64 })
}

impl Handedness {
    /// Whether the world is mirrored.
    pub fn is_mirrored(&self) -> bool {
        self.n >= MIN_SIGNS && self.backwards > MIRRORED
    }
}

/// Share of a camera's people who are upside down in its image; `None` where shoulders and hips are not seen.
pub fn upside_down(convention: KeypointConvention, view: &View) -> Option<f64> {
    let (shoulders, hips) = (convention.sides_of("shoulder")?, convention.sides_of("hip")?);
    let height = |keypoints: &[Keypoint], [a, b]: [usize; 2]| {
        let both = [keypoints.get(a)?, keypoints.get(b)?];
        both.iter().all(|k| k.is_present()).then(|| both[0].pixel.y + both[1].pixel.y)
    };
    let of_person = |keypoints: &[Keypoint]| Some(height(keypoints, hips)? < height(keypoints, shoulders)?);
    let found: Vec<bool> =
        view.frames.iter().flatten().filter_map(|detection| of_person(&detection.keypoints)).collect();
    (!found.is_empty()).then(|| found.iter().filter(|is_down| **is_down).count() as f64 / found.len() as f64)
}
