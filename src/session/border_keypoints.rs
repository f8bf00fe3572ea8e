//! Keypoints at the borders of the image, where many detectors place what lies outside.

use super::recording::{Detection, Keypoint, Session, View};
use nalgebra::Vector2;
use std::borrow::Cow;

/// Width of the strips along a border, of a person's apparent size: three standard deviations of a good detector.
const STRIP: f64 = 0.03;

/// Keypoints pile up at a border where its strip has this many times as many as the next one, and [`MIN_PILED`] more. The strips of
/// real detections have 2 to 23 times as many at borders where people are cut off, and a third to all as many at others.
const PILED: usize = 2;
/// See [`PILED`].
const MIN_PILED: usize = 20;

/// Left, right, upper and lower border.
type ByBorder<T> = [T; 4];

/// The session without the keypoints at borders where keypoints pile up.
///
/// Where a person is cut off by the border, a detector that answers for every joint sets those outside beside it. They agree with
/// each other from frame to frame, so that no robust cost leaves them out.
pub fn without_border_keypoints(mut session: Cow<'_, Session>) -> Cow<'_, Session> {
    let n_keypoints = session.convention.names().len();
    for v in 0..session.views.len() {
        let piled = piled_borders(&session.views[v], n_keypoints);
        if piled.contains(&true) {
            let view = &mut session.to_mut().views[v];
            let n_left_out = leave_out(view, piled, n_keypoints);
            tracing::info!(camera = view.id, n_left_out, "keypoints that pile up at the image's borders are left out");
        }
    }
    session
}

/// The borders at which the keypoints of a view pile up. Where more lie beyond than beside one, the image does not end there.
fn piled_borders(view: &View, n_keypoints: usize) -> ByBorder<bool> {
    let mut counts: ByBorder<[usize; 3]> = [[0; 3]; 4];
    for detection in view.frames.iter().flatten() {
        let strip = STRIP * detection.size_px(n_keypoints);
        for keypoint in detection.keypoints[..n_keypoints].iter().filter(|keypoint| keypoint.is_present()) {
            for (counts, distance) in counts.iter_mut().zip(distances(view, &keypoint.pixel)) {
                counts[0] += usize::from(distance.abs() < strip);
                counts[1] += usize::from((strip..2.0 * strip).contains(&distance));
                counts[2] += usize::from(distance <= -strip);
            }
        }
    }
    counts.map(|[at_border, inside, beyond]| at_border > PILED * inside + MIN_PILED && at_border > beyond)
}

/// Takes out the keypoints in the strips of some borders; returns their number.
fn leave_out(view: &mut View, piled: ByBorder<bool>, n_keypoints: usize) -> usize {
    let mut frames = std::mem::take(&mut view.frames);
    let mut n_left_out = 0;
    for detection in frames.iter_mut().flatten() {
        let strip = STRIP * detection.size_px(n_keypoints);
        let is_at_border = |keypoint: &Keypoint| {
            let distances = distances(view, &keypoint.pixel).into_iter().zip(piled);
            keypoint.is_present()
                && distances.into_iter().any(|(distance, is_piled)| is_piled && distance.abs() < strip)
        };
        let Detection { keypoints, .. } = detection;
        for keypoint in keypoints.iter_mut().filter(|keypoint| is_at_border(keypoint)) {
            *keypoint = Keypoint::MISSING;
            n_left_out += 1;
        }
    }
    view.frames = frames;
    n_left_out
}

/// Distances of a pixel from the borders, px, negative outside.
fn distances(view: &View, pixel: &Vector2<f64>) -> ByBorder<f64> {
    let [last_column, last_row] = [view.intrinsics.width, view.intrinsics.height].map(|n| f64::from(n) - 1.0);
    [pixel.x, last_column - pixel.x, pixel.y, last_row - pixel.y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::Intrinsics;
    use crate::session::recording::FrameIndex;

    const N_FRAMES: usize = 30;

    /// A person 400 px high, with both ankles at `ankles(frame)` px above the last row of the image.
    fn session(ankles: impl Fn(usize) -> f64) -> Session {
        let convention = KeypointConvention::Coco17;
        let detection = |frame: usize| {
            let y = |k: usize| if k >= 15 { 719.0 - ankles(frame) } else { 300.0 + 20.0 * k as f64 };
            let keypoints = (0..17).map(|k| Keypoint::new(Vector2::new(600.0, y(k)), 0.5)).collect();
            Detection { track_id: None, keypoints }
        };
        let view = View {
            id: "c0".to_owned(),
            intrinsics: Intrinsics::PLAIN,
            has_intrinsics: true,
            camera_from_world: None,
            time_offset: 0.0,
            frames: (0..N_FRAMES).map(|frame| vec![detection(frame)]).collect(),
            delivered: (0..N_FRAMES).map(FrameIndex).collect(),
        };
        let (name, views) = (String::new(), vec![view]);
        let (dense, up_axis, start_timecode) = (None, None, None);
        Session {
            name,
            fps: 25.0,
            first_frame: 0,
            n_frames: N_FRAMES,
            dense,
            convention,
            up_axis,
            start_timecode,
            views,
        }
    }

    fn n_present(session: &Session) -> usize {
        let keypoints = session.views[0].frames.iter().flatten().flat_map(|detection| &detection.keypoints);
        keypoints.filter(|keypoint| keypoint.is_present()).count()
    }

    #[test]
    fn feet_below_the_image_were_taken_for_feet_at_its_border() {
        let cut_off = session(|frame| [2.0, 8.0, 5.0][frame % 3]);
        assert_eq!(n_present(&without_border_keypoints(Cow::Owned(cut_off))), 15 * N_FRAMES);
        let walking = session(|frame| 1.5 * frame as f64);
        assert!(matches!(without_border_keypoints(Cow::Borrowed(&walking)), Cow::Borrowed(_)));
    }

    #[test]
    fn heads_were_left_out_where_the_size_of_images_was_wrong() {
        let mut of_smaller_images = session(|frame| 1.5 * frame as f64);
        of_smaller_images.views[0].intrinsics.height = 301;
        assert!(matches!(without_border_keypoints(Cow::Borrowed(&of_smaller_images)), Cow::Borrowed(_)));
    }
}
