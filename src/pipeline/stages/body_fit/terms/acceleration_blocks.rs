//! Gauss-Newton blocks of an acceleration over three successive frames.

use crate::optim::block_banded::BlockBanded;
use crate::residuals::acceleration::acceleration_cost;
use nalgebra::{Matrix3, Vector3};

/// How accelerations are weighted, whatever accelerates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RobustAcceleration {
    /// Where the cost turns from quadratic to linear, in standard deviations.
    pub knee: f64,
    pub time_weight: f64,
}

impl RobustAcceleration {
    /// Cost of an acceleration over its standard deviation.
    pub(crate) fn cost(&self, residual: &Vector3<f64>) -> f64 {
        acceleration_cost(residual.norm_squared(), self.knee).cost
    }

    /// Adds the acceleration `residual` about frame `middle`, over its standard deviation. Its derivatives are `factors` times
    /// those of `by_frame`, each by group. Returns the weight that its square has in the system.
    pub(crate) fn add_to(
        &self,
        middle: usize,
        residual: &Vector3<f64>,
        factors: [f64; 3],
        by_frame: [&[(usize, Matrix3<f64>)]; 3],
        system: &mut BlockBanded,
    ) -> f64 {
        let weight = acceleration_cost(residual.norm_squared(), self.knee).weight * self.time_weight;
        for (i, (groups, factor)) in by_frame.iter().zip(factors).enumerate() {
            for (row, jacobian) in *groups {
                let left = jacobian.transpose() * (factor * weight);
                let mut gradient = system.gradient[middle - 1 + i].fixed_rows_mut::<3>(3 * row);
                gradient += left * residual;
                for (k, (earlier, factor)) in by_frame.iter().zip(factors).enumerate().take(i + 1) {
                    for (column, other) in *earlier {
                        system.add_block([middle - 1 + i, middle - 1 + k], [*row, *column], left * other * factor);
                    }
                }
            }
        }
        weight
    }
}
