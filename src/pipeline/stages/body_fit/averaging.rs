//! Observations of every few frames that say what the frames between them say as well.
//!
//! Slow errors are nearly the same in all frames of 0.1 s, but each frame has errors of its own, outliers and holes. About a known motion
//! the residuals of the frames between are residuals of the frame that is kept, and their median takes the place of its own.

use super::observations::{Observations, PixelObservation};
use super::terms::unknowns::MotionState;
use crate::body::BodyModel;
use crate::body::kinematics::{landmark_position, posed};
use crate::body::model::ShapedBody;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Every `stride`-th frame, with the median residuals, by axis, of all frames that lie nearer to it than to the next, about the motion
/// `state` of all frames. A landmark that a camera shows in any of these counts as shown in the frame that is kept.
pub(super) fn averaged(
    model: &BodyModel,
    observations: &Observations,
    state: &MotionState,
    stride: usize,
) -> Observations {
    let n_frames = observations.pixels.len();
    if stride == 1 {
        return observations.clone();
    }
    let body = model.shaped(&state.betas);
    let motion = Motion { model, body: &body, observations, state };
    let around = |t: usize| t.saturating_sub((stride - 1) / 2)..=(t + stride / 2).min(n_frames - 1);
    let kept: Vec<usize> = (0..n_frames).step_by(stride).collect();
    let points = kept.iter().map(|&t| observations.points[t].clone()).collect();
    let pixels = kept.into_par_iter().map(|t| motion.pixels_at(t, around(t))).collect();
    Observations { cameras: observations.cameras.clone(), points, pixels }
}

/// A known motion and what is detected of it.
struct Motion<'a> {
    model: &'a BodyModel,
    body: &'a ShapedBody,
    observations: &'a Observations,
    state: &'a MotionState,
}

/// A landmark in a camera.
type Channel = (usize, usize);

/// A detected pixel in a frame.
struct Seen {
    pixel: PixelObservation,
    /// From where the motion has the landmark, px.
    residual: Vector2<f64>,
    /// Frames to the one that is kept.
    distance: usize,
}

impl Seen {
    fn channel(&self) -> Channel {
        (self.pixel.landmark, self.pixel.camera)
    }
}

impl Motion<'_> {
    /// What is detected in `frames`, as if it were in frame `t`.
    fn pixels_at(&self, t: usize, frames: RangeInclusive<usize>) -> Vec<PixelObservation> {
        let mut seen: Vec<Seen> = frames.flat_map(|frame| self.seen_in(frame, t)).collect();
        seen.sort_by_key(|found| (found.channel(), found.distance));
        let channels: Vec<&[Seen]> = seen.chunk_by(|a, b| a.channel() == b.channel()).collect();
        let places = self.projected(t, channels.iter().map(|found| found[0].channel()));
        channels.iter().zip(places).filter_map(|(found, place)| Some(moved_to(place?, found))).collect()
    }

    fn seen_in(&self, frame: usize, kept: usize) -> Vec<Seen> {
        let pixels = &self.observations.pixels[frame];
        let places = self.projected(frame, pixels.iter().map(|pixel| (pixel.landmark, pixel.camera)));
        let distance = frame.abs_diff(kept);
        let seen = |(pixel, place): (&PixelObservation, Option<Vector2<f64>>)| {
            Some(Seen { pixel: *pixel, residual: pixel.pixel - place?, distance })
        };
        pixels.iter().zip(places).filter_map(seen).collect()
    }

    /// Where the motion has landmarks in the images of a frame, px; `None` behind a camera.
    fn projected(&self, frame: usize, channels: impl Iterator<Item = Channel>) -> Vec<Option<Vector2<f64>>> {
        let skeleton = posed(self.body, &self.state.poses[frame]);
        let place = |(landmark, camera): Channel| {
            self.observations.cameras[camera].pixel_of(&landmark_position(self.model, self.body, &skeleton, landmark))
        };
        channels.map(place).collect()
    }
}

/// The observation of a channel whose landmark is at `place`; `found`: not empty, the nearest frame first.
fn moved_to(place: Vector2<f64>, found: &[Seen]) -> PixelObservation {
    let of_axis = |axis: usize| middle(found.iter().map(|seen| seen.residual[axis]).collect());
    let residual = Vector2::new(of_axis(0), of_axis(1));
    let scale_px = found.iter().map(|seen| seen.pixel.scale_px).sum::<f64>() / found.len() as f64;
    PixelObservation { pixel: place + residual, scale_px, ..found[0].pixel }
}

/// The median, of an even number of values the mean of the middle two.
fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}

#[cfg(test)]
mod tests {
    use super::super::test_fixtures::{Surroundings, camera_in_front, seen};
    use super::*;
    use crate::body::kinematics::Pose;
    use crate::body::model::Betas;
    use nalgebra::Vector3;

    /// The adjustment of the cameras knew nothing of two of three frames. Of a person who walks, each landmark errs by the same in
    /// all frames but one, in which it is an outlier, and is missing in the frame that is kept.
    #[test]
    fn frames_between_fill_holes_and_outvote_outliers() {
        let surroundings = Surroundings::new();
        let (model, camera, error) = (&surroundings.model, camera_in_front(0.4), Vector2::new(3.0, -2.0));
        let pose = |t: usize| Pose { translation: Vector3::new(0.05 * t as f64, 0.0, 0.0), ..Pose::rest() };
        let state = MotionState { betas: Betas::zeros(), poses: (0..15).map(pose).collect() };
        let body = model.shaped(&state.betas);
        let place = |t: usize, landmark: usize| {
            let skeleton = posed(&body, &state.poses[t]);
            camera.pixel_of(&landmark_position(model, &body, &skeleton, landmark)).unwrap()
        };
        let pixel = |t: usize, landmark: usize| {
            let outlier = if t % 5 == 3 { 200.0 } else { 0.0 };
            let pixel = place(t, landmark) + error + Vector2::new(outlier, 0.0);
            PixelObservation { pixel, scale_px: 10.0, ..seen(landmark, 0) }
        };
        let shown = |t: usize| if t.is_multiple_of(5) && t > 0 { vec![] } else { vec![pixel(t, 1), pixel(t, 4)] };
        let pixels = (0..15).map(shown).collect();
        let observations = Observations { cameras: vec![camera], points: vec![vec![]; 15], pixels };
        let averaged = averaged(model, &observations, &state, 5);
        assert_eq!(averaged.points.len(), 3);
        for (k, frame) in averaged.pixels.iter().enumerate() {
            assert_eq!(frame.iter().map(|pixel| pixel.landmark).collect::<Vec<_>>(), [1, 4]);
            for pixel in frame {
                let off = pixel.pixel - place(5 * k, pixel.landmark) - error;
                assert!(off.norm() < 1e-9 && pixel.scale_px == 10.0, "{k}: {off}");
            }
        }
    }

    #[test]
    fn of_two_values_neither_is_the_middle() {
        assert_eq!([middle(vec![3.0]), middle(vec![5.0, 1.0]), middle(vec![9.0, 1.0, 2.0])], [3.0, 3.0, 2.0]);
    }
}
