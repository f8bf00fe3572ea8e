//! Shape coefficients of the body model and what they change.

use super::anthropometry::N_BETAS;
use nalgebra::{SMatrix, SVector};

/// Change of a point per unit of each beta: 3 x 10, m.
pub type ShapeDirections = SMatrix<f64, 3, N_BETAS>;

/// Shape coefficients in population standard deviations.
pub type Betas = SVector<f64, N_BETAS>;
