//! A person of a scene, and the scene's unit.

use crate::export::rig::Rig;
use crate::session::BodyMotion;

/// Centimetres, the unit of the files, in a metre.
pub(super) const CM: f64 = 100.0;

/// A person under names that a program expects.
pub(super) struct Person<'a> {
    pub(super) name: &'a str,
    pub(super) joint_names: Vec<String>,
    pub(super) motion: &'a BodyMotion,
    pub(super) rig: Rig,
}
