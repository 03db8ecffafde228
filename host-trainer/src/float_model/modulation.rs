//! What a code does beyond layer 1: gates on the hidden units, phases of the time embedding.
//!
//! gate = clamp(1 + w·code + b, 0, 2) multiplies a hidden unit's sum before its ELU; phase = w·code + b, radians, is
//! added to the angle of a frequency. Both are rows of one layer over the code.
//!
//! In:  a motion's code.
//! Out: factors and angles that stay the same for all its frames, so that a device folds them once a motion and a pose
//! costs no multiplication more.
//!
//! Why here: they lowered the error of a pose of HumanAct12 by a fifth at about equal bytes; see "Gates and phases" in
//! ARCHITECTURE.md.
//!
//! Source: Perez et al., AAAI 2018 (FiLM), here bounded, without shifts, and before the activation.

use core::ops::Range;

use rand::Rng;
use serde::{Deserialize, Serialize};

use super::{DenseLayer, FloatModel, ModelShape};

/// What of a decoder follows the code, besides layer 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Modulation {
    /// Nothing, as in the paper.
    #[default]
    None,
    /// A gate on every hidden unit.
    Gates,
    /// A gate on every hidden unit, and the phase of every frequency.
    GatesAndPhases,
}

impl Modulation {
    /// For serde: what stays out of the canonical text, so that older runs keep their hash.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }
}

/// Factor on a hidden unit's sum.
pub fn gate(row: f32) -> f32 {
    (1.0 + row).clamp(0.0, karakuri::manifest::GATE_MAX as f32)
}

/// Whether a gate still moves with its row.
pub(super) fn gate_is_open(row: f32) -> bool {
    let gate = 1.0 + row;
    gate > 0.0 && gate < karakuri::manifest::GATE_MAX as f32
}

impl ModelShape<'_> {
    /// Rows of the layer of gates and phases.
    pub fn modulation_rows(&self) -> usize {
        let gates = self.hidden_widths.iter().sum::<usize>();
        match self.modulation {
            Modulation::None => 0,
            Modulation::Gates => gates,
            Modulation::GatesAndPhases => gates + self.sinusoid_count / 2,
        }
    }

    /// Gates start at 1, whatever the code; phases at random, as any layer.
    pub(super) fn random_modulation(&self, rng: &mut impl Rng) -> Option<DenseLayer> {
        let code_count = self.sequence_code_count + self.action_code_count;
        let rows = self.modulation_rows();
        let gates = self.hidden_widths.iter().sum::<usize>();
        (rows > 0).then(|| {
            let mut layer = DenseLayer::zeros(code_count, rows);
            let phases = DenseLayer::random(code_count, rows - gates, rng);
            layer.weights[gates * code_count..].copy_from_slice(&phases.weights);
            layer
        })
    }
}

impl FloatModel {
    /// Rows of `modulation` that are the gates of a hidden layer; empty without modulation.
    pub fn gate_rows(&self, layer: usize) -> Range<usize> {
        if self.modulation.is_none() || layer + 1 >= self.layers.len() {
            return 0..0;
        }
        let start = self.layers[..layer].iter().map(|layer| layer.output_count).sum();
        start..start + self.layers[layer].output_count
    }

    /// Rows of `modulation` that are the phases of the frequencies; empty without.
    pub fn phase_rows(&self) -> Range<usize> {
        let hidden = &self.layers[..self.layers.len() - 1];
        let gates = hidden.iter().map(|layer| layer.output_count).sum();
        self.modulation.as_ref().map_or(0..0, |layer| gates..layer.output_count)
    }

    /// Whether frequencies have phases.
    pub fn has_phases(&self) -> bool {
        !self.phase_rows().is_empty()
    }

    /// All layers that are trained: the decoder's, then gates and phases.
    pub fn trained_layers(&self) -> impl Iterator<Item = &DenseLayer> + Clone {
        self.layers.iter().chain(&self.modulation)
    }

    /// The same, to be moved.
    pub fn trained_layers_mut(&mut self) -> impl Iterator<Item = &mut DenseLayer> {
        self.layers.iter_mut().chain(&mut self.modulation)
    }
}

/// Turns τ by phases: `[sin(a + φ), cos(a + φ)]` from `[sin a, cos a]`.
pub(super) fn turn(tau: &[f32], phases: &[f32], turned: &mut [f32]) {
    let pairs = turned.chunks_exact_mut(2).zip(tau.chunks_exact(2));
    for ((turned, tau), phase) in pairs.zip(phases) {
        let (sine, cosine) = phase.sin_cos();
        turned[0] = tau[0] * cosine + tau[1] * sine;
        turned[1] = tau[1] * cosine - tau[0] * sine;
    }
}

/// The gradient by phases, from that by the sinusoids that they turned.
pub(super) fn phase_gradient(turned: &[f32], gradient: &[f32], by_phase: &mut [f32]) {
    let pairs = turned.chunks_exact(2).zip(gradient.chunks_exact(2));
    for (by_phase, (turned, gradient)) in by_phase.iter_mut().zip(pairs) {
        *by_phase = gradient[0] * turned[1] - gradient[1] * turned[0];
    }
}
