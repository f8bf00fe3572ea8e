//! The unknowns: which points of each keyframe have enough observations, and the columns of all unknowns in the system.

use super::input::{AdjustmentInput, Bone};
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::arrow::elimination_order;
use crate::pipeline::calibration::CameraFreedom;
use crate::pipeline::camera_clock::take_time;
use crate::pipeline::keyframe::{Keyframe, Observation};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Unknowns of a camera whose lens and delay are fixed.
pub(super) const POSE_UNKNOWNS: usize = 6;

/// Smallest number of observations of a camera that is adjusted: six unknowns, and some to spare.
const MIN_OBSERVATIONS: usize = 8;

/// One keyframe, ready for the solver.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Variables {
    /// Dense index of the person.
    pub(super) person: usize,
    pub(super) frame: usize,
    /// Place in the take, from -1 to 1, if cameras' clocks drift.
    pub(super) time: f64,
    /// Keypoints that are unknown, in order of elimination; a slot is a position in this list.
    pub(super) keypoints: Vec<usize>,
    pub(super) observations: Vec<SlotObservation>,
    pub(super) limbs: Vec<Limb>,
    /// Border unknowns that the keyframe depends on.
    pub(super) columns: Vec<usize>,
}

impl Variables {
    /// Takes the unknowns of a view's camera, `n` from its first one on, out of the keyframe's system.
    pub(super) fn hold(&mut self, view: usize, n: usize) {
        let of_view = |observed: &&SlotObservation| observed.observation.view == view;
        let Some(first) = self.observations.iter().find(of_view).and_then(|observed| observed.column) else { return };
        self.columns.drain(first..first + n);
        let moved = |column: usize| if column > first { column - n } else { column };
        for observed in &mut self.observations {
            observed.column = observed.column.filter(|_| observed.observation.view != view).map(moved);
        }
        self.limbs.iter_mut().for_each(|limb| limb.column = moved(limb.column));
    }
}

/// An observation of an unknown point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SlotObservation {
    pub(super) slot: usize,
    pub(super) observation: Observation,
    /// Where the camera's unknowns begin in [`Variables::columns`]; `None` for a held camera.
    pub(super) column: Option<usize>,
}

/// A bone between two unknown points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Limb {
    pub(super) slot_a: usize,
    pub(super) slot_b: usize,
    pub(super) sigma: f64,
    /// Index of its length in the state.
    pub(super) length: usize,
    /// Position of its length in [`Variables::columns`].
    pub(super) column: usize,
}

/// Columns of the border's unknowns: `[6 to 10 per moving camera | bone lengths by person]`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// First unknown of each moving camera.
    pub(super) camera_columns: Vec<Option<usize>>,
    /// 6 for the pose, and 1 for each of the next four that is present.
    pub(super) per_camera: usize,
    /// Index of the focal factor's logarithm among a camera's unknowns; `None` where it is fixed.
    pub(super) focal: Option<usize>,
    /// Index of the delay.
    pub(super) delay: Option<usize>,
    /// Index of the drift.
    pub(super) drift: Option<usize>,
    /// Index of the change of the first radial coefficient.
    pub(super) radial: Option<usize>,
    /// Column of the first bone length.
    pub(super) first_length: usize,
    /// The persons in the order of their bone lengths.
    pub(super) persons: Vec<usize>,
    pub(super) n_bones: usize,
    pub(super) n_border: usize,
}

/// Current values of a camera's unknowns, with the intrinsics that follow from them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CameraState {
    pub(super) intrinsics: Intrinsics,
    pub(super) log_focal: f64,
    /// In the middle of the take, frames.
    pub(super) delay: f64,
    /// Change of the delay from the middle to the end of the take, frames.
    pub(super) drift: f64,
    /// Change of the lens's first radial coefficient.
    pub(super) radial: f64,
    pub(super) camera_from_world: Rigid,
}

impl CameraState {
    /// Delay at a place in the take, from -1 to 1, frames.
    pub(super) fn delay_at(&self, time: f64) -> f64 {
        self.delay + self.drift * time
    }
}

/// All unknowns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    /// `None` for views that take no part.
    pub(super) cameras: Vec<Option<CameraState>>,
    /// [person, bone], flat.
    pub(super) log_lengths: Vec<f64>,
    /// [keyframe][slot]
    pub(super) points: Vec<Vec<Vector3<f64>>>,
}

/// Chooses the unknowns that can be adjusted. Clears views that cannot be used from `placed`.
pub(super) fn choose(input: &AdjustmentInput, placed: &mut [bool]) -> (Layout, Vec<Variables>) {
    let bones: Vec<Bone> =
        input.bones.iter().copied().filter(|b| b.a != b.b && b.sigma > 0.0 && b.sigma.is_finite()).collect();
    let n_keypoints = input.keyframes.iter().map(|i| i.points.len()).max().unwrap_or(0);
    let order = elimination_order(n_keypoints, bones.iter().map(|b| (b.a, b.b)));
    let mut supported = supported_keypoints(input, &bones, placed);
    if input.camera_freedom == CameraFreedom::Adjusted {
        // Without a camera some points lose their support, and without these another camera may.
        while drop_weak_views(input, &supported, placed) {
            supported = supported_keypoints(input, &bones, placed);
        }
    }
    let layout = layout(input, &bones, placed);
    let dense: BTreeMap<usize, usize> = layout.persons.iter().enumerate().map(|(i, &p)| (p, i)).collect();
    let variables = input
        .keyframes
        .iter()
        .zip(&supported)
        .map(|(keyframe, supported)| {
            let keypoints = order.iter().copied().filter(|k| supported.contains(k)).collect();
            let time = input.drift_over.map_or(0.0, |n_frames| take_time(keyframe.frame, n_frames));
            Variables { time, ..variables(keyframe, dense[&keyframe.person], keypoints, &bones, placed, &layout) }
        })
        .collect();
    (layout, variables)
}

/// The valid observations of a keyframe: of a placed view, of a point with a start, finite.
fn usable<'a>(keyframe: &'a Keyframe, placed: &'a [bool]) -> impl Iterator<Item = &'a Observation> {
    keyframe.observations.iter().filter(|o| {
        let has_start =
            keyframe.points.get(o.keypoint).is_some_and(|p| p.is_some_and(|p| p.iter().all(|x| x.is_finite())));
        let is_seen = placed.get(o.view) == Some(&true);
        let is_sound =
            o.pixel.iter().chain(&o.velocity).all(|x| x.is_finite()) && o.sigma_px > 0.0 && o.sigma_px.is_finite();
        has_start && is_seen && is_sound
    })
}

/// Per keyframe: the points seen by two views, and those seen by one and held by a bone to a supported one.
///
/// Anything less would leave a direction free, and the point anywhere along it.
fn supported_keypoints(input: &AdjustmentInput, bones: &[Bone], placed: &[bool]) -> Vec<BTreeSet<usize>> {
    let of_keyframe = |keyframe: &Keyframe| {
        let mut views: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        usable(keyframe, placed).for_each(|o| {
            views.entry(o.keypoint).or_default().insert(o.view);
        });
        let mut supported: BTreeSet<usize> = views.iter().filter(|(_, v)| v.len() >= 2).map(|(&k, _)| k).collect();
        loop {
            let joins = |from: usize, to: usize, supported: &BTreeSet<usize>| {
                supported.contains(&from) && views.contains_key(&to) && !supported.contains(&to)
            };
            let next = bones.iter().find_map(|b| {
                if joins(b.a, b.b, &supported) { Some(b.b) } else { joins(b.b, b.a, &supported).then_some(b.a) }
            });
            match next {
                Some(keypoint) => supported.insert(keypoint),
                None => return supported,
            };
        }
    };
    input.keyframes.iter().map(of_keyframe).collect()
}

/// Clears the views with too few observations of supported points; returns whether there were any.
fn drop_weak_views(input: &AdjustmentInput, supported: &[BTreeSet<usize>], placed: &mut [bool]) -> bool {
    let mut counts = vec![0; placed.len()];
    for (keyframe, supported) in input.keyframes.iter().zip(supported) {
        usable(keyframe, placed).filter(|o| supported.contains(&o.keypoint)).for_each(|o| counts[o.view] += 1);
    }
    let weak: Vec<usize> = (0..placed.len()).filter(|&v| placed[v] && counts[v] < MIN_OBSERVATIONS).collect();
    weak.iter().for_each(|&v| placed[v] = false);
    !weak.is_empty()
}

fn layout(input: &AdjustmentInput, bones: &[Bone], placed: &[bool]) -> Layout {
    let mut per_camera = POSE_UNKNOWNS;
    let mut place = |is_refined: bool| {
        per_camera += usize::from(is_refined);
        is_refined.then_some(per_camera - 1)
    };
    let [focal, delay] = [input.refine_focal, input.refine_delays].map(&mut place);
    let [drift, radial] = [input.drift_over.is_some(), input.refine_radial].map(&mut place);
    let mut first_length = 0;
    let mut column_of = |&is_placed: &bool| {
        (is_placed && input.camera_freedom == CameraFreedom::Adjusted).then(|| {
            first_length += per_camera;
            first_length - per_camera
        })
    };
    let camera_columns = placed.iter().map(&mut column_of).collect();
    let persons: Vec<usize> = input.keyframes.iter().map(|i| i.person).collect::<BTreeSet<_>>().into_iter().collect();
    let n_border = first_length + persons.len() * bones.len();
    Layout {
        camera_columns,
        per_camera,
        focal,
        delay,
        drift,
        radial,
        first_length,
        persons,
        n_bones: bones.len(),
        n_border,
    }
}

fn variables(
    keyframe: &Keyframe,
    person: usize,
    keypoints: Vec<usize>,
    bones: &[Bone],
    placed: &[bool],
    layout: &Layout,
) -> Variables {
    let slot_of = |keypoint: usize| keypoints.iter().position(|&k| k == keypoint);
    let mut columns = Vec::new();
    let mut column_of_view = vec![None; layout.camera_columns.len()];
    let mut observations = Vec::new();
    for &observation in usable(keyframe, placed) {
        let Some(slot) = slot_of(observation.keypoint) else { continue };
        let column = layout.camera_columns[observation.view].map(|first| {
            *column_of_view[observation.view].get_or_insert_with(|| {
                columns.extend(first..first + layout.per_camera);
                columns.len() - layout.per_camera
            })
        });
        observations.push(SlotObservation { slot, observation, column });
    }
    let mut limbs = Vec::new();
    for (index, bone) in bones.iter().enumerate() {
        let (Some(slot_a), Some(slot_b)) = (slot_of(bone.a), slot_of(bone.b)) else { continue };
        let length = person * layout.n_bones + index;
        limbs.push(Limb { slot_a, slot_b, sigma: bone.sigma, length, column: columns.len() });
        columns.push(layout.first_length + length);
    }
    Variables { person, frame: keyframe.frame, time: 0.0, keypoints, observations, limbs, columns }
}
