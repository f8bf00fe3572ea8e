//! The arrays of a body file by field name, and how large each may be.

use crate::formats::npy::Array;
use std::collections::BTreeMap;

/// Most elements of any field: 300 components of 8,300 vertices. A small hostile file therefore costs at most 60 MB an
/// array, three of which are in memory at once.
pub(super) const MAX_ELEMENTS: usize = 7_500_000;

/// Arrays by field name.
pub(crate) type Fields = BTreeMap<String, Array>;

/// The fields that are read; all others are skipped. The weights come first: they distinguish the models of the family.
pub(super) const FIELDS: [&str; 10] = [
    "weights", "v_template", "shapedirs", "posedirs", "J_regressor", "kintree_table", "f", "landmark_names",
    "landmark_vertices", "landmark_weights",
];

/// Most elements of one field.
pub(super) fn max_elements(field: &str) -> usize {
    match field {
        "shapedirs" | "posedirs" => MAX_ELEMENTS,
        _ => MAX_ELEMENTS / 5, // 20,000 vertices by 55 joints
    }
}
