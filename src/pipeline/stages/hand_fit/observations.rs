//! Pixels of a hand's points by frame.

use crate::body::hand::{HandPoint, HandShape, Side, hand_keypoints, hand_points};
use crate::pipeline::calibration::{PosedCamera, TrackedPeople};
use crate::session::{BodyMotion, PersonTrack};
use nalgebra::Vector2;

/// A pixel of a point of the hand.
#[derive(Debug, Clone, Copy)]
pub(super) struct HandPixel {
    pub camera: usize,
    pub point: HandPoint,
    /// As detected, px.
    pub pixel: Vector2<f64>,
    /// Length of a hand at this distance, px; the detector's errors are a share of it.
    pub size_px: f64,
}

/// Nearest distance of a hand for its apparent size, m.
const MIN_DEPTH: f64 = 0.2;

/// Pixels of a person's hand in the frames of the person's motion.
pub(super) fn hand_pixels(
    people: &TrackedPeople,
    (cameras, of_views): &(Vec<PosedCamera>, Vec<Option<usize>>),
    motion: &BodyMotion,
    track: &PersonTrack,
    side: Side,
) -> Vec<Vec<HandPixel>> {
    let Some(keypoints) = hand_keypoints(people.session.convention, side) else { return Vec::new() };
    let length = HandShape::average(side).length();
    let at_frame = |(t, frame): (usize, &crate::session::people::BodyPose)| {
        let mut pixels = Vec::new();
        let index = motion.first.0 + t;
        let row = index.checked_sub(track.first.0).and_then(|t| track.detections.get(t));
        let Some(row) = row else { return pixels };
        for (view, (camera, detection)) in of_views.iter().zip(row).enumerate() {
            let (Some(camera), Some(detection)) = (*camera, *detection) else { continue };
            let PosedCamera { intrinsics, camera_from_world } = &cameras[camera];
            let depth = camera_from_world.transform(&frame.joints[side.wrist()]).z.max(MIN_DEPTH);
            let size_px = intrinsics.focal() * length / depth;
            let seen = people.session.views[view].frames[index].get(detection);
            let hand = seen.and_then(|seen| seen.keypoints.get(keypoints.clone()));
            for (keypoint, point) in hand.into_iter().flatten().zip(hand_points()) {
                if keypoint.is_present() {
                    pixels.push(HandPixel { camera, point, pixel: keypoint.pixel, size_px });
                }
            }
        }
        pixels
    };
    motion.frames.iter().enumerate().map(at_frame).collect()
}
