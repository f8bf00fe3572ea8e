//! The default body, `default-adult-v1`: made by [`super::generator`], embedded as a file, read once.

use super::loader::{LandmarkTable, body_from_bytes};
use super::model::BodyModel;
use std::sync::OnceLock;

/// Its name.
pub const DEFAULT_BODY_NAME: &str = "default-adult-v1";

/// The file; a test makes it anew and compares every number.
const FILE: &[u8] = include_bytes!("../../assets/default-adult-v1.npz");

/// The default body: 1.692 m at beta 0, floor at y = 0, betas of [`super::anthropometry::Population::ansur2`].
pub fn default_body() -> BodyModel {
    static BODY: OnceLock<BodyModel> = OnceLock::new();
    let read = || body_from_bytes(DEFAULT_BODY_NAME.to_owned(), FILE, &LandmarkTable::default());
    BODY.get_or_init(|| read().expect("the embedded file is a body; a test loads it")).clone()
}
