//! The boards that a plan can be made for.
//!
//! Why here: what a data sheet says and what is assumed about a part stand side by side, once.
//!
//! Source: makers' data sheets for clocks and sizes. How long weights take from flash is *assumed*: QSPI flash at four
//! bits a clock of half the processor's (RP2040, RP2350); 128-bit lines with 3 wait states at 100 MHz, of which a
//! stream of weights misses every one (STM32F4); 2 wait states a word (nRF52840); a line of 32 bytes in 16 cycles
//! (STM32H7).

use super::core_cost::Core;

/// A board, or the part on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Board {
    /// Raspberry Pi Pico: RP2040
    Rp2040,
    /// Raspberry Pi Pico 2: RP2350
    Rp2350,
    /// STM32F411, as on the Black Pill
    Stm32f4,
    /// Nordic nRF52840
    Nrf52840,
    /// STM32H743
    Stm32h7,
}

/// What a plan has to know of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Its name.
    pub name: &'static str,
    /// Its processor.
    pub core: Core,
    /// Its highest clock.
    pub clock_mhz: u32,
    /// Flash.
    pub flash_bytes: usize,
    /// RAM, all banks.
    pub ram_bytes: usize,
    /// Cycles that a byte of weights takes longer from flash than from RAM.
    pub flash_cycles_per_byte: f64,
}

impl Board {
    /// The part.
    pub const fn part(self) -> Part {
        let (name, core, clock_mhz, flash_kib, ram_kib, flash_cycles_per_byte) = match self {
            Self::Rp2040 => ("RP2040", Core::CortexM0Plus, 133, 2048, 264, 4.0),
            Self::Rp2350 => ("RP2350", Core::CortexM33, 150, 4096, 520, 4.0),
            Self::Stm32f4 => ("STM32F411", Core::CortexM4, 100, 512, 128, 3.0 / 16.0),
            Self::Nrf52840 => ("nRF52840", Core::CortexM4, 64, 1024, 256, 0.5),
            Self::Stm32h7 => ("STM32H743", Core::CortexM7, 480, 2048, 1024, 0.5),
        };
        Part {
            name,
            core,
            clock_mhz,
            flash_bytes: flash_kib << 10,
            ram_bytes: ram_kib << 10,
            flash_cycles_per_byte,
        }
    }
}
