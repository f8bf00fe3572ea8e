//! The network of encoder and decoder: a recurrent path with a skip connection.
//!
//! `a = rect(x W_1)`, `g = rect(gru(a) W_2)`, `y = [g, a] W_3`, each product with its bias. Without recurrence (the
//! per-frame form) an affine layer of the same width replaces the recurrent unit.

use super::gru::{BiGru, BiGruTape};
use super::layers::{Affine, Reader, affine_len, apart, beside, rectify, rectify_backward};

/// Widths of a trunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TrunkShape {
    /// Width of the input.
    pub(crate) n_in: usize,
    /// Width H of the hidden layers.
    pub(crate) hidden: usize,
    /// Width of the output.
    pub(crate) n_out: usize,
    /// Whether frames depend on each other.
    pub(crate) recurrent: bool,
}

impl TrunkShape {
    fn memory_len(&self) -> usize {
        let width = self.hidden;
        if self.recurrent { BiGru::len(width, width) } else { affine_len(width, 2 * width) }
    }

    /// Number of parameters of a trunk.
    pub(crate) fn len(&self) -> usize {
        self.len_before_head() + affine_len(2 * self.hidden, self.n_out)
    }

    /// Number of parameters before the last layer.
    pub(crate) fn len_before_head(&self) -> usize {
        affine_len(self.n_in, self.hidden) + self.memory_len() + affine_len(2 * self.hidden, self.hidden)
    }
}

#[derive(Debug, Clone, PartialEq)]
enum Memory {
    Recurrent(Box<BiGru>),
    PerFrame(Affine),
}

/// The encoder's or decoder's network.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trunk {
    hidden: usize,
    entry: Affine,
    memory: Memory,
    merge: Affine,
    head: Affine,
}

/// Values that the backward pass needs.
pub(crate) struct TrunkTape {
    entered: Vec<f32>,
    memory: Option<BiGruTape>,
    remembered: Vec<f32>,
    joined: Vec<f32>,
}

impl Trunk {
    pub(crate) fn read(reader: &mut Reader, shape: TrunkShape) -> Self {
        let h = shape.hidden;
        let entry = Affine::read(reader, shape.n_in, h);
        let memory = if shape.recurrent {
            Memory::Recurrent(Box::new(BiGru::read(reader, h, h)))
        } else {
            Memory::PerFrame(Affine::read(reader, h, 2 * h))
        };
        let merge = Affine::read(reader, 2 * h, h);
        Self { hidden: h, entry, memory, merge, head: Affine::read(reader, 2 * h, shape.n_out) }
    }

    /// `x` is `[T, B, n_in]`; returns `[T, B, n_out]`.
    pub(crate) fn forward(&self, x: &[f32], batch: usize) -> (Vec<f32>, TrunkTape) {
        let mut entered = self.entry.forward(x);
        rectify(&mut entered);
        let (remembered, memory) = match &self.memory {
            Memory::Recurrent(gru) => {
                let (states, tape) = gru.forward(&entered, batch);
                (states, Some(tape))
            }
            Memory::PerFrame(layer) => {
                let mut wide = layer.forward(&entered);
                rectify(&mut wide);
                (wide, None)
            }
        };
        let mut merged = self.merge.forward(&remembered);
        rectify(&mut merged);
        let joined = beside(&merged, &entered, self.hidden, self.hidden);
        (self.head.forward(&joined), TrunkTape { entered, memory, remembered, joined })
    }

    /// Gradient to the input from that to the output; adds the gradient to the parameters to `gradient`, if given.
    pub(crate) fn backward(
        &self,
        tape: &TrunkTape,
        x: &[f32],
        dy: &[f32],
        batch: usize,
        mut gradient: Option<&mut [f32]>,
    ) -> Vec<f32> {
        let mut d_joined = self.head.backward(dy);
        rectify_backward(&tape.joined, &mut d_joined);
        let [d_merged, mut d_entered] = apart(&d_joined, self.hidden, self.hidden);
        let mut d_remembered = self.merge.backward(&d_merged);
        if let Some(gradient) = gradient.as_deref_mut() {
            self.head.add_gradient(&tape.joined, dy, gradient);
            self.merge.add_gradient(&tape.remembered, &d_merged, gradient);
        }
        let mut through_memory = match (&self.memory, &tape.memory) {
            (Memory::Recurrent(gru), Some(memory)) => {
                gru.backward(memory, &tape.entered, &d_remembered, batch, gradient.as_deref_mut())
            }
            (Memory::PerFrame(layer), _) => {
                rectify_backward(&tape.remembered, &mut d_remembered);
                if let Some(gradient) = gradient.as_deref_mut() {
                    layer.add_gradient(&tape.entered, &d_remembered, gradient);
                }
                layer.backward(&d_remembered)
            }
            (Memory::Recurrent(_), None) => unreachable!("a recurrent trunk's forward pass leaves a tape"),
        };
        // The skip connection's part was rectified with the joined columns; the memory's part is rectified here.
        rectify_backward(&tape.entered, &mut through_memory);
        d_entered.iter_mut().zip(&through_memory).for_each(|(skip, memory)| *skip += memory);
        if let Some(gradient) = gradient {
            self.entry.add_gradient(x, &d_entered, gradient);
        }
        self.entry.backward(&d_entered)
    }
}
