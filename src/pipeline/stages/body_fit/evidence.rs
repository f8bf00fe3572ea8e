//! What speaks for one person's pose, frame by frame: triangulated points and detected pixels of the body's landmarks.

use super::BodyFitInput;
use crate::body::BodyModel;
use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::DETECTOR;
use crate::geometry::{Intrinsics, Rigid};
use crate::session::{Detection, JointTrajectory, PersonTrack, Session};
use nalgebra::{Vector2, Vector3};

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointEvidence {
    /// Landmark of the body model.
    pub landmark: usize,
    /// Where it was found, world, m.
    pub position: Vector3<f64>,
}

/// A detected pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PixelEvidence {
    /// Landmark of the body model.
    pub landmark: usize,
    /// Index of the camera in [`Evidence::cameras`].
    pub camera: usize,
    /// As detected.
    pub pixel: Vector2<f64>,
    /// Apparent size of the person times how much worse the detector is at this confidence, px: what its error is
    /// proportional to.
    pub scale_px: f64,
}

/// A placed camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlacedCamera {
    pub intrinsics: Intrinsics,
    pub camera_from_world: Rigid,
}

/// All that is known of one person.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evidence {
    pub cameras: Vec<PlacedCamera>,
    /// `points[frame]`.
    pub points: Vec<Vec<PointEvidence>>,
    /// `pixels[frame]`, landmark by landmark.
    pub pixels: Vec<Vec<PixelEvidence>>,
}

impl Evidence {
    /// Whether a view saw the person at a frame. Points alone are no witness: smooth paths go on through holes.
    pub(super) fn is_seen(&self, frame: usize) -> bool {
        !self.pixels[frame].is_empty()
    }

    /// A run of frames.
    pub(super) fn slice(&self, frames: std::ops::Range<usize>) -> Self {
        Self {
            cameras: self.cameras.clone(),
            points: self.points[frames.clone()].to_vec(),
            pixels: self.pixels[frames].to_vec(),
        }
    }
}

/// Gathers what the views and the triangulation say about one person over the frames of their track.
pub(super) fn gather_evidence(
    input: BodyFitInput,
    track: &PersonTrack,
    points: Option<&JointTrajectory>,
    model: &BodyModel,
) -> Evidence {
    let BodyFitInput { session, noise, cameras, .. } = input;
    let landmarks = model.landmarks_of(session.convention);
    let camera_of_view: Vec<Option<usize>> = cameras
        .iter()
        .scan(0, |placed, camera| {
            *placed += usize::from(camera.is_some());
            Some(camera.map(|_| *placed - 1))
        })
        .collect();
    let placed = session.views.iter().zip(cameras).filter_map(|(view, camera)| {
        camera.map(|camera_from_world| PlacedCamera { intrinsics: view.intrinsics, camera_from_world })
    });
    let at_frame = |offset: usize| FrameSource { session, noise, track, points, frame: track.first.0 + offset };
    let n_frames = track.detections.len();
    Evidence {
        cameras: placed.collect(),
        points: (0..n_frames).map(|t| at_frame(t).points(&landmarks)).collect(),
        pixels: (0..n_frames).map(|t| at_frame(t).pixels(&landmarks, &camera_of_view)).collect(),
    }
}

/// One frame of the inputs.
struct FrameSource<'a> {
    session: &'a Session,
    noise: &'a DetectorNoise,
    track: &'a PersonTrack,
    points: Option<&'a JointTrajectory>,
    /// On the session's time line.
    frame: usize,
}

impl FrameSource<'_> {
    fn points(&self, landmarks: &[Option<usize>]) -> Vec<PointEvidence> {
        let row = self.points.and_then(|p| p.points.get(self.frame.checked_sub(p.first.0)?));
        let named = row.into_iter().flatten().zip(landmarks);
        named
            .filter_map(|(position, landmark)| Some(PointEvidence { landmark: (*landmark)?, position: (*position)? }))
            .filter(|p| p.position.iter().all(|v| v.is_finite()))
            .collect()
    }

    fn pixels(&self, landmarks: &[Option<usize>], camera_of_view: &[Option<usize>]) -> Vec<PixelEvidence> {
        let mut pixels: Vec<PixelEvidence> = Vec::new();
        let chosen = &self.track.detections[self.frame - self.track.first.0];
        for ((view, chosen), camera) in self.session.views.iter().zip(chosen).zip(camera_of_view) {
            let detection = view.frames.get(self.frame).zip(*chosen).and_then(|(people, index)| people.get(index));
            let (Some(detection), Some(camera)) = (detection, *camera) else { continue };
            let size_px = apparent_size_px(detection);
            for (keypoint, landmark) in detection.keypoints.iter().zip(landmarks) {
                let Some(landmark) = landmark.filter(|_| keypoint.is_present()) else { continue };
                let scale_px = size_px * self.noise.factor(keypoint.confidence.max(DETECTOR.comparable));
                pixels.push(PixelEvidence { landmark, camera, pixel: keypoint.pixel, scale_px });
            }
        }
        pixels.sort_by_key(|pixel| pixel.landmark);
        pixels
    }
}

/// A detection never counts as smaller than this, so that two close points of a distant person are not trusted to
/// fractions of a pixel.
const MIN_SIZE_PX: f64 = 60.0;

/// Longer side of the box about the present keypoints, px.
fn apparent_size_px(detection: &Detection) -> f64 {
    let present = || detection.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel);
    let Some(first) = present().next() else { return MIN_SIZE_PX };
    let (low, high) = present().fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
    (high - low).max().max(MIN_SIZE_PX)
}
