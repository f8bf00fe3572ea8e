//! Skeletons of sessions with a single camera: flat figures, at the depth that the size of their limbs implies.
//!
//! A figure is parallel to the image plane. Depths of single joints come from the later articulated fit; the tracker only
//! needs motion in metres. Sessions of two cameras or more do not use this module.

use super::scene::TrackerScene;
use super::skeleton::Skeleton;
use crate::body::bones::LimbBone;
use crate::matching::normalized::NormalizedDetection;
use nalgebra::Vector3;

/// Weight of a figure's depth so far against that of one more frame.
const DEPTH_MEMORY: f64 = 9.0;

/// Bounds of a figure's depth, m: of a nearer body a camera shows no whole limb, a farther one is smaller than the
/// detectors' errors. They limit figures of which two keypoints are seen.
const DEPTHS_M: [f64; 2] = [0.5, 50.0];

/// The flat figure of a detection; unseen joints keep their predicted positions. `None` where neither limbs nor a
/// prediction give a depth.
pub(super) fn flat_figure(
    scene: &TrackerScene,
    detection: &NormalizedDetection,
    predicted: Option<&Skeleton>,
) -> Option<Skeleton> {
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

/// Depth at which an adult's limbs look as long as these, m. Foreshortening makes limbs look shorter, never longer, so
/// the second longest decides; the longest may be a detector error.
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
    use nalgebra::Vector2;

    #[test]
    fn depth_follows_from_the_length_of_limbs() {
        let bones = limb_bones(KeypointConvention::Coco17);
        let mut heights = [0.0; 17];
        bones.iter().for_each(|b| heights[b.b] = heights[b.a] + b.length);
        let points = heights.iter().map(|y| Vector2::new(0.5, *y) / 3.0).collect();
        let hanging = NormalizedDetection::of_points(points, 0.27);
        assert!((depth_of_limbs(&bones, &hanging).unwrap() - 3.0).abs() < 1e-9);
        let blind = NormalizedDetection { confidence: vec![0.0; 17], ..hanging };
        assert!(depth_of_limbs(&bones, &blind).is_none());
    }
}
