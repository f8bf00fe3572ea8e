//! Errors of the simulation.

use crate::body::skeleton::KeypointConvention;
use crate::motion_prior::motion_file::MotionProblem;
use std::path::PathBuf;

/// Why a session cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A value of the configuration is out of range.
    #[error("{field}: {expected} expected, found {value}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Its range, with unit.
        expected: &'static str,
    },
    /// The skeleton has no rule for a keypoint of the convention.
    #[error("{}: no rule for keypoint {keypoint}", convention.name())]
    UnknownKeypoint {
        /// The convention.
        convention: KeypointConvention,
        /// The keypoint's name.
        keypoint: &'static str,
    },
    /// There are fewer motion files than people.
    #[error("{people} people need as many motion files, found {files}")]
    TooFewMotions {
        /// People asked for.
        people: usize,
        /// Files given.
        files: usize,
    },
    /// A motion file cannot be read.
    #[error("{}: {problem}", path.display())]
    Motion {
        /// The file.
        path: PathBuf,
        /// Why it cannot be read.
        problem: MotionProblem,
    },
}
