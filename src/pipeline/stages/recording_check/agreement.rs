//! How much of a camera's detections the people in space explain.

use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::geometry::projection::project_normalized;
use crate::matching::normalized::{NormalizedDetection, NormalizedView};
use crate::session::JointTrajectory;
use nalgebra::Vector2;

/// Share of the confident keypoints that lie near a person's reprojection, each detection taken as the person that explains it
/// best, 0 to 1; 0 without any.
///
/// `late`: by how many frames the camera's frame numbers are too high. Detections at times without a person do not count.
pub fn explained_share(view: &NormalizedView, camera: &Rigid, people: &[JointTrajectory], late: i64) -> f64 {
    let (mut near, mut all) = (0, 0);
    for (frame, detections) in view.frames.iter().enumerate().filter(|(_, detections)| !detections.is_empty()) {
        let Some(frame) = frame.checked_add_signed(-late as isize) else { continue };
        let projected: Vec<Vec<Option<Vector2<f64>>>> = people
            .iter()
            .filter_map(|person| skeleton(person, frame))
            .map(|points| projected(camera, points))
            .collect();
        if projected.is_empty() {
            continue;
        }
        for detection in detections {
            all += detection.confidence.iter().filter(|c| **c > DETECTOR.confident).count();
            near += projected.iter().map(|person| n_near(detection, person)).max().unwrap_or(0);
        }
    }
    near as f64 / all.max(1) as f64
}

/// A person's points in a frame.
pub(super) fn skeleton(person: &JointTrajectory, frame: usize) -> Option<&[Option<nalgebra::Vector3<f64>>]> {
    person.points.get(frame.checked_sub(person.first.0)?).map(Vec::as_slice)
}

fn projected(camera: &Rigid, points: &[Option<nalgebra::Vector3<f64>>]) -> Vec<Option<Vector2<f64>>> {
    points.iter().map(|point| Some(project_normalized(camera, point.as_ref()?)?.normalized)).collect()
}

fn n_near(detection: &NormalizedDetection, expected: &[Option<Vector2<f64>>]) -> usize {
    let radius = DETECTOR.explained_radius * detection.error_scale();
    let seen = detection.normalized.iter().zip(&detection.confidence).zip(expected);
    let confident = seen.filter(|((_, confidence), _)| **confidence > DETECTOR.confident);
    confident.filter(|((at, _), e)| e.is_some_and(|e| (e - *at).norm() < radius)).count()
}
