//! Left and right exchanged in one camera whose pose is right: the people of the other cameras fit its detections better the
//! other way round.

use crate::body::detector_profile::DETECTOR;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Rigid;
use crate::geometry::projection::project_normalized;
use crate::matching::normalized::{NormalizedDetection, NormalizedView};
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::{Vector2, Vector3};

/// A detection decides where one order of its pairs is this much nearer than the other: a person seen from the side fits both.
const DECIDED: f64 = 0.6;

/// Share of a camera's deciding detections that fit the other way round, and of those deciding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exchange {
    /// Number of deciding detections.
    pub n: usize,
    /// Share of them that fit the other way round, 0 to 1.
    pub exchanged: f64,
}

/// Compares a camera's detections of known people with both orders of left and right.
pub fn exchange(
    convention: KeypointConvention,
    view: usize,
    detections: &NormalizedView,
    camera: &Rigid,
    tracks: &[PersonTrack],
    people: &[JointTrajectory],
) -> Exchange {
    let twins = convention.mirror();
    let (mut n, mut n_exchanged) = (0, 0);
    for (track, person) in tracks.iter().zip(people) {
        for (t, (assigned, points)) in track.detections.iter().zip(&person.points).enumerate() {
            let Some(detection) = assigned[view].and_then(|d| detections.frames[track.first.0 + t].get(d)) else {
                continue;
            };
            let Some((given, other)) = distances(&twins, detection, camera, points) else { continue };
            if given.min(other) < DECIDED * given.max(other) {
                n += 1;
                n_exchanged += usize::from(other < given);
            }
        }
    }
    Exchange { n, exchanged: n_exchanged as f64 / n.max(1) as f64 }
}

/// Mean distance of paired keypoints from the person as given and the other way round; `None` with fewer than four.
fn distances(
    twins: &[usize],
    detection: &NormalizedDetection,
    camera: &Rigid,
    points: &[Option<Vector3<f64>>],
) -> Option<(f64, f64)> {
    let expected =
        |k: usize| -> Option<Vector2<f64>> { Some(project_normalized(camera, points.get(k)?.as_ref()?)?.normalized) };
    let (mut given, mut other, mut n) = (0.0, 0.0, 0);
    for (k, &twin) in twins.iter().enumerate().filter(|(k, twin)| k != *twin) {
        if detection.confidence[k] < DETECTOR.confident {
            continue;
        }
        let Some((here, there)) = expected(k).zip(expected(twin)) else { continue };
        given += (detection.normalized[k] - here).norm();
        other += (detection.normalized[k] - there).norm();
        n += 1;
    }
    (n >= 4).then(|| (given / f64::from(n), other / f64::from(n)))
}
