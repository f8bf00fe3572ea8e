//! The operator's table of landmarks: the detectors' surface points on a user's mesh.
//!
//! ```json
//! {"nose": [{"vertex": 12, "weight": 1.0}], "left_heel": [{"vertex": 7, "weight": 0.5}, {"vertex": 9, "weight": 0.5}]}
//! ```
//! Names are those of the keypoint conventions; the weights of a point sum to 1. Vertex numbers refer to the user's
//! file and come from its licensor.

use crate::body::landmarks::ends_of_midpoint;
use crate::body::skeleton::KeypointConvention;
use crate::body::surface::{SurfacePoint, VertexWeight};
use std::collections::BTreeMap;

/// Named points of the skin.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LandmarkTable {
    /// In alphabetical order of their names.
    pub points: Vec<SurfacePoint>,
}

/// Why a landmark table is rejected.
#[derive(Debug, thiserror::Error)]
pub enum LandmarkTableError {
    /// The text is not the documented JSON.
    #[error("the landmark table cannot be read: {0}")]
    Json(#[from] serde_json::Error),
    /// No convention has a keypoint of this name.
    #[error("no keypoint is called {name}; use a name of a keypoint convention, such as left_heel")]
    UnknownName {
        /// The unknown name.
        name: String,
    },
    /// The point of this name lies between two joints, wherever a table has it.
    #[error("landmark {name}: this point is the middle of {} and {}; leave it out of the table", ends[0], ends[1])]
    Midpoint {
        /// Name of the landmark.
        name: String,
        /// The joints on both sides.
        ends: [&'static str; 2],
    },
    /// The weights of a landmark do not sum to 1.
    #[error("landmark {name}: the weights sum to {sum}, 1 expected")]
    Weights {
        /// Name of the landmark.
        name: String,
        /// Sum of its weights.
        sum: f64,
    },
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    vertex: usize,
    weight: f64,
}

impl LandmarkTable {
    /// Reads the documented JSON.
    ///
    /// # Errors
    /// [`LandmarkTableError`]; vertex numbers are checked when the table is applied to a mesh.
    pub fn from_json(json: &[u8]) -> Result<Self, LandmarkTableError> {
        let entries: BTreeMap<String, Vec<Entry>> = serde_json::from_slice(json)?;
        let mut points = Vec::new();
        for (name, entries) in entries {
            if !KeypointConvention::ALL.iter().any(|convention| convention.index_of(&name).is_some()) {
                return Err(LandmarkTableError::UnknownName { name });
            }
            if let Some(ends) = ends_of_midpoint(&name) {
                return Err(LandmarkTableError::Midpoint { name, ends });
            }
            let sum: f64 = entries.iter().map(|entry| entry.weight).sum();
            if (sum - 1.0).abs() > 1e-3 || !sum.is_finite() {
                return Err(LandmarkTableError::Weights { name, sum });
            }
            let share = |entry: &Entry| VertexWeight { vertex: entry.vertex, weight: entry.weight / sum };
            points.push(SurfacePoint { name, vertices: entries.iter().map(share).collect() });
        }
        Ok(Self { points })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neck_and_mid_hip_of_a_table_were_silently_ignored() {
        for (name, joint) in [("neck", "left_shoulder"), ("mid_hip", "left_hip")] {
            let table =
                format!(r#"{{"nose": [{{"vertex": 1, "weight": 1}}], "{name}": [{{"vertex": 2, "weight": 1}}]}}"#);
            let refusal = LandmarkTable::from_json(table.as_bytes()).unwrap_err().to_string();
            assert!(refusal.contains(name) && refusal.contains(joint), "{refusal}");
        }
        let table = br#"{"nose": [{"vertex": 1, "weight": 1}], "left_hip": [{"vertex": 2, "weight": 1}]}"#;
        assert_eq!(LandmarkTable::from_json(table).unwrap().points.len(), 2);
    }
}
