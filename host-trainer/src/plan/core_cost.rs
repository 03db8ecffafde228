//! What a pose costs on a core, by a model of three numbers: products, rows, sinusoids.
//!
//! In:  a checked blob.
//! Out: instructions, code, stack, to `plan.rs`.
//!
//! Why here: counting takes an emulator and a cross-compiler (`firmware-sim bench`); a plan should take neither. The
//! kernels' loops cost one factor a multiply-accumulate and one a row; activation and requantisation cost one a row,
//! the time embedding one a sinusoid. Gates and phases (presets `small`, `tiny`) add a little for each.
//! Source: solved from `tests/golden/instructions.csv`, two networks, with their kernels counted apart;
//! `tests/plan_costs.rs` holds every number against the table. Gates and phases: two blobs
//! of HumanAct12, counted once, which the model then meets within 1 %. Cycles: `firmware-sim`'s estimate of each core.

use karakuri::manifest::{CODE_LAYER, TIME_LAYER};
use karakuri::{Model, NumberFormat};

/// A processor core that boards have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Core {
    /// Armv6-M.
    CortexM0Plus,
    /// Armv7E-M.
    CortexM4,
    /// Armv7E-M with two instructions a cycle.
    CortexM7,
    /// Armv8-M with DSP instructions.
    CortexM33,
}

impl Core {
    /// Every core.
    pub const ALL: [Self; 4] =
        [Self::CortexM0Plus, Self::CortexM4, Self::CortexM7, Self::CortexM33];

    /// The name in reports, the same as that of the simulator's target.
    pub const fn name(self) -> &'static str {
        match self {
            Self::CortexM0Plus => "cortex-m0plus",
            Self::CortexM4 => "cortex-m4",
            Self::CortexM7 => "cortex-m7",
            Self::CortexM33 => "cortex-m33",
        }
    }

    /// Cycles of an instruction on memory without wait states; assumed, not measured on silicon.
    pub fn cycles_per_instruction(self, format: NumberFormat) -> f64 {
        match (self, format == NumberFormat::F16) {
            (Self::CortexM0Plus, _) => 1.2,
            (Self::CortexM4 | Self::CortexM33, false) => 1.4,
            (Self::CortexM4 | Self::CortexM33, true) => 2.2,
            (Self::CortexM7, false) => 0.7,
            (Self::CortexM7, true) => 1.1,
        }
    }

    /// Instructions of a pose for one gate or phase.
    const fn instructions_per_modulation(self) -> f64 {
        match self {
            Self::CortexM0Plus => 13.0,
            _ => 6.0,
        }
    }

    /// Instructions of a pose.
    pub fn pose_instructions(self, format: NumberFormat, work: &PoseWork) -> f64 {
        let [product, row, sinusoid] = self.cost(format).instructions;
        product * work.multiply_accumulates as f64
            + row * work.rows as f64
            + sinusoid * work.sinusoids as f64
            + self.instructions_per_modulation() * work.modulations as f64
    }

    /// What one number format costs on this core.
    pub const fn cost(self, format: NumberFormat) -> CoreCost {
        match (self, format) {
            (Self::CortexM0Plus, NumberFormat::W8A16) => {
                CoreCost::new([4.185, 128.7, 126.7], 25_288, 748)
            }
            (Self::CortexM0Plus, NumberFormat::W8A8) => {
                CoreCost::new([3.623, 130.9, 132.7], 25_612, 748)
            }
            (Self::CortexM0Plus, NumberFormat::W4A8) => {
                CoreCost::new([4.204, 136.2, 128.3], 28_332, 840)
            }
            // Floats in software.
            (Self::CortexM0Plus, NumberFormat::F16) => {
                CoreCost::new([353.343, 762.4, 0.0], 33_112, 740)
            }
            (Self::CortexM4, NumberFormat::W8A16) => {
                CoreCost::new([1.140, 46.8, 72.6], 22_496, 600)
            }
            (Self::CortexM4, NumberFormat::W8A8) => CoreCost::new([0.866, 49.4, 77.2], 23_128, 604),
            (Self::CortexM4, NumberFormat::W4A8) => CoreCost::new([0.989, 56.2, 74.2], 26_720, 648),
            (Self::CortexM4, NumberFormat::F16) => CoreCost::new([2.127, 30.4, 58.4], 28_464, 600),
            (Self::CortexM7, NumberFormat::W8A16) => {
                CoreCost::new([1.140, 46.8, 72.4], 22_820, 600)
            }
            (Self::CortexM7, NumberFormat::W8A8) => CoreCost::new([0.866, 49.4, 77.0], 23_468, 604),
            (Self::CortexM7, NumberFormat::W4A8) => CoreCost::new([0.989, 56.9, 74.5], 27_044, 648),
            (Self::CortexM7, NumberFormat::F16) => CoreCost::new([2.127, 30.6, 58.3], 28_764, 608),
            (Self::CortexM33, NumberFormat::W8A16) => {
                CoreCost::new([1.140, 46.8, 72.6], 22_640, 600)
            }
            (Self::CortexM33, NumberFormat::W8A8) => {
                CoreCost::new([0.866, 49.4, 77.2], 23_272, 604)
            }
            (Self::CortexM33, NumberFormat::W4A8) => {
                CoreCost::new([0.989, 56.2, 74.2], 26_868, 648)
            }
            (Self::CortexM33, NumberFormat::F16) => CoreCost::new([2.127, 30.4, 58.4], 28_492, 600),
        }
    }
}

/// What decoding costs on a core in one number format.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoreCost {
    /// Instructions a multiply-accumulate, a row of a layer, a sinusoid.
    pub instructions: [f64; 3],
    /// Flash of code and tables: loader, sampler, decoder.
    pub code_bytes: u32,
    /// Deepest stack, the loader's included.
    pub stack_bytes: u32,
}

impl CoreCost {
    const fn new(instructions: [f64; 3], code_bytes: u32, stack_bytes: u32) -> Self {
        Self { instructions, code_bytes, stack_bytes }
    }
}

/// What a pose takes, whatever the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoseWork {
    /// Products of all layers after the code half.
    pub multiply_accumulates: u64,
    /// Outputs of all of them.
    pub rows: u64,
    /// Inputs of the time half.
    pub sinusoids: u64,
    /// Gates and phases.
    pub modulations: u64,
}

impl PoseWork {
    /// Of layers given as (inputs, outputs), the code half not among them, without gates and phases.
    pub fn of_layers(layers: impl Iterator<Item = (u16, u16)> + Clone) -> Self {
        Self {
            multiply_accumulates: layers
                .clone()
                .map(|(inputs, outputs)| u64::from(inputs) * u64::from(outputs))
                .sum(),
            rows: layers.clone().map(|(_, outputs)| u64::from(outputs)).sum(),
            sinusoids: layers.clone().next().map_or(0, |(inputs, _)| u64::from(inputs)),
            modulations: 0,
        }
    }

    /// Of a blob.
    pub fn of_model(model: &Model<'_>) -> Self {
        let shapes = &model.manifest().layers;
        let layers = shapes.iter().skip(TIME_LAYER);
        // The code half has a row for each row of the time half, then one for each gate and phase.
        let rows =
            |layer: usize| shapes.get(layer).map_or(0, |shape| u64::from(shape.output_count));
        Self {
            modulations: rows(CODE_LAYER).saturating_sub(rows(TIME_LAYER)),
            ..Self::of_layers(layers.map(|shape| (shape.input_count, shape.output_count)))
        }
    }
}
