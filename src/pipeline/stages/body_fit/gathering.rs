//! What the session shows of one person, gathered frame by frame.

use super::observations::{ErrorShape, Observations, PixelObservation, PointObservation, StatedError};
use crate::body::BodyModel;
use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::DETECTOR;
use crate::body::hand::rigid_points;
use crate::estimation::triangulation::triangulate_reweighted;
use crate::geometry::triangulation::PointObservation as RayToPoint;
use crate::pipeline::calibration::PosedCamera;
use crate::pipeline::calibration::TrackedPeople;
use crate::session::{JointTrajectory, Keypoint, PersonTrack, Session};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Gathers the triangulated points and detected pixels of one person over the frames of the person's track.
pub(super) fn gather_observations(people: &TrackedPeople, track: &PersonTrack, model: &BodyModel) -> Observations {
    let TrackedPeople { session, noise, points, .. } = *people;
    let points = points.iter().find(|p| p.person == track.person);
    let landmarks = session.landmarks_on(model);
    let rigid = rigid_points(model, session.convention);
    let (cameras, camera_of_view) = people.posed_cameras();
    let at_frame = |offset: usize| FrameSource { session, noise, track, points, frame: track.first.0 + offset };
    let n_frames = track.detections.len();
    let keypoints: Vec<(usize, usize)> =
        landmarks.iter().enumerate().filter_map(|(k, landmark)| Some((k, (*landmark)?))).chain(rigid.clone()).collect();
    let pixels: Vec<Vec<PixelObservation>> =
        (0..n_frames).into_par_iter().map(|t| at_frame(t).pixels(&keypoints, &camera_of_view, &cameras)).collect();
    let points = |t: usize| {
        let mut points = at_frame(t).points(&landmarks);
        points.extend(rigid.iter().filter_map(|(_, landmark)| triangulated(*landmark, &cameras, &pixels[t])));
        points
    };
    let points = (0..n_frames).into_par_iter().map(points).collect();
    Observations { points, cameras, pixels }.without_unseen_points(1.0 / session.fps)
}

/// One frame of the inputs.
struct FrameSource<'a> {
    session: &'a Session,
    noise: &'a DetectorNoise,
    track: &'a PersonTrack,
    points: Option<&'a JointTrajectory>,
    /// Frame index in the session.
    frame: usize,
}

impl FrameSource<'_> {
    /// By keypoint; empty where none is known.
    fn trajectory_points(&self) -> &[Option<Vector3<f64>>] {
        self.points.and_then(|p| p.points.get(self.frame.checked_sub(p.first.0)?)).map_or(&[], Vec::as_slice)
    }

    fn points(&self, landmarks: &[Option<usize>]) -> Vec<PointObservation> {
        let named = self.trajectory_points().iter().zip(landmarks);
        named
            .filter_map(|(position, landmark)| {
                Some(PointObservation { landmark: (*landmark)?, position: (*position)? })
            })
            .filter(|p| p.position.iter().all(|v| v.is_finite()))
            .collect()
    }

    /// `keypoints`: index of a keypoint and the landmark that it shows.
    fn pixels(
        &self,
        keypoints: &[(usize, usize)],
        camera_of_view: &[Option<usize>],
        cameras: &[PosedCamera],
    ) -> Vec<PixelObservation> {
        let mut pixels: Vec<PixelObservation> = Vec::new();
        let of_views = &self.track.detections[self.frame - self.track.first.0];
        let (points, n_named) = (self.trajectory_points(), self.session.convention.names().len());
        for ((view, index), camera) in self.session.views.iter().zip(of_views).zip(camera_of_view) {
            let detection = view.frames.get(self.frame).zip(*index).and_then(|(people, index)| people.get(index));
            let (Some(detection), Some(camera)) = (detection, *camera) else { continue };
            let size_px = apparent_size_px(&cameras[camera], points, &detection.keypoints[..n_named]);
            for &(k, landmark) in keypoints {
                let Some(keypoint) = detection.keypoints.get(k).filter(|keypoint| keypoint.is_present()) else {
                    continue;
                };
                // The measured noise is not about hands and faces: their detectors have confidences of their own.
                let is_detail = self.session.dense.is_none() && k >= n_named;
                let factor = |confidence: f64| self.noise.factor(confidence.max(DETECTOR.comparable));
                let scale_px = size_px * if is_detail { 1.0 } else { factor(keypoint.confidence) };
                let stated = |covariance| ErrorShape::Stated(StatedError { covariance, size_px });
                let error = keypoint.covariance.map_or(ErrorShape::Round, stated);
                pixels.push(PixelObservation { landmark, camera, pixel: keypoint.pixel, scale_px, error });
            }
        }
        pixels.sort_by_key(|pixel| pixel.landmark);
        // They are kept for the whole take: what growing has left over was 0.4 GiB of 30,000 frames of two people.
        pixels.shrink_to_fit();
        pixels
    }
}

/// Scale of the robust cost of a triangulated point, m: half of a hand.
const ROBUST_SCALE_M: f64 = 0.1;

/// A landmark from its pixels in a frame; `None` where fewer than two cameras see it.
fn triangulated(landmark: usize, cameras: &[PosedCamera], pixels: &[PixelObservation]) -> Option<PointObservation> {
    let rays = pixels.iter().filter(|pixel| pixel.landmark == landmark).map(|pixel| {
        let camera = &cameras[pixel.camera];
        let normalized = camera.intrinsics.normalized_from_pixel(&pixel.pixel);
        RayToPoint { camera_from_world: &camera.camera_from_world, normalized, weight: 1.0 }
    });
    let position = triangulate_reweighted(&rays.collect::<Vec<_>>(), ROBUST_SCALE_M)?;
    Some(PointObservation { landmark, position })
}

/// Least apparent size, so that two close points of a distant person do not get a standard deviation of fractions of a
/// pixel, px.
const MIN_SIZE_PX: f64 = 60.0;

/// Longer side of the bounding box of the person in the image, px: of the trajectories' points, or of the detected keypoints
/// where fewer than half as many points are known.
///
/// A detection may lack legs or have an outlier, which changes the size of its box and not that of its errors. By their own
/// boxes, half bodies (5 % of realistic detections) counted four times, and joints came 6 % farther from the truth.
fn apparent_size_px(camera: &PosedCamera, points: &[Option<Vector3<f64>>], keypoints: &[Keypoint]) -> f64 {
    let PosedCamera { intrinsics, camera_from_world } = camera;
    let (width, height) = (f64::from(intrinsics.width), f64::from(intrinsics.height));
    let is_inside = |p: &Vector2<f64>| (0.0..width).contains(&p.x) && (0.0..height).contains(&p.y);
    let projected = |p: &Vector3<f64>| intrinsics.pixel_from_camera(&camera_from_world.transform(p));
    let (n_points, of_points) = extent(points.iter().flatten().filter_map(projected).filter(is_inside));
    let (n_seen, of_detection) = extent(keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel));
    if 2 * n_points >= n_seen { of_points } else { of_detection }
}

/// Number of pixels, and the longer side of their bounding box, px; at least [`MIN_SIZE_PX`].
fn extent(pixels: impl Iterator<Item = Vector2<f64>>) -> (usize, f64) {
    let nothing = (0, Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    let (n, low, high) = pixels.fold(nothing, |(n, low, high), p| (n + 1, low.inf(&p), high.sup(&p)));
    (n, (high - low).max().max(MIN_SIZE_PX))
}

#[cfg(test)]
mod tests {
    use super::super::test_fixtures::camera_in_front;
    use super::*;

    /// A line of ten points, 1.8 m high.
    fn points() -> Vec<Option<Vector3<f64>>> {
        (0..10).map(|k| Some(Vector3::new(0.0, 0.1 + 0.2 * f64::from(k), 0.0))).collect()
    }

    /// Detections of the points; those whose index is not in `present` are missing.
    fn keypoints(camera: &PosedCamera, present: std::ops::Range<usize>) -> Vec<Keypoint> {
        let pixel = |p: Vector3<f64>| camera.intrinsics.pixel_from_camera(&camera.camera_from_world.transform(&p));
        let keypoint = |(k, p): (usize, Option<Vector3<f64>>)| Keypoint {
            pixel: p.and_then(pixel).unwrap(),
            confidence: if present.contains(&k) { 0.9 } else { 0.0 },
            covariance: None,
        };
        points().into_iter().enumerate().map(keypoint).collect()
    }

    /// They had twice the weight in either axis, and changed it from frame to frame.
    #[test]
    fn half_bodies_and_outliers_keep_the_size_of_the_whole() {
        let camera = camera_in_front(0.0);
        let whole = apparent_size_px(&camera, &points(), &keypoints(&camera, 0..10));
        assert!((whole - camera.intrinsics.focal() * 1.8 / 4.0).abs() < 1e-9, "{whole}");
        assert_eq!(apparent_size_px(&camera, &points(), &keypoints(&camera, 5..10)), whole);
        let mut far_off = keypoints(&camera, 0..10);
        far_off[3].pixel.x += 500.0;
        assert_eq!(apparent_size_px(&camera, &points(), &far_off), whole);
    }

    #[test]
    fn detections_of_unknown_points_have_their_own_size() {
        let camera = camera_in_front(0.0);
        let half = apparent_size_px(&camera, &[], &keypoints(&camera, 5..10));
        assert!((half - camera.intrinsics.focal() * 0.8 / 4.0).abs() < 1e-9, "{half}");
        assert_eq!(apparent_size_px(&camera, &points()[..2], &keypoints(&camera, 5..10)), half);
        assert_eq!(apparent_size_px(&camera, &[], &keypoints(&camera, 0..0)), MIN_SIZE_PX);
    }
}
