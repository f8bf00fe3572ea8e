//! Errors of poses: percentage of correct parts (PCP) and mean per-joint position error (MPJPE).

use super::alignment::{Scale, align_points};
use super::camera_error::mean;
use super::person_matching::{Frames, Matching, for_each_match, mean_distance};
use super::shelf14::{BOTTOM_HEAD, LEFT_HIP, N_LIMB, N_SHELF, Point, RIGHT_HIP, Shelf14};
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeMap;

/// A body part: its name and its end joints.
struct Part {
    name: &'static str,
    start: fn(&Shelf14) -> Point,
    end: usize,
}

/// The ten body parts; the torso starts between the hips.
const PARTS: [Part; 10] = [
    Part { name: "L_upper_arm", start: |p| p[9], end: 10 },
    Part { name: "R_upper_arm", start: |p| p[8], end: 7 },
    Part { name: "L_lower_arm", start: |p| p[10], end: 11 },
    Part { name: "R_lower_arm", start: |p| p[7], end: 6 },
    Part { name: "L_upper_leg", start: |p| p[LEFT_HIP], end: 4 },
    Part { name: "R_upper_leg", start: |p| p[RIGHT_HIP], end: 1 },
    Part { name: "L_lower_leg", start: |p| p[4], end: 5 },
    Part { name: "R_lower_leg", start: |p| p[1], end: 0 },
    Part { name: "head", start: |p| p[BOTTOM_HEAD], end: 13 },
    Part { name: "torso", start: mid_hip, end: BOTTOM_HEAD },
];

/// Largest mean error of a correct part's ends, as a share of its length.
const ALPHA: f64 = 0.5;
/// Largest mean joint error of a matched person, m.
const REJECT: f64 = 0.5;

/// Percentage of correct parts (PCP).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pcp {
    /// Tolerance, share of the part's length.
    pub alpha: f64,
    /// Matching of people.
    pub matching: Matching,
    /// PCP per true person, percent.
    pub per_actor: BTreeMap<String, f64>,
    /// Number of true poses, per true person.
    pub n_poses: BTreeMap<String, usize>,
    /// Mean over the selected people, percent.
    pub average: Option<f64>,
    /// PCP per part over the selected people, percent.
    pub per_part: BTreeMap<&'static str, f64>,
}

/// Mean per-joint position error (MPJPE), mm, over matched poses: without alignment, with aligned hips, and after Procrustes
/// alignment (rotation, translation and scale); over all 14 joints and over the 12 limb joints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mpjpe {
    /// 14 joints, without alignment, mm.
    pub raw14: Option<f64>,
    /// 14 joints, aligned hips, mm.
    pub root14: Option<f64>,
    /// 14 joints, Procrustes alignment, mm.
    pub pa14: Option<f64>,
    /// 12 limb joints, without alignment, mm.
    pub raw12: Option<f64>,
    /// 12 limb joints, aligned hips, mm.
    pub root12: Option<f64>,
    /// 12 limb joints, Procrustes alignment, mm.
    pub pa12: Option<f64>,
    /// Number of true poses.
    pub n_gt: usize,
    /// Number of them that are matched within 0.5 m.
    pub n_matched: usize,
    /// `n_matched / n_gt`.
    pub recall: f64,
}

/// PCP of `solved` relative to `truth`, both in one world, metres; the averages are over `actors`.
///
/// A part is correct when `(|start error| + |end error|) / 2 <= 0.5 |true part|`. All ten parts of a true person without a
/// match are wrong; additional people of the result have no effect.
pub fn pcp(truth: &Frames<Shelf14>, solved: &Frames<Shelf14>, actors: &[String], matching: Matching) -> Pcp {
    let mut correct: BTreeMap<&str, [usize; PARTS.len()]> = BTreeMap::new();
    let mut n_poses: BTreeMap<String, usize> = BTreeMap::new();
    for_each_match(truth, solved, matching, |actor, true_pose, pose| {
        *n_poses.entry(actor.to_owned()).or_default() += 1;
        let counts = correct.entry(actor).or_default();
        for (count, part) in counts.iter_mut().zip(&PARTS) {
            *count += usize::from(pose.is_some_and(|pose| part.is_correct(true_pose, pose)));
        }
    });
    let per_actor: BTreeMap<String, f64> = n_poses
        .iter()
        .map(|(actor, n)| {
            let right: usize = correct[actor.as_str()].iter().sum();
            (actor.clone(), percent(right, n * PARTS.len()))
        })
        .collect();
    let used = || actors.iter().filter(|actor| per_actor.contains_key(*actor));
    let part_percent = |index: usize| {
        let right = used().map(|actor| correct[actor.as_str()][index]).sum();
        percent(right, used().map(|actor| n_poses[actor]).sum())
    };
    Pcp {
        alpha: ALPHA,
        matching,
        average: mean(used().map(|actor| per_actor[actor])),
        per_part: PARTS.iter().enumerate().map(|(index, part)| (part.name, part_percent(index))).collect(),
        per_actor,
        n_poses,
    }
}

/// MPJPE of `solved` relative to `truth` over `actors`, matched one to one; both in one world, metres. The mean over poses of
/// the mean of `|x_solved - x_true|` over the common joints; poses farther off than 0.5 m count as not matched.
pub fn mpjpe(truth: &Frames<Shelf14>, solved: &Frames<Shelf14>, actors: &[String]) -> Mpjpe {
    let (mut n_gt, mut n_matched) = (0, 0);
    let (mut all, mut limbs) = (PoseDistances::default(), PoseDistances::default());
    for_each_match(truth, solved, Matching::One2one, |actor, true_pose, pose| {
        if !actors.iter().any(|a| a == actor) {
            return;
        }
        n_gt += 1;
        if let Some(pose) = pose.filter(|pose| mean_distance(true_pose, pose).is_some_and(|d| d < REJECT)) {
            n_matched += 1;
            all.add(true_pose, pose, N_SHELF);
            limbs.add(true_pose, pose, N_LIMB);
        }
    });
    let mm = |distances: Vec<f64>| mean(distances.into_iter()).map(|m| 1e3 * m);
    Mpjpe {
        raw14: mm(all.raw),
        root14: mm(all.root),
        pa14: mm(all.procrustes),
        raw12: mm(limbs.raw),
        root12: mm(limbs.root),
        pa12: mm(limbs.procrustes),
        n_gt,
        n_matched,
        recall: n_matched as f64 / n_gt.max(1) as f64,
    }
}

/// Mean joint distances of the poses added so far, m.
#[derive(Default)]
struct PoseDistances {
    raw: Vec<f64>,
    root: Vec<f64>,
    procrustes: Vec<f64>,
}

impl PoseDistances {
    /// Smallest number of common joints of a compared pose.
    const MIN_JOINTS: usize = 4;

    fn add(&mut self, truth: &Shelf14, solved: &Shelf14, n_joints: usize) {
        let common = truth.iter().zip(solved).take(n_joints).filter_map(|(t, s)| Some(((*t)?, (*s)?)));
        let (t, s): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = common.unzip();
        if t.len() < Self::MIN_JOINTS {
            return;
        }
        let distance = |moved: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| {
            t.iter().zip(&s).map(|(t, s)| (moved(s) - t).norm()).sum::<f64>() / t.len() as f64
        };
        self.raw.push(distance(&|point| *point));
        if let (Some(true_root), Some(root)) = (mid_hip(truth), mid_hip(solved)) {
            self.root.push(distance(&|point| point - root + true_root));
        }
        let aligned = align_points(&s, &t, Scale::Free);
        self.procrustes.push(distance(&|point| aligned.transform(point)));
    }
}

impl Part {
    /// Whether the part is correct; one that the truth or the result lacks is wrong.
    fn is_correct(&self, truth: &Shelf14, solved: &Shelf14) -> bool {
        let ends = || Some(((self.start)(truth)?, truth[self.end]?, (self.start)(solved)?, solved[self.end]?));
        ends().is_some_and(|(true_start, true_end, start, end)| {
            0.5 * ((start - true_start).norm() + (end - true_end).norm()) <= ALPHA * (true_end - true_start).norm()
        })
    }
}

fn mid_hip(pose: &Shelf14) -> Point {
    Some(0.5 * (pose[RIGHT_HIP]? + pose[LEFT_HIP]?))
}

fn percent(right: usize, of: usize) -> f64 {
    100.0 * right as f64 / of.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn person(x: f64) -> Shelf14 {
        std::array::from_fn(|j| {
            Some(Vector3::new(x + 0.3 * f64::from(j as u8 % 3), 0.15 * j as f64, 0.1 * (j as f64).sin()))
        })
    }

    fn frames(people: &[(&str, Shelf14)]) -> Frames<Shelf14> {
        BTreeMap::from([(7, people.iter().map(|(name, pose)| ((*name).to_owned(), *pose)).collect())])
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|n| (*n).to_owned()).collect()
    }

    #[test]
    fn truth_scores_perfectly() {
        let truth = frames(&[("0", person(0.0)), ("1", person(2.0))]);
        let score = pcp(&truth, &truth, &names(&["0", "1"]), Matching::Nearest);
        assert_eq!(score.average, Some(100.0));
        let errors = mpjpe(&truth, &truth, &names(&["0", "1"]));
        assert_eq!((errors.raw14, errors.recall), (Some(0.0), 1.0));
        assert!(errors.pa14.unwrap() < 1e-9);
    }

    #[test]
    fn a_shift_changes_the_raw_error_only() {
        let truth = frames(&[("0", person(0.0))]);
        let errors = mpjpe(&truth, &frames(&[("9", person(0.1))]), &names(&["0"]));
        assert!((errors.raw14.unwrap() - 100.0).abs() < 1e-9);
        assert!(errors.root14.unwrap() < 1e-9 && errors.pa12.unwrap() < 1e-9);
    }

    #[test]
    fn only_nearest_matching_shares_a_prediction() {
        let truth = frames(&[("0", person(0.0)), ("1", person(0.05))]);
        let one = frames(&[("a", person(0.0))]);
        assert_eq!(pcp(&truth, &one, &names(&["0", "1"]), Matching::Nearest).average, Some(100.0));
        assert_eq!(pcp(&truth, &one, &names(&["0", "1"]), Matching::One2one).average, Some(50.0));
        assert_eq!(pcp(&truth, &Frames::new(), &names(&["0"]), Matching::Nearest).average, Some(0.0));
    }

    #[test]
    fn a_missing_joint_makes_its_parts_wrong() {
        let truth = frames(&[("0", person(0.0))]);
        let mut pose = person(0.0);
        pose[10] = None; // The left elbow ends one part and starts another.
        let score = pcp(&truth, &frames(&[("0", pose)]), &names(&["0"]), Matching::Nearest);
        assert_eq!(score.average, Some(80.0));
        assert_eq!((score.per_part["L_upper_arm"], score.per_part["torso"]), (0.0, 100.0));
    }
}
