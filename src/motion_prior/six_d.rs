//! The plain form of the paper's network, for comparison: the first two columns of every rotation, in and out.
//!
//! Columns are relative to those of the mean pose, so that a zero output is the mean pose. Outputs are converted to rotations
//! by Gram-Schmidt orthogonalisation ([`rotation::from_6d`]).

use super::chart::{Chart, LATENT_JOINTS, N_FEATURES};
use super::joints::frame;
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};

/// Numbers of one frame in this form.
pub(crate) const N_COLUMNS: usize = 6 * LATENT_JOINTS.len();

/// Rows of features `[N, 57]` as columns `[N, 114]`.
pub(crate) fn columns_of(chart: &Chart, features: &[f32]) -> Vec<f32> {
    let mut columns = Vec::with_capacity(features.len() / N_FEATURES * N_COLUMNS);
    for row in features.chunks_exact(N_FEATURES) {
        let rotations = chart.rotations(&frame(row));
        for (joint, mean) in LATENT_JOINTS.iter().zip(&chart.means) {
            let pairs = rotation::to_6d(&rotations[*joint]).into_iter().zip(rotation::to_6d(mean));
            columns.extend(pairs.map(|(x, m)| (x - m) as f32));
        }
    }
    columns
}

/// Columns `[N, 114]` as features `[N, 57]`. Columns that do not span a plane give the mean.
pub(crate) fn features_of(chart: &Chart, columns: &[f32]) -> Vec<f32> {
    let mut features = Vec::with_capacity(columns.len() / 2);
    for row in columns.chunks_exact(N_COLUMNS) {
        for (values, mean) in row.chunks_exact(6).zip(&chart.means) {
            let found = rotation::from_6d(&with_mean(values, mean)).unwrap_or(*mean);
            features.extend(rotation::log(&mean.tr_mul(&found)).iter().map(|u| *u as f32));
        }
    }
    features
}

/// Gradient to the columns from that to the features: `exp(u) exp(e) = exp(u + J_r^-1(u) e)`.
pub(crate) fn features_of_backward(chart: &Chart, columns: &[f32], features: &[f32], d_features: &[f32]) -> Vec<f32> {
    let joint = |row: &[f32], i: usize| Vector3::from_fn(|axis, _| f64::from(row[3 * i + axis]));
    let mut d_columns = Vec::with_capacity(columns.len());
    for (i, values) in columns.chunks_exact(6).enumerate() {
        let (u, d) = (joint(features, i), joint(d_features, i));
        let mean = &chart.means[i % LATENT_JOINTS.len()];
        let d_increment = rotation::right_jacobian_inverse(&u).tr_mul(&d);
        d_columns.extend(rotation::from_6d_backward(&with_mean(values, mean), &d_increment).map(|d| d as f32));
    }
    d_columns
}

fn with_mean(values: &[f32], mean: &Matrix3<f64>) -> [f64; 6] {
    let mean = rotation::to_6d(mean);
    std::array::from_fn(|k| mean[k] + f64::from(values[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_inverse_and_their_gradient_is_exact() {
        let chart = Chart { means: [rotation::exp(&Vector3::new(0.3, 0.2, -0.2)); LATENT_JOINTS.len()] };
        let features: Vec<f32> = (0..2 * N_FEATURES).map(|i| (i as f32 * 0.37).sin() * 0.9).collect();
        let columns = columns_of(&chart, &features);
        assert!(features_of(&chart, &columns).iter().zip(&features).all(|(a, b)| (a - b).abs() < 1e-5));
        assert!(features_of(&chart, &[0.0; N_COLUMNS]).iter().all(|u| u.abs() < 1e-7));
        let pull: Vec<f32> = (0..features.len()).map(|i| (i as f32 * 0.71).cos()).collect();
        let gradient = features_of_backward(&chart, &columns, &features, &pull);
        for i in (0..columns.len()).step_by(5) {
            let stepped = |h: f32| -> f64 {
                let mut columns = columns.clone();
                columns[i] += h;
                features_of(&chart, &columns).iter().zip(&pull).map(|(x, p)| f64::from(x * p)).sum()
            };
            // Steps of 1e-3 in single precision: good to some 1e-3 of slopes of the order of 1.
            assert!(((stepped(1e-3) - stepped(-1e-3)) / 2e-3 - f64::from(gradient[i])).abs() < 5e-3, "{i}");
        }
    }
}
