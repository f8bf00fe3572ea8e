//! One frame: the detections of every view and the expected projections of every person.

use super::context::{Context, DetectionIndex};
use crate::geometry::Rigid;
use crate::geometry::projection::{NormalizedProjection, project_normalized};
use crate::matching::consistency::PosedDetection;
use crate::matching::normalized::NormalizedView;

/// One frame of the recording.
pub(super) struct FrameView<'a> {
    pub frame: usize,
    /// Persons expected in the frame: indices of the tracks.
    pub present: Vec<usize>,
    /// Per view.
    pub views: Vec<ViewOfFrame<'a>>,
}

/// One frame of a single view; empty where the camera is not placed.
pub(super) struct ViewOfFrame<'a> {
    /// Per detection.
    pub seen: Vec<PosedDetection<'a>>,
    /// Per expected person: the projected points.
    pub expected: Vec<Vec<Option<NormalizedProjection>>>,
}

impl<'a> FrameView<'a> {
    pub(super) fn new(context: &Context<'a>, frame: usize) -> Self {
        let input = context.input;
        let points = |person: &usize| {
            let trajectory = &input.points[*person];
            trajectory.points.get(frame.checked_sub(trajectory.first.0)?)
        };
        let present: Vec<usize> = (0..input.tracks.len()).filter(|p| points(p).is_some()).collect();
        let of_view = |(camera, view): (&'a Option<Rigid>, &'a NormalizedView)| {
            let Some(camera) = camera else {
                return ViewOfFrame { seen: Vec::new(), expected: vec![Vec::new(); present.len()] };
            };
            let projected =
                |points: &Vec<Option<_>>| points.iter().map(|p| project_normalized(camera, p.as_ref()?)).collect();
            ViewOfFrame {
                seen: view.frames[frame].iter().map(|s| PosedDetection::new(camera, s, input.noise)).collect(),
                expected: present.iter().filter_map(points).map(projected).collect(),
            }
        };
        let views = input.cameras.iter().zip(context.views).map(of_view).collect();
        Self { frame, present, views }
    }

    pub(super) fn seen(&self, at: DetectionIndex) -> &PosedDetection<'a> {
        &self.views[at.view].seen[at.detection]
    }
}
