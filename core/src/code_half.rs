//! What the rows of the code half of layer 1 are: starts of layer 1, then gates, then phases.
//!
//! In:  the shapes that a manifest names.
//! Out: where each kind of row begins, to the decoder; whether they fit, to the loader.
//!
//! Why here: what follows from a motion's code is computed once a motion, so it is one layer, and old blobs, whose code
//! half has rows for layer 1 alone, mean what they always meant.

use crate::manifest::{CODE_LAYER, LayerShape, Manifest, TIME_LAYER};

/// Largest gate: what the 1 of a gate's row stands for.
pub const GATE_MAX: u32 = 2;

impl Manifest<'_> {
    /// Whether the decoder has gates: the code half then has a row for each behind those of layer 1.
    ///
    /// A gate multiplies the sum of a hidden unit by what a row of the code half makes of a motion's code: 0 to 1 in
    /// Q0.16, times [`GATE_MAX`] (in `f16` 0 to 1). Rows come layer after layer, each layer's filled up to a multiple
    /// of 4, layer 1's own too.
    pub fn has_gates(&self) -> bool {
        self.rows_of(CODE_LAYER) != self.rows_of(TIME_LAYER)
    }

    /// Whether every frequency has a phase besides: a row of the code half behind the gates, filled up like them, in
    /// turns (Q16).
    pub fn has_phases(&self) -> bool {
        self.has_gates() && self.rows_of(CODE_LAYER) > self.phase_row()
    }

    /// The code half's row of the first gate, behind those of layer 1.
    pub(crate) fn gate_row(&self) -> usize {
        self.layers.get(TIME_LAYER).map_or(0, LayerShape::rows_filled)
    }

    /// The code half's row of the first phase.
    pub(crate) fn phase_row(&self) -> usize {
        let hidden = self.layers.len().saturating_sub(1);
        let filled = |shape: &LayerShape| shape.rows_filled();
        let gates: usize = self.layers.iter().take(hidden).skip(TIME_LAYER).map(filled).sum();
        self.gate_row() + gates
    }

    /// Outputs of the code half: those of layer 1, or those and the gates, or those and gates and phases.
    pub(crate) fn code_rows_suit(&self) -> bool {
        let phases = usize::from(self.frequency_count).next_multiple_of(4);
        let rows = self.rows_of(CODE_LAYER);
        !self.has_gates() || rows == self.phase_row() || rows == self.phase_row() + phases
    }

    fn rows_of(&self, index: usize) -> usize {
        self.layers.get(index).map_or(0, |shape| usize::from(shape.output_count))
    }
}
