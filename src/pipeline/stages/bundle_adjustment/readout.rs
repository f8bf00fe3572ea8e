//! Results read from a state: misfits, observed views, points and bone lengths.

use super::problem::Problem;
use super::variables::State;
use crate::pipeline::keyframe::Keyframe;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Distance of an observation from its reprojection; infinite where the point is behind the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Misfit {
    pub(super) view: usize,
    pub(super) distance_px: f64,
    pub(super) sigmas: f64,
}

impl Problem<'_> {
    /// Misfit of every observation.
    pub(super) fn misfits<'s>(&'s self, state: &'s State) -> impl Iterator<Item = Misfit> + 's {
        self.variables.iter().zip(&state.points).flat_map(move |(variables, points)| {
            variables.observations.iter().filter_map(move |observed| {
                let o = &observed.observation;
                let camera = state.cameras[o.view].as_ref()?;
                let point = camera.camera_from_world.transform(&points[observed.slot]);
                let predicted = camera.intrinsics.pixel_from_camera(&point);
                let distance_px =
                    predicted.map_or(f64::INFINITY, |p| (p - o.pixel_without(camera.delay_at(variables.time))).norm());
                Some(Misfit { view: o.view, distance_px, sigmas: distance_px / o.sigma_px })
            })
        })
    }

    /// Per view, whether any observation lies within the robust scale.
    pub(super) fn observed_views(&self, state: &State) -> Vec<bool> {
        let mut observed = vec![false; state.cameras.len()];
        let explained = self.misfits(state).filter(|misfit| misfit.sigmas <= self.robust_scale);
        explained.for_each(|misfit| observed[misfit.view] = true);
        observed
    }

    /// Points in the input's shape; points that were not adjusted keep their start.
    pub(super) fn points_by_keypoint(&self, keyframes: &[Keyframe], state: &State) -> Vec<Vec<Option<Vector3<f64>>>> {
        let mut points: Vec<_> = keyframes.iter().map(|k| k.points.clone()).collect();
        for ((points, variables), adjusted) in points.iter_mut().zip(&self.variables).zip(&state.points) {
            for (&keypoint, point) in variables.keypoints.iter().zip(adjusted) {
                points[keypoint] = Some(*point);
            }
        }
        points
    }

    /// Bone lengths per person and bone.
    pub(super) fn bone_lengths(&self, state: &State) -> BTreeMap<usize, Vec<Option<f64>>> {
        let n_bones = self.layout.n_bones;
        let mut lengths: BTreeMap<_, _> = self.layout.persons.iter().map(|&p| (p, vec![None; n_bones])).collect();
        for variables in &self.variables {
            if let Some(of_person) = lengths.get_mut(&self.layout.persons[variables.person]) {
                for limb in &variables.limbs {
                    of_person[limb.length % n_bones] = Some(state.log_lengths[limb.length].exp());
                }
            }
        }
        lengths
    }
}
