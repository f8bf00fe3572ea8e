//! What is unknown: which points of each instant have enough evidence, and where everything stands in the system.

use super::{AdjustmentInput, Bone, CameraFreedom, Instant, Observation};
use crate::optim::arrow::elimination_order;
use std::collections::{BTreeMap, BTreeSet};

/// A camera seen by fewer points than this cannot move by its own evidence: six unknowns, and some to spare.
const MIN_SIGHTINGS: usize = 8;

/// One instant, ready for the solver.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Variables {
    /// Index into the input's instants' persons, dense.
    pub(super) person: usize,
    pub(super) frame: usize,
    /// Keypoints that are unknown, in order of elimination; a slot is a position in this list.
    pub(super) keypoints: Vec<usize>,
    pub(super) detections: Vec<NormalizedDetection>,
    pub(super) limbs: Vec<Limb>,
    /// Border unknowns that the instant touches.
    pub(super) columns: Vec<usize>,
}

/// An observation of an unknown point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NormalizedDetection {
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

/// Where the border's unknowns stand: `[6 to 8 per moving camera | bone lengths by person]`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// First unknown of each moving camera.
    pub(super) camera_columns: Vec<Option<usize>>,
    /// 6 for the pose, 1 more for each of the next two.
    pub(super) per_camera: usize,
    /// Place of the focal factor's logarithm among a camera's unknowns, where it is one.
    pub(super) focal: Option<usize>,
    /// Place of the delay.
    pub(super) delay: Option<usize>,
    /// First bone length.
    pub(super) first_length: usize,
    /// The persons, in the order of their lengths.
    pub(super) persons: Vec<usize>,
    pub(super) n_bones: usize,
    pub(super) n_border: usize,
}

/// Sorts out what can be adjusted. Views that cannot be used are cleared from `placed`.
pub(super) fn choose(input: &AdjustmentInput, placed: &mut [bool]) -> (Layout, Vec<Variables>) {
    let bones: Vec<Bone> =
        input.bones.iter().copied().filter(|b| b.a != b.b && b.sigma > 0.0 && b.sigma.is_finite()).collect();
    let n_keypoints = input.instants.iter().map(|i| i.points.len()).max().unwrap_or(0);
    let order = elimination_order(n_keypoints, bones.iter().map(|b| (b.a, b.b)));
    let mut supported = supported_keypoints(input, &bones, placed);
    if input.camera_freedom == CameraFreedom::Adjusted {
        // Without a camera some points lose their support, and without these perhaps another camera.
        while drop_weak_views(input, &supported, placed) {
            supported = supported_keypoints(input, &bones, placed);
        }
    }
    let layout = layout(input, &bones, placed);
    let dense: BTreeMap<usize, usize> = layout.persons.iter().enumerate().map(|(i, &p)| (p, i)).collect();
    let variables = input
        .instants
        .iter()
        .zip(&supported)
        .map(|(instant, supported)| {
            let keypoints = order.iter().copied().filter(|k| supported.contains(k)).collect();
            variables(instant, dense[&instant.person], keypoints, &bones, placed, &layout)
        })
        .collect();
    (layout, variables)
}

/// The observations of an instant that say something: of a placed view, of a point with a start, finite.
fn usable<'a>(instant: &'a Instant, placed: &'a [bool]) -> impl Iterator<Item = &'a Observation> {
    instant.observations.iter().filter(|o| {
        let has_start =
            instant.points.get(o.keypoint).is_some_and(|p| p.is_some_and(|p| p.iter().all(|x| x.is_finite())));
        let is_seen = placed.get(o.view) == Some(&true);
        let is_sound =
            o.pixel.iter().chain(&o.velocity).all(|x| x.is_finite()) && o.sigma_px > 0.0 && o.sigma_px.is_finite();
        has_start && is_seen && is_sound
    })
}

/// Per instant: the points seen by two views, and those seen by one and held by a bone to a supported one.
///
/// Anything less would leave a direction free, and the point anywhere along it.
fn supported_keypoints(input: &AdjustmentInput, bones: &[Bone], placed: &[bool]) -> Vec<BTreeSet<usize>> {
    let of_instant = |instant: &Instant| {
        let mut views: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        usable(instant, placed).for_each(|o| {
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
    input.instants.iter().map(of_instant).collect()
}

/// Clears the views that see too few supported points; whether there were any.
fn drop_weak_views(input: &AdjustmentInput, supported: &[BTreeSet<usize>], placed: &mut [bool]) -> bool {
    let mut counts = vec![0; placed.len()];
    for (instant, supported) in input.instants.iter().zip(supported) {
        usable(instant, placed).filter(|o| supported.contains(&o.keypoint)).for_each(|o| counts[o.view] += 1);
    }
    let weak: Vec<usize> = (0..placed.len()).filter(|&v| placed[v] && counts[v] < MIN_SIGHTINGS).collect();
    weak.iter().for_each(|&v| placed[v] = false);
    !weak.is_empty()
}

fn layout(input: &AdjustmentInput, bones: &[Bone], placed: &[bool]) -> Layout {
    let focal = input.refine_focal.then_some(6);
    let delay = input.refine_delays.then_some(6 + usize::from(input.refine_focal));
    let per_camera = 6 + usize::from(input.refine_focal) + usize::from(input.refine_delays);
    let mut first_length = 0;
    let mut column_of = |&is_placed: &bool| {
        (is_placed && input.camera_freedom == CameraFreedom::Adjusted).then(|| {
            first_length += per_camera;
            first_length - per_camera
        })
    };
    let camera_columns = placed.iter().map(&mut column_of).collect();
    let persons: Vec<usize> = input.instants.iter().map(|i| i.person).collect::<BTreeSet<_>>().into_iter().collect();
    let n_border = first_length + persons.len() * bones.len();
    Layout { camera_columns, per_camera, focal, delay, first_length, persons, n_bones: bones.len(), n_border }
}

fn variables(
    instant: &Instant,
    person: usize,
    keypoints: Vec<usize>,
    bones: &[Bone],
    placed: &[bool],
    layout: &Layout,
) -> Variables {
    let slot_of = |keypoint: usize| keypoints.iter().position(|&k| k == keypoint);
    let mut columns = Vec::new();
    let mut place_of_view = vec![None; layout.camera_columns.len()];
    let mut detections = Vec::new();
    for &observation in usable(instant, placed) {
        let Some(slot) = slot_of(observation.keypoint) else { continue };
        let column = layout.camera_columns[observation.view].map(|first| {
            *place_of_view[observation.view].get_or_insert_with(|| {
                columns.extend(first..first + layout.per_camera);
                columns.len() - layout.per_camera
            })
        });
        detections.push(NormalizedDetection { slot, observation, column });
    }
    let mut limbs = Vec::new();
    for (index, bone) in bones.iter().enumerate() {
        let (Some(slot_a), Some(slot_b)) = (slot_of(bone.a), slot_of(bone.b)) else { continue };
        let length = person * layout.n_bones + index;
        limbs.push(Limb { slot_a, slot_b, sigma: bone.sigma, length, column: columns.len() });
        columns.push(layout.first_length + length);
    }
    Variables { person, frame: instant.frame, keypoints, detections, limbs, columns }
}
