//! Points of the body beyond a keypoint convention, as a session brings them: a dense set of landmarks on the skin.
//!
//! A point is fixed to a few bones like every [`Landmark`]: `sum_j w_j (p_j + G_j o_j)` with the offset `o_j` from joint j in the
//! rest pose of the mean shape. How it moves with the shape is taken from the skin: as the vertex that is nearest at rest.

use super::model::{BodyModel, Landmark, LandmarkTerm, ShapeDirections};
use super::skeleton::{JOINT_NAMES, KeypointConvention, counterpart_name};
use super::surface::JointWeight;
use nalgebra::Vector3;
use sha2::{Digest, Sha256};

/// Most points of a table, those of the base convention included: three times the densest detectors.
pub const MAX_LANDMARKS: usize = 1000;

/// Deviation of the sum of a point's weights from 1 that is taken for rounding.
const WEIGHT_TOLERANCE: f64 = 1e-3;

/// Farthest that a point can lie from a joint that carries it, m: no body is larger.
const MAX_OFFSET_M: f64 = 2.5;

/// One point as a table states it.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedLandmark {
    /// Unique name.
    pub name: String,
    /// Joint, weight, and offset from the joint in the rest pose, m; empty for points that the convention has.
    pub terms: Vec<(String, f64, [f64; 3])>,
}

/// A dense set of landmarks.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseLandmarks {
    /// Name of the set.
    pub name: String,
    /// The points beyond the base convention, for the mean shape: offsets are weighted, their changes with the shape zero.
    pub landmarks: Vec<Landmark>,
    /// SHA-256 digest over all names and numbers, lower-case hex.
    pub sha256: String,
}

/// A table that has been checked.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedTable {
    /// The convention whose points are among those of the table; people are found by these.
    pub base: KeypointConvention,
    /// For every point of the table its place: those of the convention first, in its order, then the others.
    pub places: Vec<usize>,
    /// The other points; `None` where there are none.
    pub dense: Option<DenseLandmarks>,
}

/// Why a table is rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LandmarkError {
    /// Too many points.
    #[error("the table has {0} landmarks, at most {MAX_LANDMARKS} are read")]
    TooMany(usize),
    /// A name that occurs twice, or is empty.
    #[error("landmark {index} is called {name:?}: names are unique and not empty")]
    Name {
        /// Index in the table.
        index: usize,
        /// The name.
        name: String,
    },
    /// A joint that the body does not have.
    #[error("landmark {landmark:?} names the joint {joint:?}; the joints are {}", JOINT_NAMES.join(", "))]
    Joint {
        /// Name of the landmark.
        landmark: String,
        /// Name of the joint.
        joint: String,
    },
    /// Weights that do not sum to 1, or are negative.
    #[error("landmark {landmark:?}: the weights sum to {sum}; expected are weights from 0 to 1 that sum to 1")]
    Weights {
        /// Name of the landmark.
        landmark: String,
        /// Sum of its weights.
        sum: f64,
    },
    /// An offset that is too long or no number.
    #[error("landmark {landmark:?}: the offset from {joint} is {offset:?} m, expected at most {MAX_OFFSET_M} m")]
    Offset {
        /// Name of the landmark.
        landmark: String,
        /// Name of the joint.
        joint: String,
        /// The offset.
        offset: [f64; 3],
    },
    /// No convention is contained.
    #[error(
        "the table contains all points of no keypoint convention; people are found by such points, for example those of coco17"
    )]
    NoBase,
}

/// Checks a table.
///
/// Its base is the convention with most points of those that it contains whole. SMPL's joints are no base, since their names stand
/// for other points of a detector.
///
/// # Errors
/// The first fault, with landmark, value and what is expected.
pub fn checked_table(name: &str, stated: &[StatedLandmark]) -> Result<CheckedTable, LandmarkError> {
    if stated.len() > MAX_LANDMARKS {
        return Err(LandmarkError::TooMany(stated.len()));
    }
    let mut names: Vec<&str> = Vec::with_capacity(stated.len());
    for (index, landmark) in stated.iter().enumerate() {
        if landmark.name.is_empty() || names.contains(&landmark.name.as_str()) {
            return Err(LandmarkError::Name { index, name: landmark.name.clone() });
        }
        names.push(&landmark.name);
    }
    let contains = |convention: &KeypointConvention| convention.names().iter().all(|name| names.contains(name));
    let is_base = |convention: &KeypointConvention| {
        let is_body = convention.n_keypoints() == convention.names().len();
        is_body && *convention != KeypointConvention::Smpl24 && contains(convention)
    };
    let known = KeypointConvention::ALL.into_iter().filter(is_base);
    let base = known.rev().max_by_key(|convention| convention.names().len()).ok_or(LandmarkError::NoBase)?;
    let n_base = base.n_keypoints();
    let (mut places, mut landmarks, mut hash) = (Vec::with_capacity(stated.len()), Vec::new(), Sha256::new());
    hash.update(name.as_bytes());
    for landmark in stated {
        hash.update([0]);
        hash.update(landmark.name.as_bytes());
        match base.index_of(&landmark.name) {
            Some(place) => places.push(place),
            None => {
                places.push(n_base + landmarks.len());
                landmarks.push(checked_landmark(landmark, &mut hash)?);
            }
        }
    }
    let sha256 = hex::encode(hash.finalize());
    let dense = (!landmarks.is_empty()).then(|| DenseLandmarks { name: name.to_owned(), landmarks, sha256 });
    Ok(CheckedTable { base, places, dense })
}

fn checked_landmark(stated: &StatedLandmark, hash: &mut Sha256) -> Result<Landmark, LandmarkError> {
    let landmark = || stated.name.clone();
    // The sum of no numbers would be -0.
    let sum = stated.terms.iter().fold(0.0, |sum, (_, weight, _)| sum + weight);
    let is_share = |(_, weight, _): &(String, f64, [f64; 3])| (0.0..=1.0 + WEIGHT_TOLERANCE).contains(weight);
    if !(sum - 1.0).abs().le(&WEIGHT_TOLERANCE) || !stated.terms.iter().all(is_share) {
        return Err(LandmarkError::Weights { landmark: landmark(), sum });
    }
    let mut terms = Vec::with_capacity(stated.terms.len());
    for (joint, weight, offset) in &stated.terms {
        let place = JOINT_NAMES.iter().position(|name| name == joint);
        let place = place.ok_or_else(|| LandmarkError::Joint { landmark: landmark(), joint: joint.clone() })?;
        let vector = Vector3::from(*offset);
        if !vector.norm().le(&MAX_OFFSET_M) {
            return Err(LandmarkError::Offset { landmark: landmark(), joint: joint.clone(), offset: *offset });
        }
        hash.update((place as u64).to_le_bytes());
        let weight = weight / sum;
        std::iter::once(&weight).chain(offset).for_each(|number| hash.update(number.to_le_bytes()));
        let offset_directions = ShapeDirections::zeros();
        terms.push(LandmarkTerm { joint: place, weight, offset: vector * weight, offset_directions });
    }
    Ok(Landmark { name: landmark(), terms })
}

impl DenseLandmarks {
    /// Names of the points, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.landmarks.iter().map(|landmark| landmark.name.as_str())
    }

    /// For every point its counterpart on the other side, by `left_` and `right_` in the names; itself where it has none.
    pub fn mirror(&self) -> Vec<usize> {
        let place = |name: &str| self.names().position(|other| other == name);
        self.names()
            .enumerate()
            .map(|(k, name)| counterpart_name(name).and_then(|other| place(&other)).unwrap_or(k))
            .collect()
    }

    /// The model with these points behind its own landmarks.
    pub fn on(&self, model: &BodyModel) -> BodyModel {
        let moved = |landmark: &Landmark| with_shape(landmark, model);
        let landmarks = model.landmarks.iter().cloned().chain(self.landmarks.iter().map(moved)).collect();
        BodyModel { landmarks, ..model.clone() }
    }

    /// Their places among the landmarks of a model; `None` where the model is without them.
    pub fn places(&self, model: &BodyModel) -> Vec<Option<usize>> {
        let first = model.landmarks.len().checked_sub(self.landmarks.len());
        let is_last = |first: &usize| {
            let last = model.landmarks[*first..].iter().map(|landmark| landmark.name.as_str());
            last.eq(self.names())
        };
        let first = first.filter(is_last);
        (0..self.landmarks.len()).map(|k| first.map(|first| first + k)).collect()
    }
}

/// The point, following the shape as the vertex that is nearest at rest: `A_j = w_j (S_vertex - S_j)`.
fn with_shape(landmark: &Landmark, model: &BodyModel) -> Landmark {
    let at = |term: &LandmarkTerm| model.rest_joints[term.joint] * term.weight + term.offset;
    let place: Vector3<f64> = landmark.terms.iter().map(at).sum();
    let distance = |v: &usize| (model.surface.vertices[*v] - place).norm_squared();
    let nearest = (0..model.surface.vertices.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let Some(vertex) = nearest else { return landmark.clone() };
    let moved = |term: &LandmarkTerm| LandmarkTerm {
        offset_directions: (model.surface.shape_directions[vertex] - model.shape_directions[term.joint]) * term.weight,
        ..term.clone()
    };
    Landmark { name: landmark.name.clone(), terms: landmark.terms.iter().map(moved).collect() }
}

/// A table of a model's own skin: the points of `base`, then `count` vertices spread over the skin, `vertex_<number>` each.
///
/// Every point is the vertex farthest from those before it, the first being the vertex `seed` (modulo their number).
pub fn spread_over_skin(model: &BodyModel, base: KeypointConvention, count: usize, seed: usize) -> Vec<StatedLandmark> {
    let vertices = &model.surface.vertices;
    let of_base = |name: &&str| StatedLandmark { name: (*name).to_owned(), terms: Vec::new() };
    let mut table: Vec<StatedLandmark> = base.names().iter().map(of_base).collect();
    let mut distances = vec![f64::INFINITY; vertices.len()];
    let mut next = seed % vertices.len().max(1);
    for _ in 0..count.min(vertices.len()) {
        let term = |JointWeight { joint, weight }: &JointWeight| {
            (JOINT_NAMES[*joint].to_owned(), *weight, (vertices[next] - model.rest_joints[*joint]).into())
        };
        table.push(StatedLandmark {
            name: format!("vertex_{next}"),
            terms: model.surface.skin[next].iter().map(term).collect(),
        });
        for (distance, vertex) in distances.iter_mut().zip(vertices) {
            *distance = distance.min((vertex - vertices[next]).norm_squared());
        }
        next = (0..vertices.len()).max_by(|a, b| distances[*a].total_cmp(&distances[*b])).unwrap_or(0);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::super::kinematics::{Pose, landmark_position, posed};
    use super::super::model::Betas;
    use super::super::skinning::skinned;
    use super::*;
    use crate::geometry::rotation;

    fn table(count: usize) -> Vec<StatedLandmark> {
        spread_over_skin(&default_body(), KeypointConvention::Coco17, count, 7)
    }

    /// The points of a table follow pose and shape like the vertices that they were taken from.
    #[test]
    fn points_move_with_the_skin() {
        let model = default_body();
        let checked = checked_table("skin", &table(40)).unwrap();
        let dense = checked.dense.unwrap();
        let extended = dense.on(&model);
        let betas = Betas::from_fn(|k, _| 1.5 * (k as f64).cos());
        let turn = |j: usize| rotation::exp(&(Vector3::new((j as f64).sin(), (2.0 * j as f64).cos(), 0.3) * 0.4));
        let pose = Pose { rotations: std::array::from_fn(turn), translation: Vector3::new(0.2, 0.9, -0.1) };
        let body = extended.shaped(&betas);
        let skeleton = posed(&body, &pose);
        let skin = skinned(&model, &betas, &pose);
        for (name, place) in dense.names().zip(dense.places(&extended)) {
            let vertex: usize = name.strip_prefix("vertex_").unwrap().parse().unwrap();
            let found = landmark_position(&extended, &body, &skeleton, place.unwrap());
            assert!((found - skin[vertex]).norm() < 1e-9, "{name}");
        }
        assert!(dense.places(&model).iter().all(Option::is_none));
        assert_eq!(extended.landmarks[..model.landmarks.len()], model.landmarks);
    }

    #[test]
    fn the_points_of_the_base_come_first() {
        let mut stated = table(3);
        stated.rotate_left(2);
        let checked = checked_table("skin", &stated).unwrap();
        assert_eq!(checked.base, KeypointConvention::Coco17);
        assert_eq!(checked.places[..2], [2, 3]);
        assert_eq!(checked.places[checked.places.len() - 5..], [17, 18, 19, 0, 1]);
        let dense = checked.dense.unwrap();
        assert_eq!((dense.landmarks.len(), dense.sha256.len()), (3, 64));
        stated[15].terms[0].2[0] += 1e-9;
        assert_ne!(checked_table("skin", &stated).unwrap().dense.unwrap().sha256, dense.sha256);
    }

    #[test]
    fn faults_name_landmark_and_value() {
        let fault = |change: fn(&mut Vec<StatedLandmark>)| {
            let mut stated = table(2);
            change(&mut stated);
            checked_table("skin", &stated).unwrap_err().to_string()
        };
        assert!(fault(|t| t[18].name = t[17].name.clone()).contains("unique"));
        assert!(fault(|t| t[17].terms[0].0 = "tail".to_owned()).contains("\"tail\""));
        assert!(fault(|t| t[17].terms[0].1 += 0.5).contains("sum to 1.5"));
        assert!(fault(|t| t[17].terms.clear()).contains("sum to 0"));
        assert!(fault(|t| t[17].terms[0].2[1] = f64::NAN).contains("NaN"));
        assert!(fault(|t| t[17].terms[0].2[1] = 9.0).contains("9.0"));
        assert!(fault(|t| t.truncate(16)).contains("coco17"));
        assert!(fault(|t| *t = table(985)).contains("1002"));
    }

    #[test]
    fn sides_are_exchanged_by_name() {
        let mut stated = table(3);
        (stated[17].name, stated[19].name) = ("left_rib".to_owned(), "right_rib".to_owned());
        assert_eq!(checked_table("skin", &stated).unwrap().dense.unwrap().mirror(), [2, 1, 0]);
    }
}
