//! Shape coefficients of the body model and what they change.

use nalgebra::{SMatrix, SVector};

/// Number of shape coefficients (betas).
pub const N_BETAS: usize = 10;

/// Shape coefficients in population standard deviations. In the default body each is the part of one measure that the
/// earlier ones do not explain: stature, weight, leg length, upper arm, shoulder breadth, pelvis breadth, forearm, knee
/// height, shoulder height, foot length.
pub type Betas = SVector<f64, N_BETAS>;

/// Change of a quantity per unit of each beta.
pub type BetaRow = SVector<f64, N_BETAS>;

/// Change of a point per unit of each beta: 3 x 10, m.
pub type ShapeDirections = SMatrix<f64, 3, N_BETAS>;
