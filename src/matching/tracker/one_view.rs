//! People in a session of a single camera: flat figures, as deep as the size of their limbs tells.
//!
//! Nothing but that camera can bear witness, so that whoever it sees for long enough exists; with two cameras or more
//! this is never used. A figure stands upright to the camera's axis: where a joint lies before or behind the body is
//! found by the articulated fit, the tracker needs the metres that a move is worth.

use super::Scene;
use super::birth::is_known;
use super::person::{Skeleton, TrackedPerson};
use crate::body::bones::LimbBone;
use crate::matching::normalized::NormalizedDetection;
use nalgebra::Vector3;

/// Keypoints that a detection must have to start a person: a face alone (five) is none.
const MIN_POINTS: usize = 6;

/// What a figure's depth was counts this many times as much as what one more frame says.
const DEPTH_MEMORY: f64 = 9.0;

/// A depth that no body is seen from whole, m: limits a figure of which two keypoints are seen.
const DEPTHS_M: [f64; 2] = [0.5, 50.0];

/// The new person with most keypoints among the free detections of a frame.
pub(super) fn strongest(
    scene: &Scene,
    frame: usize,
    free: &[usize],
    people: &[TrackedPerson],
) -> Option<TrackedPerson> {
    let detection = |d: usize| &scene.views[0].frames[frame][d];
    let mut order: Vec<usize> = free.iter().copied().filter(|d| detection(*d).n_points() >= MIN_POINTS).collect();
    order.sort_by_key(|d| (std::cmp::Reverse(detection(*d).n_points()), *d));
    order.into_iter().find_map(|d| {
        let skeleton = figure(scene, detection(d), None)?;
        let is_new = !is_known(&skeleton, people, frame);
        is_new.then(|| TrackedPerson::new(frame, vec![Some(d)], skeleton))
    })
}

/// The flat figure of a detection; unseen joints where they are expected, `None` where neither limbs nor an expectation
/// tell a depth.
pub(super) fn figure(scene: &Scene, detection: &NormalizedDetection, predicted: Option<&Skeleton>) -> Option<Skeleton> {
    let camera = scene.cameras[0].as_ref()?;
    let before = predicted.and_then(|p| {
        let depths: Vec<f64> = p.iter().flatten().map(|x| camera.transform(x).z).collect();
        (!depths.is_empty()).then(|| depths.iter().sum::<f64>() / depths.len() as f64)
    });
    let now = depth_of_limbs(scene.bones, detection);
    let depth = match (before, now) {
        (Some(before), Some(now)) => ((before.ln() * DEPTH_MEMORY + now.ln()) / (DEPTH_MEMORY + 1.0)).exp(),
        (before, now) => before.or(now)?,
    };
    let world_from_camera = camera.inverse();
    let point = |k: usize| {
        if detection.confidence[k] > 0.0 {
            let normalized = detection.normalized[k];
            Some(world_from_camera.transform(&Vector3::new(normalized.x * depth, normalized.y * depth, depth)))
        } else {
            predicted.and_then(|p| p[k])
        }
    };
    Some((0..detection.normalized.len()).map(point).collect())
}

/// Depth at which an adult's limbs look as long as these: foreshortening makes limbs look shorter, never longer, so that
/// the longest tell; the very longest may be the detector's error.
fn depth_of_limbs(bones: &[LimbBone], detection: &NormalizedDetection) -> Option<f64> {
    let is_seen = |k: usize| detection.confidence[k] > 0.0;
    let mut sizes: Vec<f64> = bones
        .iter()
        .filter(|b| is_seen(b.a) && is_seen(b.b))
        .map(|b| (detection.normalized[b.a] - detection.normalized[b.b]).norm() / b.length)
        .collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    let size = sizes.get(1).or(sizes.first())?;
    (*size > 0.0).then(|| (1.0 / size).clamp(DEPTHS_M[0], DEPTHS_M[1]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::bones::limb_bones;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::Rigid;
    use crate::matching::normalized::NormalizedView;
    use crate::matching::tracker::{TrackerConfig, track};
    use crate::progress::Progress;
    use nalgebra::Vector2;

    /// Somebody whose bones all hang straight down, `depth` m off and `x` m to the side.
    fn hanging(x: f64, depth: f64) -> NormalizedDetection {
        let bones = limb_bones(KeypointConvention::Coco17);
        let mut heights = [0.0; 17];
        bones.iter().for_each(|b| heights[b.b] = heights[b.a] + b.length);
        let normalized: Vec<_> = heights.iter().map(|y| Vector2::new(x, *y) / depth).collect();
        NormalizedDetection { normalized, confidence: vec![0.9; 17], size: 0.8 / depth, track_id: None }
    }

    #[test]
    fn a_figure_stands_as_deep_as_its_limbs_are_long() {
        let bones = limb_bones(KeypointConvention::Coco17);
        let depth = depth_of_limbs(&bones, &hanging(0.5, 3.0)).unwrap();
        assert!((depth - 3.0).abs() < 1e-9);
        let blind = NormalizedDetection { confidence: vec![0.0; 17], ..hanging(0.5, 3.0) };
        assert!(depth_of_limbs(&bones, &blind).is_none());
    }

    #[test]
    fn two_people_who_pass_before_one_camera_stay_two() {
        let bones = limb_bones(KeypointConvention::Coco17);
        let at = |frame: usize| {
            let s = frame as f64 / 30.0;
            vec![hanging(s - 1.0, 3.0), hanging(1.0 - s, 5.0)]
        };
        let views = [NormalizedView { focal: 1000.0, frames: (0..60).map(at).collect() }];
        let cameras = [Some(Rigid::identity())];
        let scene = Scene { views: &views, cameras: &cameras, bones: &bones, fps: 30.0, n_frames: 60 };
        let people = track(&scene, &TrackerConfig::default(), &Progress::silent()).unwrap();
        assert_eq!(people.len(), 2);
        for person in &people {
            let shown = person.claims[0].1[0];
            assert!(person.claims.len() == 60 && person.claims.iter().all(|(_, claim)| claim[0] == shown));
        }
    }
}
