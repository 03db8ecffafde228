//! Instructions → poses per second, as an estimate that says what it assumes.
//!
//! Why here: nobody plans a product with instructions. What turns them into time was not measured on silicon; the
//! figures below are a model of each core on memory without wait states, and flash adds to it.
//!
//! Source: `shared/notes/embedded.md`: sections 1 (columns "model c/MAC" over "instr/MAC") and 2 for the issue widths
//! of the M7 and M55; the makers' data sheets for clocks.

use karakuri::NumberFormat;
use serde::Serialize;

use crate::target::Target;

/// What every report of counts has to say.
pub const QEMU_COUNTS_INSTRUCTIONS: &str =
    "QEMU counts instructions, not cycles: it models no pipeline, no flash and no cache.";

/// Poses per second of a part, and all that this rests on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// A part with this core.
    pub part: &'static str,
    /// Its clock.
    pub clock_mhz: u32,
    /// Assumed.
    pub cycles_per_instruction: f64,
    /// Clock over instructions and cycles per instruction.
    pub poses_per_second: f64,
}

impl Estimate {
    /// For a pose of so many instructions.
    pub fn new(target: Target, format: NumberFormat, instructions_per_pose: u64) -> Self {
        let (part, clock_mhz) = part(target);
        let cycles_per_instruction = cycles_per_instruction(target, format);
        let cycles = instructions_per_pose as f64 * cycles_per_instruction;
        let poses_per_second = f64::from(clock_mhz) * 1e6 / cycles.max(1.0);
        Self { part, clock_mhz, cycles_per_instruction, poses_per_second }
    }
}

/// A well-known part of each core, and its highest clock in MHz.
fn part(target: Target) -> (&'static str, u32) {
    match target {
        Target::CortexM0Plus => ("RP2040", 133),
        Target::CortexM3 => ("STM32F103", 72),
        Target::CortexM4 => ("STM32F407", 168),
        Target::CortexM7 => ("STM32H743", 480),
        Target::CortexM33 => ("RP2350", 150),
        Target::CortexM55 => ("Alif E1", 160),
    }
}

/// Integer loops: loads of several words, single-cycle products (M3: two cycles), taken branches of three cycles; the
/// M7 issues up to two at a time, the M55 overlaps loads with products. Float loops: VMLA takes three cycles on the M4
/// and M33; a part without an FPU runs integer code.
fn cycles_per_instruction(target: Target, format: NumberFormat) -> f64 {
    let is_float = format == NumberFormat::F16;
    match target {
        Target::CortexM0Plus => 1.2,
        Target::CortexM3 => 1.4,
        Target::CortexM4 | Target::CortexM33 => {
            if is_float {
                2.2
            } else {
                1.4
            }
        }
        Target::CortexM7 => {
            if is_float {
                1.1
            } else {
                0.7
            }
        }
        Target::CortexM55 => 1.2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimate_is_clock_over_cycles() {
        let estimate = Estimate::new(Target::CortexM4, NumberFormat::W8A16, 1_500_000);
        assert_eq!(estimate.clock_mhz, 168);
        assert!((estimate.poses_per_second - 80.0).abs() < 1e-9);
    }
}
