//! The float model in f64: slow and obvious, the yardstick of every number format.
//!
//! In:  a [`Checkpoint`], a code in floats, positions in frames.
//! Out: poses in channel units.
//!
//! Why here: written anew from the paper's equation, pose(t) = D(β, α, τ(t)), so that it checks trainer, quantiser and
//! device together. Layer 1's code half is folded once per motion, which changes nothing but the time it takes.
//!
//! Source: Cervantes et al., ECCV 2022, section 3; the published code for the order [β, α, τ] and for ELU.

use crate::checkpoint::{Checkpoint, DenseLayer};

/// Independent partial sums of a dot product; lets the compiler use vector registers.
const LANES: usize = 8;

/// Evaluates a float model.
#[derive(Clone, Copy, Debug)]
pub struct Reference<'a> {
    checkpoint: &'a Checkpoint,
}

impl<'a> Reference<'a> {
    /// Checks nothing: `Checkpoint::read` has.
    pub fn new(checkpoint: &'a Checkpoint) -> Self {
        Self { checkpoint }
    }

    /// Poses of one motion at `positions`, in frames.
    ///
    /// # Shapes
    /// `code` (β then α) · `positions` (position) · result (position, channel)
    pub fn decode(&self, code: &[f64], positions: &[f64]) -> Vec<Vec<f64>> {
        let Some((first, rest)) = self.checkpoint.layers.split_first() else {
            return Vec::new();
        };
        let folded = fold(first, code);
        let modulation = self.checkpoint.modulation.as_ref().map(|layer| fold(layer, code));
        let mut gates = modulation.as_deref();
        // Hidden units are the outputs of all layers but the last.
        let hidden = &self.checkpoint.layers[..rest.len()];
        let unit_count = hidden.iter().map(|layer| layer.bias.len()).sum::<usize>();
        let phases = modulation.as_deref().and_then(|rows| rows.get(unit_count..)).unwrap_or(&[]);
        let embed = |&position: &f64| self.embed(position, phases);
        let embeddings: Vec<_> = positions.iter().map(embed).collect();
        let time_rows = first.weights.rows().map(|row| &row[code.len()..]);
        let mut activations = multiply(time_rows, &folded, &embeddings);
        for layer in rest {
            activations.iter_mut().for_each(|sums| apply_gates(sums, gates));
            gates = gates.map(|rows| &rows[activations.first().map_or(0, Vec::len)..]);
            activations.iter_mut().flatten().for_each(elu);
            activations = multiply(layer.weights.rows(), &layer.bias, &activations);
        }
        activations.iter_mut().for_each(|pose| self.to_channel_units(pose));
        activations
    }

    /// τ(t) = [sin(w_0 t + φ_0), cos(w_0 t + φ_0), sin(w_1 t + φ_1), …]; the phases φ are 0 where there are none.
    fn embed(&self, position: f64, phases: &[f64]) -> Vec<f64> {
        let phases = phases.iter().copied().chain(std::iter::repeat(0.0));
        let frequencies = self.checkpoint.frequencies_rad.iter();
        let angles = frequencies.zip(phases).map(|(rate, phase)| rate * position + phase);
        angles.flat_map(|angle| [angle.sin(), angle.cos()]).collect()
    }

    fn to_channel_units(self, pose: &mut [f64]) {
        let dataset = &self.checkpoint.dataset;
        for ((value, scale), mean) in pose.iter_mut().zip(&dataset.scale).zip(&dataset.mean) {
            *value = *value * scale + mean;
        }
    }
}

/// Each sum times its gate, 1 + row, between 0 and 2.
fn apply_gates(sums: &mut [f64], rows: Option<&[f64]>) {
    for (sum, row) in sums.iter_mut().zip(rows.unwrap_or_default()) {
        *sum *= (1.0 + row).clamp(0.0, 2.0);
    }
}

/// Bias plus the code's share of layer 1, or of gates and phases. // (out)
fn fold(layer: &DenseLayer, code: &[f64]) -> Vec<f64> {
    let rows = layer.weights.rows().zip(&layer.bias);
    rows.map(|(row, bias)| bias + dot(&row[..code.len()], code)).collect()
}

/// `row · input + start` for every input and row. // (input, out)
fn multiply<'r>(
    rows: impl Iterator<Item = &'r [f64]>,
    starts: &[f64],
    inputs: &[Vec<f64>],
) -> Vec<Vec<f64>> {
    let mut outputs = vec![Vec::with_capacity(starts.len()); inputs.len()];
    // Rows outside: each is read once for all positions.
    for (row, start) in rows.zip(starts) {
        for (output, input) in outputs.iter_mut().zip(inputs) {
            output.push(start + dot(row, input));
        }
    }
    outputs
}

fn dot(left: &[f64], right: &[f64]) -> f64 {
    let (left, left_rest) = left.as_chunks::<LANES>();
    let (right, right_rest) = right.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (left, right) in left.iter().zip(right) {
        for lane in 0..LANES {
            sums[lane] += left[lane] * right[lane];
        }
    }
    let rest: f64 = left_rest.iter().zip(right_rest).map(|(left, right)| left * right).sum();
    sums.iter().sum::<f64>() + rest
}

/// ELU with α = 1.
fn elu(value: &mut f64) {
    if *value < 0.0 {
        *value = value.exp_m1();
    }
}
