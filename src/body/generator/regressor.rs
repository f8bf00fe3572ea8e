//! Joints and landmarks from vertices: sparse convex combinations that approximate the generator's positions at every shape.

use super::places::VariedPlace;
use crate::body::anthropometry::N_BETAS;
use crate::body::model::ShapeDirections;
use crate::body::surface::VertexWeight;
use nalgebra::{DMatrix, DVector, Vector3};

/// A vertex, or the mean of a vertex and its mirror image, as a candidate of a convex combination.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    /// The vertices that share its weight equally.
    pub vertices: Vec<usize>,
    /// Rest position at beta 0, m.
    pub place: Vector3<f64>,
    /// Change of the position per beta, m.
    pub directions: ShapeDirections,
}

/// Weight of the position at beta 0 relative to its change per beta.
const TEMPLATE_WEIGHT: f64 = 3.0;
/// Weight of the condition that the weights sum to 1, m.
const SUM_WEIGHT: f64 = 10.0;
/// Candidates are at most this many times as far away as the nearest one, plus a margin, m.
const RADIUS: [f64; 2] = [1.7, 0.03];

/// The non-negative weights, summing to 1, whose combination is nearest to the position at beta 0 and to its change per beta.
pub(super) fn convex_row(place: &VariedPlace, candidates: &[Candidate]) -> Vec<VertexWeight> {
    let distance = |candidate: &Candidate| (candidate.place - place.mean).norm();
    let nearest = candidates.iter().map(distance).fold(f64::INFINITY, f64::min);
    let near: Vec<&Candidate> = candidates.iter().filter(|c| distance(c) <= RADIUS[0] * nearest + RADIUS[1]).collect();
    let n_rows = 3 + 3 * N_BETAS + 1;
    let column = |offset: Vector3<f64>, directions: &ShapeDirections, sum: f64| {
        let entries = offset.iter().map(|v| v * TEMPLATE_WEIGHT).chain(directions.iter().copied());
        DVector::from_iterator(n_rows, entries.chain([sum]))
    };
    // Relative to the position the target is zero except for the sum, which keeps the equations well scaled.
    let columns: Vec<DVector<f64>> =
        near.iter().map(|c| column(c.place - place.mean, &(c.directions - place.directions), SUM_WEIGHT)).collect();
    let target = column(Vector3::zeros(), &ShapeDirections::zeros(), SUM_WEIGHT);
    let shares = non_negative_least_squares(&DMatrix::from_columns(&columns), &target);
    let total: f64 = shares.iter().sum();
    let mut row: Vec<VertexWeight> = Vec::new();
    for (candidate, share) in near.iter().zip(shares.iter()).filter(|(_, share)| **share > 0.0) {
        let weight = share / total / candidate.vertices.len() as f64;
        row.extend(candidate.vertices.iter().map(|&vertex| VertexWeight { vertex, weight }));
    }
    row
}

/// `min |A x - b|` over `x >= 0`: the active set method of Lawson and Hanson (1974, chapter 23) on the normal equations.
///
/// Ends after at most `3 n` steps with the best feasible solution.
fn non_negative_least_squares(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let n = a.ncols();
    let (gram, moment) = (a.tr_mul(a), a.tr_mul(b));
    let mut x = DVector::zeros(n);
    let mut passive: Vec<usize> = Vec::new();
    let tolerance = 1e-10 * moment.amax();
    for _ in 0..3 * n {
        let gradient = &moment - &gram * &x;
        let steepest = (0..n).filter(|i| !passive.contains(i)).max_by(|i, j| gradient[*i].total_cmp(&gradient[*j]));
        let Some(entering) = steepest.filter(|i| gradient[*i] > tolerance) else { break };
        passive.push(entering);
        while let Some(solution) = solve_passive(&gram, &moment, &passive) {
            let blocking = passive.iter().enumerate().filter(|(k, _)| solution[*k] <= 0.0);
            let step = blocking.map(|(k, i)| x[*i] / (x[*i] - solution[k])).fold(1.0, f64::min);
            for (k, i) in passive.iter().enumerate() {
                x[*i] += step * (solution[k] - x[*i]);
            }
            if step >= 1.0 {
                break;
            }
            passive.retain(|i| x[*i] > 1e-12);
            (0..n).filter(|i| !passive.contains(i)).for_each(|i| x[i] = 0.0);
        }
    }
    x
}

fn solve_passive(gram: &DMatrix<f64>, moment: &DVector<f64>, passive: &[usize]) -> Option<DVector<f64>> {
    let n = passive.len();
    // A little damping keeps the system regular for nearly equal candidates.
    let system = DMatrix::from_fn(n, n, |i, j| gram[(passive[i], passive[j])] + if i == j { 1e-9 } else { 0.0 });
    Some(system.cholesky()?.solve(&DVector::from_fn(n, |i, _| moment[passive[i]])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_solutions_become_zero_and_the_rest_optimal() {
        let a = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        let x = non_negative_least_squares(&a, &DVector::from_vec(vec![2.0, -3.0, 1.0]));
        assert!((x[0] - 1.5).abs() < 1e-8 && x[1] == 0.0);
    }
}
