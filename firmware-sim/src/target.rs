//! Which processors can be proved, and on which emulated board.
//!
//! Why here: triple, processor, board and memory map belong together and are written once.
//!
//! Source: QEMU 7.2's documentation of the MPS2 and MPS3 boards; rustc's platform list.

/// A processor that the firmware can be built for and run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
#[value(rename_all = "kebab-case")]
pub enum Target {
    /// Armv6-M. QEMU has no board of this core with room for a blob: its code runs on the M3's board.
    #[value(name = "cortex-m0plus")]
    CortexM0Plus,
    /// Armv7-M.
    CortexM3,
    /// Armv7E-M: DSP instructions and a single-precision FPU.
    CortexM4,
    /// Armv7E-M with a wider pipeline.
    CortexM7,
    /// Armv8-M mainline with DSP instructions.
    CortexM33,
    /// Armv8.1-M with Helium (MVE) vectors.
    CortexM55,
}

impl Target {
    /// Every target, smallest core first.
    pub const ALL: [Self; 6] = [
        Self::CortexM0Plus,
        Self::CortexM3,
        Self::CortexM4,
        Self::CortexM7,
        Self::CortexM33,
        Self::CortexM55,
    ];

    /// The name in commands and reports; also rustc's name of the processor.
    pub const fn name(self) -> &'static str {
        match self {
            Self::CortexM0Plus => "cortex-m0plus",
            Self::CortexM3 => "cortex-m3",
            Self::CortexM4 => "cortex-m4",
            Self::CortexM7 => "cortex-m7",
            Self::CortexM33 => "cortex-m33",
            Self::CortexM55 => "cortex-m55",
        }
    }

    /// rustc's name of the architecture and calling convention.
    pub const fn triple(self) -> &'static str {
        match self {
            Self::CortexM0Plus => "thumbv6m-none-eabi",
            Self::CortexM3 => "thumbv7m-none-eabi",
            Self::CortexM4 | Self::CortexM7 => "thumbv7em-none-eabihf",
            Self::CortexM33 | Self::CortexM55 => "thumbv8m.main-none-eabihf",
        }
    }

    /// QEMU's name of the board.
    pub const fn machine(self) -> &'static str {
        match self {
            Self::CortexM0Plus | Self::CortexM3 => "mps2-an385",
            Self::CortexM4 => "mps2-an386",
            Self::CortexM7 => "mps2-an500",
            Self::CortexM33 => "mps2-an505",
            Self::CortexM55 => "mps3-an547",
        }
    }

    /// QEMU's name of the core on that board.
    pub const fn emulated_core(self) -> &'static str {
        match self {
            Self::CortexM0Plus => Self::CortexM3.name(),
            _ => self.name(),
        }
    }

    /// The board's memory map: a file in `firmware-sim/cortex-m/memory/`.
    pub const fn memory_map(self) -> &'static str {
        match self {
            Self::CortexM33 => "mps2-an505.x",
            Self::CortexM55 => "mps3-an547.x",
            _ => "mps2.x",
        }
    }
}
