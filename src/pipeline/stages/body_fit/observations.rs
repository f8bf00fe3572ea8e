//! One person's observations by frame: triangulated points and detected pixels of the body's landmarks.

use super::gaps::{MIN_GAP, gaps};
use crate::body::BodyModel;
use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::DETECTOR;
use crate::body::hand::rigid_points;
use crate::estimation::triangulation::triangulate_reweighted;
use crate::geometry::triangulation::PointObservation as RayToPoint;
use crate::geometry::{Intrinsics, PixelCovariance, Rigid};
use crate::pipeline::calibration::TrackedPeople;
use crate::session::{Detection, JointTrajectory, PersonTrack, Session};
use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointObservation {
    /// Landmark of the body model.
    pub landmark: usize,
    /// World, m.
    pub position: Vector3<f64>,
}

/// A detected pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PixelObservation {
    /// Landmark of the body model.
    pub landmark: usize,
    /// Index of the camera in [`Observations::cameras`].
    pub camera: usize,
    /// As detected, px.
    pub pixel: Vector2<f64>,
    /// Apparent size of the person times the detector's noise factor at this confidence, px; the detector's error is
    /// proportional to it.
    pub scale_px: f64,
    pub error: ErrorShape,
}

/// The shape of a pixel's error: as the detector states it, until that is weighed against the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ErrorShape {
    /// Equal in all directions.
    Round,
    Stated(StatedError),
    /// Whitened by this matrix as far as the stated covariance counts (determinant 1).
    Whitened(Matrix2<f64>),
}

impl ErrorShape {
    pub(super) fn stated(&self) -> Option<&StatedError> {
        if let Self::Stated(stated) = self { Some(stated) } else { None }
    }

    pub(super) fn whitening(&self) -> Option<Matrix2<f64>> {
        if let Self::Whitened(whitening) = self { Some(*whitening) } else { None }
    }
}

/// A covariance as the detector states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StatedError {
    pub covariance: PixelCovariance,
    /// Apparent size of the person, px.
    pub size_px: f64,
}

/// A camera with a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PosedCamera {
    pub intrinsics: Intrinsics,
    pub camera_from_world: Rigid,
}

/// All observations of one person.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Observations {
    pub cameras: Vec<PosedCamera>,
    /// `points[frame]`.
    pub points: Vec<Vec<PointObservation>>,
    /// `pixels[frame]`, landmark by landmark.
    pub pixels: Vec<Vec<PixelObservation>>,
}

impl Observations {
    /// Whether a view saw the person at a frame. Points alone do not show it, since smooth paths continue through gaps.
    pub(super) fn is_seen(&self, frame: usize) -> bool {
        !self.pixels[frame].is_empty()
    }

    /// Mean number of equations of a frame that any view saw: two per pixel.
    pub(super) fn equations_per_frame(&self) -> f64 {
        let seen = self.pixels.iter().filter(|frame| !frame.is_empty()).count();
        2.0 * self.pixels.iter().map(Vec::len).sum::<usize>() as f64 / seen.max(1) as f64
    }

    /// The run of `n_frames` (or of the whole window) with most pixels in a window of frames.
    pub(super) fn most_seen(&self, window: Range<usize>, n_frames: usize) -> Range<usize> {
        let length = window.len().min(n_frames.max(1));
        let seen = |first: usize| self.pixels[first..first + length].iter().map(Vec::len).sum::<usize>();
        let runs = window.start..=window.end - length;
        let first = runs.max_by_key(|&first| (seen(first), std::cmp::Reverse(first))).unwrap_or(window.start);
        first..first + length
    }

    /// The same without the points of a landmark that no view shows for [`MIN_GAP`] or longer while views show others: the smooth
    /// path of a single point knows nothing of the body, and limbs that follow it turn about themselves.
    fn without_unseen_points(mut self, frame_interval: f64) -> Self {
        let landmarks: BTreeSet<usize> = self.points.iter().flatten().map(|point| point.landmark).collect();
        for landmark in landmarks {
            let is_shown = |frame: &Vec<PixelObservation>| frame.iter().any(|pixel| pixel.landmark == landmark);
            let shown: Vec<bool> = self.pixels.iter().map(is_shown).collect();
            for gap in gaps(&shown).into_iter().filter(|gap| gap.len() as f64 * frame_interval >= MIN_GAP) {
                for frame in gap.filter(|&frame| !self.pixels[frame].is_empty()) {
                    self.points[frame].retain(|point| point.landmark != landmark);
                }
            }
        }
        self
    }

    /// The observations of every `stride`-th frame of a run.
    pub(super) fn thinned(&self, run: Range<usize>, stride: usize) -> Self {
        let every = || run.clone().step_by(stride);
        Self {
            cameras: self.cameras.clone(),
            points: every().map(|t| self.points[t].clone()).collect(),
            pixels: every().map(|t| self.pixels[t].clone()).collect(),
        }
    }

    /// The observations of a run of frames.
    pub(super) fn slice(&self, frames: Range<usize>) -> Cow<'_, Self> {
        if frames == (0..self.pixels.len()) {
            return Cow::Borrowed(self);
        }
        Cow::Owned(Self {
            cameras: self.cameras.clone(),
            points: self.points[frames.clone()].to_vec(),
            pixels: self.pixels[frames].to_vec(),
        })
    }
}

/// Gathers the triangulated points and detected pixels of one person over the frames of the person's track.
pub(super) fn gather_observations(people: &TrackedPeople, track: &PersonTrack, model: &BodyModel) -> Observations {
    let TrackedPeople { session, noise, cameras, points, .. } = *people;
    let points = points.iter().find(|p| p.person == track.person);
    let landmarks = session.landmarks_on(model);
    let rigid = rigid_points(model, session.convention);
    let camera_of_view: Vec<Option<usize>> = cameras
        .iter()
        .scan(0, |n_posed, camera| {
            *n_posed += usize::from(camera.is_some());
            Some(camera.map(|_| *n_posed - 1))
        })
        .collect();
    let posed = session.views.iter().zip(cameras).filter_map(|(view, camera)| {
        camera.map(|camera_from_world| PosedCamera { intrinsics: view.intrinsics, camera_from_world })
    });
    let at_frame = |offset: usize| FrameSource { session, noise, track, points, frame: track.first.0 + offset };
    let n_frames = track.detections.len();
    let cameras: Vec<PosedCamera> = posed.collect();
    let keypoints: Vec<(usize, usize)> =
        landmarks.iter().enumerate().filter_map(|(k, landmark)| Some((k, (*landmark)?))).chain(rigid.clone()).collect();
    let pixels: Vec<Vec<PixelObservation>> =
        (0..n_frames).into_par_iter().map(|t| at_frame(t).pixels(&keypoints, &camera_of_view)).collect();
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
    fn points(&self, landmarks: &[Option<usize>]) -> Vec<PointObservation> {
        let row = self.points.and_then(|p| p.points.get(self.frame.checked_sub(p.first.0)?));
        let named = row.into_iter().flatten().zip(landmarks);
        named
            .filter_map(|(position, landmark)| {
                Some(PointObservation { landmark: (*landmark)?, position: (*position)? })
            })
            .filter(|p| p.position.iter().all(|v| v.is_finite()))
            .collect()
    }

    /// `keypoints`: index of a keypoint and the landmark that it shows.
    fn pixels(&self, keypoints: &[(usize, usize)], camera_of_view: &[Option<usize>]) -> Vec<PixelObservation> {
        let mut pixels: Vec<PixelObservation> = Vec::new();
        let of_views = &self.track.detections[self.frame - self.track.first.0];
        for ((view, index), camera) in self.session.views.iter().zip(of_views).zip(camera_of_view) {
            let detection = view.frames.get(self.frame).zip(*index).and_then(|(people, index)| people.get(index));
            let (Some(detection), Some(camera)) = (detection, *camera) else { continue };
            let size_px = apparent_size_px(detection);
            for &(k, landmark) in keypoints {
                let Some(keypoint) = detection.keypoints.get(k).filter(|keypoint| keypoint.is_present()) else {
                    continue;
                };
                // The measured noise is not about hands and faces: their detectors have confidences of their own.
                let is_detail = self.session.dense.is_none() && k >= self.session.convention.names().len();
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

/// Longer side of the bounding box of the present keypoints, px.
fn apparent_size_px(detection: &Detection) -> f64 {
    let present = || detection.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel);
    let Some(first) = present().next() else { return MIN_SIZE_PX };
    let (low, high) = present().fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
    (high - low).max().max(MIN_SIZE_PX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Limbs that followed the paths of unseen points turned about themselves.
    #[test]
    fn points_that_no_view_shows_are_left_out_of_long_gaps() {
        let pixel = |landmark| PixelObservation {
            landmark,
            camera: 0,
            pixel: Vector2::zeros(),
            scale_px: 1.0,
            error: ErrorShape::Round,
        };
        let point = |landmark| PointObservation { landmark, position: Vector3::zeros() };
        // Landmark 1 is hidden for 3 frames and for 6; in the last two of these nothing is seen.
        let pixels = |t: usize| match t {
            18..20 => vec![],
            4..7 | 14..18 => vec![pixel(0)],
            _ => vec![pixel(0), pixel(1)],
        };
        let observations = Observations {
            cameras: vec![],
            points: vec![vec![point(0), point(1)]; 30],
            pixels: (0..30).map(pixels).collect(),
        };
        let kept = observations.without_unseen_points(1.0 / 30.0).points;
        let short: Vec<usize> = (0..30).filter(|&t| kept[t].len() < 2).collect();
        assert_eq!(short, [14, 15, 16, 17]);
        assert!(kept[14..18].iter().all(|points| points[0].landmark == 0));
    }
}
