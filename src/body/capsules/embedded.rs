//! The capsules of the default body, fitted once and embedded: a fit takes as long as some hundred frames of a motion.

use super::body_capsules::{BodyCapsule, BodyCapsules, CapsuleEnd, N_CAPSULES};
use crate::body::anthropometry::BetaRow;
use crate::body::default_body::default_body;
use crate::body::model::BodyModel;
use crate::body::shape::ShapeDirections;
use nalgebra::Vector3;
use std::sync::Arc;

/// [`BodyCapsules::to_bytes`] of the default body; a test fits them again and compares every number.
const FILE: &[u8] = include_bytes!("../../../assets/default-adult-v1-capsules.f64");

/// Numbers of an end: offset, its change per beta, radius, its change per beta.
const N_OF_END: usize = 44;

/// Numbers of a capsule: its joint, both ends.
const N_OF_CAPSULE: usize = 1 + 2 * N_OF_END;

impl BodyCapsules {
    /// The capsules of a model: the embedded ones if its skin and joints are those of the default body, otherwise
    /// [fitted](Self::fitted) ones.
    pub fn of(model: &BodyModel) -> Self {
        let default = default_body();
        let is_default = Arc::ptr_eq(&model.surface, &default.surface)
            && model.rest_joints == default.rest_joints
            && model.shape_directions == default.shape_directions;
        if is_default { Self::from_bytes(FILE) } else { Self::fitted(model) }
    }

    /// All numbers in double precision, little endian: by capsule the joint; by end offset, its change per beta (three rows by
    /// beta), radius, its change per beta.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut numbers = Vec::with_capacity(N_CAPSULES * N_OF_CAPSULE);
        for capsule in &self.capsules {
            numbers.push(capsule.joint as f64);
            for end in &capsule.ends {
                numbers.extend(end.offset.iter().chain(end.offset_directions.iter()));
                numbers.push(end.radius);
                numbers.extend(end.radius_directions.iter());
            }
        }
        numbers.iter().flat_map(|number: &f64| number.to_le_bytes()).collect()
    }

    /// What [`Self::to_bytes`] wrote.
    fn from_bytes(bytes: &[u8]) -> Self {
        let numbers: Vec<f64> = bytes.as_chunks().0.iter().map(|number| f64::from_le_bytes(*number)).collect();
        let end = |numbers: &[f64]| CapsuleEnd {
            offset: Vector3::from_column_slice(&numbers[..3]),
            offset_directions: ShapeDirections::from_column_slice(&numbers[3..33]),
            radius: numbers[33],
            radius_directions: BetaRow::from_column_slice(&numbers[34..N_OF_END]),
        };
        let capsule = |k: usize| {
            let (joint, ends) = numbers[k * N_OF_CAPSULE..(k + 1) * N_OF_CAPSULE].split_at(1);
            BodyCapsule { joint: joint[0] as usize, ends: [end(&ends[..N_OF_END]), end(&ends[N_OF_END..])] }
        };
        Self { capsules: std::array::from_fn(capsule) }
    }
}
