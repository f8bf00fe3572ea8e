//! Cameras and people while a session is still being solved, for people who wait for its result.
//!
//! A scene never enters the result: a solve that is watched gives the same bytes as one that is not.

use crate::geometry::Rigid;
use crate::session::formats::{LensFields, entries, rounded, rows};
use crate::session::recording::{FrameIndex, UpAxis};
use crate::session::{JointTrajectory, Session};
use nalgebra::Vector3;
use serde::Serialize;

/// Most points of a scene, over all frames, people and keypoints: some 400 kB of JSON.
const MAX_POINTS: usize = 20_000;

/// Most frames of a scene.
const MAX_FRAMES: usize = 240;

/// Cameras and people before their scale, their bodies and the last adjustments are known.
#[derive(Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct ProvisionalScene {
    /// The stage that found it.
    pub stage: &'static str,
    /// Unit of positions: metres, as far as limb lengths show.
    units: &'static str,
    /// Up axis of the world: `x`, `y` or `z`.
    #[cfg_attr(feature = "service", schema(value_type = String))]
    up_axis: UpAxis,
    /// Frames per second of the session.
    fps: f64,
    /// All cameras.
    cameras: Vec<ProvisionalCamera>,
    /// Names of the keypoints.
    #[cfg_attr(feature = "service", schema(value_type = Vec<String>))]
    keypoint_names: &'static [&'static str],
    /// Numbers of the frames that are shown: every n-th of the session.
    frames: Vec<i64>,
    /// People found so far. The result can number them in another way.
    people: Vec<ProvisionalPerson>,
}

/// One camera.
#[derive(Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct ProvisionalCamera {
    /// Name in the session.
    id: String,
    #[serde(flatten)]
    lens: LensFields,
    /// `x_camera = R x_world + t`; null for a camera that is not placed yet.
    #[serde(rename = "R")]
    rotation: Option<[[f64; 3]; 3]>,
    /// See `R`.
    #[serde(rename = "t")]
    translation: Option<[f64; 3]>,
    /// Centre of the camera.
    position: Option<[f64; 3]>,
}

/// One person.
#[derive(Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct ProvisionalPerson {
    /// Number of the person, until the result.
    id: usize,
    /// For each shown frame a point for each keypoint, rounded to millimetres; null where the person or the point is unknown.
    points: Vec<Option<Vec<Option<[f64; 3]>>>>,
}

impl ProvisionalScene {
    /// The scene of `cameras` (`camera_from_world` per view) and `people`, in the world of the result with metres as unit.
    pub fn new(
        stage: &'static str,
        session: &Session,
        cameras: &[Option<Rigid>],
        people: &[JointTrajectory],
        up_axis: UpAxis,
    ) -> Self {
        let names = session.convention.names();
        let stride = stride(session.n_frames, people.len() * names.len());
        let frames: Vec<FrameIndex> = (0..session.n_frames).step_by(stride).map(FrameIndex).collect();
        Self {
            stage,
            units: "m",
            up_axis,
            fps: session.fps,
            cameras: session
                .views
                .iter()
                .zip(cameras)
                .map(|(view, pose)| ProvisionalCamera {
                    id: view.id.clone(),
                    lens: LensFields::of(&view.intrinsics),
                    rotation: pose.map(|pose| rows(&pose.rotation)),
                    translation: pose.map(|pose| entries(&pose.translation)),
                    position: pose.map(|pose| entries(&pose.center())),
                })
                .collect(),
            keypoint_names: names,
            frames: frames.iter().map(|&frame| session.frame_number(frame)).collect(),
            people: people
                .iter()
                .map(|person| ProvisionalPerson {
                    id: person.person.0,
                    points: frames.iter().map(|&frame| points_at(person, frame)).collect(),
                })
                .collect(),
        }
    }
}

/// Every `stride`-th frame is shown, so that neither limit is exceeded.
fn stride(n_frames: usize, points_per_frame: usize) -> usize {
    let n_shown = (MAX_POINTS / points_per_frame.max(1)).clamp(1, MAX_FRAMES);
    n_frames.div_ceil(n_shown).max(1)
}

/// `None` where no point of the person is known.
fn points_at(person: &JointTrajectory, frame: FrameIndex) -> Option<Vec<Option<[f64; 3]>>> {
    let points = person.points.get(frame.0.checked_sub(person.first.0)?)?;
    points.iter().any(Option::is_some).then(|| points.iter().map(|point| point.as_ref().map(to_millimetres)).collect())
}

fn to_millimetres(point: &Vector3<f64>) -> [f64; 3] {
    entries(point).map(|metres| rounded(metres, 3))
}

/// Who wants to see provisional scenes.
#[derive(Clone, Copy, Default)]
pub struct Watcher<'a>(Option<&'a dyn Fn(ProvisionalScene)>);

impl<'a> Watcher<'a> {
    /// No watcher: no scene is made.
    pub fn none() -> Self {
        Self(None)
    }

    /// Calls `show` with every scene, on the thread that solves.
    pub fn new(show: &'a dyn Fn(ProvisionalScene)) -> Self {
        Self(Some(show))
    }

    /// Makes a scene if it is wanted.
    pub(super) fn show(&self, scene: impl FnOnce() -> ProvisionalScene) {
        if let Self(Some(show)) = self {
            show(scene());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::PersonId;

    #[test]
    fn long_takes_are_shown_by_every_nth_frame() {
        for (n_frames, points_per_frame) in
            [(1, 17), (240, 17), (301, 4 * 26), (100_000, 8 * 133), (10, 1_000_000), (0, 0)]
        {
            let stride = stride(n_frames, points_per_frame);
            let shown = (0..n_frames).step_by(stride).count();
            assert!(
                shown <= MAX_FRAMES && (shown * points_per_frame <= MAX_POINTS || shown == 1),
                "{n_frames}: {shown}"
            );
            assert!(
                n_frames < 2
                    || stride == 1
                    || 2 * shown * points_per_frame.max(1) > MAX_POINTS / 2
                    || 2 * shown > MAX_FRAMES / 2
            );
        }
    }

    #[test]
    fn frames_without_the_person_are_null() {
        let at = |x: f64| vec![Some(Vector3::new(x, 0.12345, -2.0)), None];
        let person = JointTrajectory {
            person: PersonId(3),
            first: FrameIndex(2),
            points: vec![at(1.0), vec![None, None]],
            n_views: vec![vec![2, 0], vec![0, 0]],
        };
        let points: Vec<_> = (0..5).map(|frame| points_at(&person, FrameIndex(frame))).collect();
        assert_eq!(points[2], Some(vec![Some([1.0, 0.123, -2.0]), None]));
        assert!([0, 1, 3, 4].iter().all(|&frame: &usize| points[frame].is_none()));
    }
}
