//! Other readings of a camera's files: under each the camera is registered anew by the people that the other cameras see, and
//! judged by the share of its detections that these people then explain.
//!
//! Three points give a pose, and a person has a dozen in each frame: a wrong reading explains few of them, so one that explains
//! about as much as is usual in the other cameras is the right one. The pose is found on one person in a part of the frames and
//! judged on all people in all frames.

use super::agreement::{explained_share, skeleton};
use crate::body::detector_profile::DETECTOR;
use crate::estimation::pnp::estimate_pose;
use crate::geometry::Rigid;
use crate::matching::normalized::{NormalizedDetection, NormalizedView};
use crate::matching::tracklets::Tracklet;
use crate::pipeline::camera_clock::MAX_OFFSET_SECS;
use crate::session::{Detection, JointTrajectory, Session, View};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// A way to read the files of one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// As they are.
    AsGiven,
    /// Images are mirrored; the same as y counted upwards in an image that is upside down.
    Mirrored,
    /// Left and right keypoints are exchanged.
    LabelsExchanged,
    /// Frame numbers are this many too high.
    Late(i64),
    /// The focal length is this many times the given one.
    FocalFactor(f64),
}

use Reading as R;

/// Focal lengths that are tried: a tolerance of ten per cent reaches from one to the next.
const FOCAL_FACTORS: [f64; 8] = [0.5, 0.6, 0.7, 0.83, 1.2, 1.4, 1.67, 2.0];

/// Delays that are tried first, s: of cameras that were started together; longer ones where no other reading explains [`EXPLAINS`]. And
/// the spacing of their search, in which people move less than a keypoint's tolerance.
const NEAR_SECS: f64 = 0.5;
const STEP_SECS: f64 = 0.1;
const EXPLAINS: f64 = 0.6;

/// Tracklets and persons that are compared, the longest first, and points of one comparison.
const N_TRACKLETS: usize = 4;
const N_PEOPLE: usize = 5;
const MAX_POINTS: usize = 150;
/// Fewer points than this do not identify a person.
const MIN_POINTS: usize = 40;
/// Reprojection error from which a point has no weight, rad: 10 px at a focal length of 1,060 px, of people at 4 m or farther.
const TOLERANCE: f64 = 0.01;
/// Samples of three points: a sixth of outlier-free points is found with 99 %, and the right person has half.
const SAMPLES: usize = 100;
/// Share of points that must agree with a pose: chance poses of another person reach a third.
const MIN_INLIERS: f64 = 0.45;
/// Poses that are judged on all people and frames.
const N_JUDGED: usize = 2;

/// A reading with the share of detections that it explains.
#[derive(Debug, Clone, Copy)]
pub struct Judged {
    /// The reading.
    pub reading: Reading,
    /// Share of the camera's confident keypoints near a person, 0 to 1.
    pub explained: f64,
}

/// The people of the other cameras, and a camera whose files are in question.
pub struct Question<'a> {
    /// The recording as given.
    pub session: &'a Session,
    /// Index of the camera.
    pub view: usize,
    /// People followed in its images.
    pub tracklets: &'a [Tracklet],
    /// Points of all persons.
    pub people: &'a [JointTrajectory],
    /// Its pose where it has one.
    pub camera: Option<&'a Rigid>,
    /// Seed of random samples.
    pub seed: u64,
}

impl Question<'_> {
    /// The files as they are, the best of the other readings, and the best of the factors on the focal length.
    pub fn judged(&self) -> [Judged; 3] {
        let view = read(self.session, self.view, R::AsGiven);
        let given = self.judged_under(&view, R::AsGiven);
        let [mirrored, exchanged] = [R::Mirrored, R::LabelsExchanged].map(|reading| self.under(reading));
        let frames = |secs: f64| ((secs * self.session.fps) as i64).min(self.session.n_frames as i64 / 2);
        let near = self.latest(&view, 0, frames(NEAR_SECS));
        let mut other = best([mirrored, exchanged, near]);
        if best([given, other]).explained < EXPLAINS {
            other = best([other, self.latest(&view, frames(NEAR_SECS), frames(MAX_OFFSET_SECS))]);
        }
        [given, other, best(FOCAL_FACTORS.map(|factor| self.under(R::FocalFactor(factor))))]
    }

    /// The best delay of more than `least` and up to `most` frames, either way.
    fn latest(&self, view: &NormalizedView, least: i64, most: i64) -> Judged {
        let step = ((STEP_SECS * self.session.fps) as i64).max(1);
        let under = |frames: Vec<i64>| {
            let judged: Vec<Judged> = frames.into_par_iter().map(|n| self.judged_under(view, R::Late(n))).collect();
            best(judged)
        };
        let coarse = (least + 1..=most).step_by(step as usize).flat_map(|n| [n, -n]).collect();
        match under(coarse) {
            first @ Judged { reading: R::Late(n), .. } => {
                best([first, under((n - step + 1..n + step).filter(|m| *m != 0 && *m != n).collect())])
            }
            none => none,
        }
    }

    fn under(&self, reading: Reading) -> Judged {
        self.judged_under(&read(self.session, self.view, reading), reading)
    }

    /// `view`: the files in this reading, at the given times.
    fn judged_under(&self, view: &NormalizedView, reading: Reading) -> Judged {
        let late = if let R::Late(n) = reading { n } else { 0 };
        let known = self.camera.filter(|_| reading == R::AsGiven);
        let poses = self.poses(view, late);
        let judged = poses.iter().chain(known).map(|pose| explained_share(view, pose, self.people, late));
        Judged { reading, explained: judged.fold(0.0, f64::max) }
    }

    /// The best supported poses.
    fn poses(&self, view: &NormalizedView, late: i64) -> Vec<Rigid> {
        let mut tracklets: Vec<&Tracklet> = self.tracklets.iter().collect();
        tracklets.sort_by_key(|tracklet| std::cmp::Reverse(tracklet.detections.len()));
        let mut people: Vec<&JointTrajectory> = self.people.iter().collect();
        people.sort_by_key(|person| std::cmp::Reverse(person.points.len()));
        let mut found = Vec::new();
        for tracklet in tracklets.into_iter().take(N_TRACKLETS) {
            let tolerance = TOLERANCE * tracklet.error_scale(view);
            for person in people.iter().take(N_PEOPLE) {
                let points = correspondences(view, tracklet, person, late);
                if points.len() >= MIN_POINTS {
                    found.extend(estimate_pose(&points, tolerance, SAMPLES, self.seed));
                }
            }
        }
        found.retain(|pose| pose.inlier_ratio >= MIN_INLIERS);
        found.sort_by(|a, b| b.support.total_cmp(&a.support));
        found.into_iter().take(N_JUDGED).map(|pose| pose.camera_from_world).collect()
    }
}

/// The first of those that explain most; the files as they are where none explains any.
fn best(readings: impl IntoIterator<Item = Judged>) -> Judged {
    let none = Judged { reading: R::AsGiven, explained: 0.0 };
    readings.into_iter().fold(none, |best, next| if next.explained > best.explained { next } else { best })
}

/// The detections of a view, read in another way.
fn read(session: &Session, view: usize, reading: Reading) -> NormalizedView {
    let given = &session.views[view];
    let intrinsics = match reading {
        R::FocalFactor(factor) => given.intrinsics.with_focal_factor(factor),
        _ => given.intrinsics,
    };
    let twins = session.mirror();
    let lens = View {
        id: String::new(),
        intrinsics,
        has_intrinsics: true,
        camera_from_world: None,
        time_offset: 0.0,
        frames: Vec::new(),
        delivered: Vec::new(),
    };
    let of_detection = |detection: &Detection| {
        let mut read = match reading {
            R::LabelsExchanged => detection.with_sides_exchanged(&twins),
            _ => detection.clone(),
        };
        if reading == R::Mirrored {
            read.keypoints.iter_mut().for_each(|k| k.pixel = intrinsics.mirrored(&k.pixel));
        }
        NormalizedDetection::from_detection(&lens, &read, twins.len())
    };
    let frames = given.frames.iter().map(|people| people.iter().map(of_detection).collect()).collect();
    NormalizedView { focal: intrinsics.focal(), frames }
}

/// Points of a person in space and their detections in a tracklet, from evenly spread frames.
fn correspondences(
    view: &NormalizedView,
    tracklet: &Tracklet,
    person: &JointTrajectory,
    late: i64,
) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    let mut points = Vec::new();
    for &(frame, detection) in &tracklet.detections {
        let skeleton = frame.checked_add_signed(-late as isize).and_then(|frame| skeleton(person, frame));
        let detection = &view.frames[frame][detection];
        for (k, point) in skeleton.into_iter().flatten().enumerate() {
            if let Some(point) = point.filter(|_| detection.confidence[k] > DETECTOR.judged) {
                points.push((point, detection.normalized[k]));
            }
        }
    }
    let stride = points.len().div_ceil(MAX_POINTS).max(1);
    points.into_iter().step_by(stride).collect()
}
