//! Distances of virtual markers on the fitted skin from the same markers on the true skin.
//!
//! Each marker corresponds to one fixed vertex of the fitted body. With real markers that is usually the vertex nearest in
//! the first frame, since the true one is unknown ([`first_matches`]); bodies of one model share their vertices, and the same
//! vertex is used: the error then includes that of the first frame and rotations of the body inside its skin.

use super::camera_error::mean;
use super::person_matching::{Frames, Matching, People, matched};
use super::shelf14::{Shelf14, Skeleton, to_shelf14};
use crate::body::skeleton::{KeypointConvention, N_JOINTS};
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeMap;

/// One person in one frame, world metres.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkedPose {
    /// SMPL's joints, for matching people.
    pub joints: [Vector3<f64>; N_JOINTS],
    /// The markers, in an order common to truth and result.
    pub markers: Vec<Vector3<f64>>,
}

/// Distances of markers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MarkerError {
    /// Mean over markers, people and frames, mm.
    pub mean_mm: Option<f64>,
    /// Standard deviation over markers, people and frames, mm.
    pub spread_mm: Option<f64>,
    /// Standard deviation over people and frames of the mean over the markers, mm.
    pub spread_of_poses_mm: Option<f64>,
    /// Share of the true people of all frames that have a fitted body, 0 to 1.
    pub recall: f64,
}

/// Distances of the markers of `solved` to those of `truth`. In every frame people are matched one to one by their joints, as
/// for pose errors, but without a limit on the distance.
pub fn marker_error(truth: &Frames<MarkedPose>, solved: &Frames<MarkedPose>) -> MarkerError {
    let (mut n_true, mut distances, mut of_poses) = (0, Vec::new(), Vec::new());
    let no_people = People::new();
    for (frame, true_people) in truth {
        let people = solved.get(frame).unwrap_or(&no_people);
        n_true += true_people.len();
        for (actor, name) in matched(&skeletons(true_people), &skeletons(people), Matching::One2one) {
            let pairs = true_people[actor].markers.iter().zip(&people[name].markers);
            let of_pose: Vec<f64> = pairs.map(|(t, s)| 1e3 * (t - s).norm()).collect();
            of_poses.extend(mean(of_pose.iter().copied()));
            distances.extend(of_pose);
        }
    }
    MarkerError {
        mean_mm: mean(distances.iter().copied()),
        spread_mm: spread(&distances),
        spread_of_poses_mm: spread(&of_poses),
        recall: of_poses.len() as f64 / n_true.max(1) as f64,
    }
}

/// For each person of `solved` the first frame with a match in `truth`: frame and true name.
pub fn first_matches(truth: &Frames<MarkedPose>, solved: &Frames<MarkedPose>) -> BTreeMap<String, (i64, String)> {
    let mut matches = BTreeMap::new();
    for (frame, true_people) in truth {
        let Some(people) = solved.get(frame) else { continue };
        for (actor, name) in matched(&skeletons(true_people), &skeletons(people), Matching::One2one) {
            matches.entry(name.to_owned()).or_insert((*frame, actor.to_owned()));
        }
    }
    matches
}

/// For each marker the index of the nearest vertex of a mesh; `markers` and `mesh` in one world, metres.
pub fn nearest_vertices(markers: &[Vector3<f64>], mesh: &[Vector3<f64>]) -> Vec<usize> {
    let square = |marker: &Vector3<f64>, vertex: usize| (mesh[vertex] - marker).norm_squared();
    let nearest = |marker: &Vector3<f64>| {
        (0..mesh.len()).min_by(|&a, &b| square(marker, a).total_cmp(&square(marker, b))).unwrap_or(0)
    };
    markers.iter().map(nearest).collect()
}

fn skeletons(people: &People<MarkedPose>) -> People<Shelf14> {
    let skeleton = Skeleton::Keypoints(KeypointConvention::Smpl24);
    // SMPL's head joints do not depend on the up axis.
    let shelf = |pose: &MarkedPose| to_shelf14(&pose.joints.map(Some), skeleton, &Vector3::y());
    people.iter().map(|(name, pose)| (name.clone(), shelf(pose))).collect()
}

fn spread(values: &[f64]) -> Option<f64> {
    let middle = mean(values.iter().copied())?;
    mean(values.iter().map(|value| (value - middle).powi(2))).map(f64::sqrt)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::kinematics::{Pose, posed};
    use crate::body::skinning::skinned;
    use crate::body::{Betas, default_body};
    use crate::evaluation::markers::markers;

    /// Two people a metre apart, moved by `shift`, named by `names`.
    fn frames(shift: Vector3<f64>, names: [&str; 2]) -> Frames<MarkedPose> {
        let model = default_body();
        let markers = markers(&model);
        let person = |x: f64| {
            let pose = Pose { translation: Vector3::x() * x + shift, ..Pose::rest() };
            let mesh = skinned(&model, &Betas::zeros(), &pose);
            let joints = posed(&model.shaped(&Betas::zeros()), &pose).joints;
            MarkedPose { joints, markers: markers.iter().map(|marker| mesh[marker.vertex]).collect() }
        };
        let people = || names.iter().zip([0.0, 1.0]).map(|(name, x)| ((*name).to_owned(), person(x))).collect();
        (0..3).map(|frame| (frame, people())).collect()
    }

    #[test]
    fn measures_a_shift_of_ten_millimetres() {
        let truth = frames(Vector3::zeros(), ["a", "b"]);
        let same = marker_error(&truth, &frames(Vector3::zeros(), ["1", "0"]));
        assert_eq!((same.mean_mm, same.spread_mm, same.recall), (Some(0.0), Some(0.0), 1.0));
        let off = marker_error(&truth, &frames(Vector3::new(0.006, 0.0, -0.008), ["1", "0"]));
        assert!((off.mean_mm.unwrap() - 10.0).abs() < 1e-9 && off.spread_mm.unwrap() < 1e-9);
    }

    #[test]
    fn missing_people_lower_recall_and_frames_spread() {
        let truth = frames(Vector3::zeros(), ["a", "b"]);
        let mut solved = frames(Vector3::zeros(), ["0", "1"]);
        solved.get_mut(&0).unwrap().remove("1");
        solved.remove(&1);
        let error = marker_error(&truth, &solved);
        assert_eq!((error.recall, error.mean_mm), (0.5, Some(0.0)));
        let off = frames(Vector3::new(0.0, 0.01, 0.0), ["0", "1"]);
        let error = marker_error(&truth, &Frames::from([(0, truth[&0].clone()), (1, off[&1].clone())]));
        assert!((error.mean_mm.unwrap() - 5.0).abs() < 1e-9);
        assert!((error.spread_mm.unwrap() - 5.0).abs() < 1e-9);
        assert!((error.spread_of_poses_mm.unwrap() - 5.0).abs() < 1e-9);
        assert_eq!(marker_error(&truth, &Frames::new()).mean_mm, None);
    }
}
