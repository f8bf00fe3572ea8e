//! Layers with their backward passes. Letters: N rows (frames x batch), H hidden width.
//!
//! A layer reads its parameters from a flat vector and adds its gradient to the same range of a flat gradient vector, so that
//! training, storing and comparing a network need no names.

use super::panels::{Panels, add_product, transposed};

/// Reads layers one after the other from a flat vector.
pub(crate) struct Reader<'a> {
    values: &'a [f32],
    at: usize,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(values: &'a [f32]) -> Self {
        Self { values, at: 0 }
    }
}

/// Number of parameters of an affine layer.
pub(crate) fn affine_len(n_in: usize, n_out: usize) -> usize {
    (n_in + 1) * n_out
}

/// `y = x W + b`; parameters: W `[n_in, n_out]`, then b.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Affine {
    at: usize,
    n_in: usize,
    n_out: usize,
    weight: Panels,
    weight_transposed: Panels,
    bias: Vec<f32>,
}

impl Affine {
    pub(crate) fn read(reader: &mut Reader, n_in: usize, n_out: usize) -> Self {
        let at = reader.at;
        reader.at += affine_len(n_in, n_out);
        let (weight, bias) = reader.values[at..reader.at].split_at(n_in * n_out);
        Self {
            at,
            n_in,
            n_out,
            weight: Panels::from_rows(weight, n_in, n_out),
            weight_transposed: Panels::from_columns(weight, n_out, n_in),
            bias: bias.to_vec(),
        }
    }

    /// `x` is `[N, n_in]`; returns `[N, n_out]`.
    pub(crate) fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut y = Vec::new();
        self.forward_into(x, &mut y);
        y
    }

    /// The same into a reused vector.
    pub(crate) fn forward_into(&self, x: &[f32], y: &mut Vec<f32>) {
        y.clear();
        (0..x.len() / self.n_in).for_each(|_| y.extend_from_slice(&self.bias));
        add_product(x, &self.weight, y);
    }

    /// `dx += dy W^T`.
    pub(crate) fn add_backward(&self, dy: &[f32], dx: &mut [f32]) {
        add_product(dy, &self.weight_transposed, dx);
    }

    /// `dx = dy W^T`.
    pub(crate) fn backward(&self, dy: &[f32]) -> Vec<f32> {
        let mut dx = vec![0.0; dy.len() / self.n_out * self.n_in];
        self.add_backward(dy, &mut dx);
        dx
    }

    /// Adds `dW += x^T dy` and `db += sum of dy`.
    pub(crate) fn add_gradient(&self, x: &[f32], dy: &[f32], gradient: &mut [f32]) {
        let own = &mut gradient[self.at..self.at + affine_len(self.n_in, self.n_out)];
        let (weight, bias) = own.split_at_mut(self.n_in * self.n_out);
        let n = x.len() / self.n_in;
        add_product(&transposed(x, self.n_in), &Panels::from_rows(dy, n, self.n_out), weight);
        for row in dy.chunks_exact(self.n_out) {
            bias.iter_mut().zip(row).for_each(|(b, d)| *b += d);
        }
    }
}

/// Slope of the leaky rectifier below zero.
const LEAK: f32 = 0.1;

/// Leaky rectifier, in place.
pub(crate) fn rectify(x: &mut [f32]) {
    x.iter_mut().for_each(|x| *x = if *x > 0.0 { *x } else { LEAK * *x });
}

/// Backward pass of [`rectify`], from the rectified values, in place.
pub(crate) fn rectify_backward(rectified: &[f32], dx: &mut [f32]) {
    dx.iter_mut().zip(rectified).for_each(|(d, y)| *d *= if *y > 0.0 { 1.0 } else { LEAK });
}

/// Two matrices of equal height side by side.
pub(crate) fn beside(a: &[f32], b: &[f32], width_a: usize, width_b: usize) -> Vec<f32> {
    let mut both = Vec::with_capacity(a.len() + b.len());
    for (a, b) in a.chunks_exact(width_a).zip(b.chunks_exact(width_b)) {
        both.extend_from_slice(a);
        both.extend_from_slice(b);
    }
    both
}

/// Inverse of [`beside`].
pub(crate) fn apart(both: &[f32], width_a: usize, width_b: usize) -> [Vec<f32>; 2] {
    let n = both.len() / (width_a + width_b);
    let mut parts = [Vec::with_capacity(n * width_a), Vec::with_capacity(n * width_b)];
    for row in both.chunks_exact(width_a + width_b) {
        parts[0].extend_from_slice(&row[..width_a]);
        parts[1].extend_from_slice(&row[width_a..]);
    }
    parts
}
