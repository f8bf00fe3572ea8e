//! Input of the encoder: candidate paths, visibility and roughness of a take.

use super::basis::Basis;
use super::chart::{LATENT_JOINTS, N_FEATURES, on_shortest_branch};
use super::paths::{CANDIDATES, Observed, smoothed};
use super::six_d::{N_COLUMNS, columns_of};

const N_JOINTS: usize = LATENT_JOINTS.len();

/// Width of [`EncoderInput::values`].
pub(crate) const N_ENCODER_INPUT: usize = CANDIDATES.len() * N_FEATURES + 2 * N_JOINTS;

/// Width of the input of the paper's form.
pub(crate) const N_PLAIN_INPUT: usize = N_COLUMNS + N_JOINTS;

/// Frames on each side over which roughness is averaged: a quarter of a second.
const ROUGHNESS_REACH: usize = 7;

/// Encoder input of one take, T frames.
#[derive(Debug, Clone)]
pub(crate) struct EncoderInput {
    /// Input of the network, `[T, 323]` (`[T, 133]` in the paper's form), of the order of 1.
    pub(crate) values: Vec<f32>,
    /// First candidate less the mean: seen frames interpolated by cubics, `[T, 57]`.
    pub(crate) path: Vec<f32>,
    /// Last candidate less the mean: seen frames interpolated linearly, `[T, 57]`.
    pub(crate) straight: Vec<f32>,
    /// Whether each joint is seen, `[T, 19]`.
    pub(crate) seen: Vec<bool>,
}

/// Prepares a take.
pub(crate) fn encoder_input(basis: &Basis, observed: &Observed) -> EncoderInput {
    let n_frames = observed.n_frames();
    let paths = CANDIDATES.map(|smoothing| smoothed(observed, smoothing, &basis.mean));
    let known = on_shortest_branch(paths[0].clone());
    let roughness = roughness(&paths[0], &paths[1], n_frames);
    let mut values = Vec::with_capacity(n_frames * N_ENCODER_INPUT);
    for t in 0..n_frames {
        let row = t * N_FEATURES..(t + 1) * N_FEATURES;
        let first = &paths[0][row.clone()];
        let scaled = |i: usize, off: f32| off / basis.spread[i];
        values.extend(known[row.clone()].iter().enumerate().map(|(i, x)| scaled(i, x - basis.mean[i])));
        for path in &paths[1..] {
            // Differences between the candidates are small relative to the motion.
            let differences = path[row.clone()].iter().zip(first);
            values.extend(differences.enumerate().map(|(i, (x, first))| 3.0 * scaled(i, x - first)));
        }
        let joints = t * N_JOINTS..(t + 1) * N_JOINTS;
        values.extend(observed.seen[joints.clone()].iter().map(|seen| if *seen { 1.0 } else { 0.0 }));
        values.extend_from_slice(&roughness[joints]);
    }
    let off = |path: &[f32]| -> Vec<f32> {
        path.chunks_exact(N_FEATURES).flat_map(|f| f.iter().zip(&basis.mean).map(|(f, m)| f - m)).collect()
    };
    EncoderInput { values, path: off(&paths[0]), straight: off(&paths[4]), seen: observed.seen.clone() }
}

/// Prepares a take for the paper's form: the first candidate as columns, and visibility.
pub(crate) fn plain_input(basis: &Basis, observed: &Observed) -> EncoderInput {
    let mut input = encoder_input(basis, observed);
    let path = smoothed(observed, CANDIDATES[0], &basis.mean);
    let columns = columns_of(&basis.chart, &path);
    let rows = columns.chunks_exact(N_COLUMNS).zip(observed.seen.chunks_exact(N_JOINTS));
    let flags = |seen: &[bool]| seen.iter().map(|seen| if *seen { 1.0 } else { 0.0 }).collect::<Vec<f32>>();
    input.values = rows.flat_map(|(columns, seen)| [columns.to_vec(), flags(seen)].concat()).collect();
    input
}

/// Logarithm of the mean squared difference between raw and smooth path around each frame, scaled to the order of 1: `[T, 19]`.
fn roughness(raw: &[f32], smooth: &[f32], n_frames: usize) -> Vec<f32> {
    let square = |t: usize, joint: usize| -> f32 {
        let at = t * N_FEATURES + 3 * joint;
        (at..at + 3).map(|i| (raw[i] - smooth[i]).powi(2)).sum()
    };
    let squares: Vec<f32> =
        (0..n_frames).flat_map(|t| (0..N_JOINTS).map(move |joint| (t, joint))).map(|(t, j)| square(t, j)).collect();
    let mut roughness = Vec::with_capacity(squares.len());
    for t in 0..n_frames {
        let near = t.saturating_sub(ROUGHNESS_REACH)..(t + ROUGHNESS_REACH + 1).min(n_frames);
        for joint in 0..N_JOINTS {
            let sum: f32 = near.clone().map(|s| squares[s * N_JOINTS + joint]).sum();
            roughness.push(0.3 * (sum / near.len() as f32 + 1e-8).ln() + 3.0);
        }
    }
    roughness
}
