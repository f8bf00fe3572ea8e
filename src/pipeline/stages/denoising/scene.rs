//! One frame: what every view shows, and where everybody is expected.

use super::{DenoisingInput, Place};
use crate::geometry::Rigid;
use crate::geometry::projection::{NormalizedProjection, project_normalized};
use crate::matching::consistency::Seen;
use crate::matching::normalized::NormalizedView;

/// One frame of the take.
pub(super) struct Scene<'a> {
    pub frame: usize,
    /// Who is expected there: indices of the tracks.
    pub present: Vec<usize>,
    /// What every view shows of it.
    pub views: Vec<SceneView<'a>>,
}

/// One frame by one view; empty where the camera has no place.
pub(super) struct SceneView<'a> {
    /// By detection.
    pub seen: Vec<Seen<'a>>,
    /// By person present: their points as the camera should see them.
    pub expected: Vec<Vec<Option<NormalizedProjection>>>,
}

impl<'a> Scene<'a> {
    pub(super) fn at(input: &DenoisingInput<'a>, frame: usize) -> Self {
        let points = |person: &usize| {
            let path = &input.paths[*person];
            path.points.get(frame.checked_sub(path.first.0)?)
        };
        let present: Vec<usize> = (0..input.tracks.len()).filter(|p| points(p).is_some()).collect();
        let of_view = |(camera, view): (&'a Option<Rigid>, &'a NormalizedView)| {
            let Some(camera) = camera else {
                return SceneView { seen: Vec::new(), expected: vec![Vec::new(); present.len()] };
            };
            let projected =
                |points: &Vec<Option<_>>| points.iter().map(|p| project_normalized(camera, p.as_ref()?)).collect();
            SceneView {
                seen: view.frames[frame].iter().map(|s| Seen::new(camera, s, input.noise)).collect(),
                expected: present.iter().filter_map(points).map(projected).collect(),
            }
        };
        let views = input.cameras.iter().zip(input.views).map(of_view).collect();
        Self { frame, present, views }
    }

    pub(super) fn seen(&self, at: Place) -> &Seen<'a> {
        &self.views[at.view].seen[at.detection]
    }
}
