//! PCA9685: sixteen servos at one I²C address.
//!
//! In:  pulses in microseconds, the frequency of the chip's oscillator.
//! Out: bursts of register writes.
//!
//! Why here: `pwm-pca9685` knows registers but neither microseconds nor the oscillator, which is off by up to 8 %
//! from chip to chip. Everything but the two lines that touch the bus is `pca9685/registers.rs`, the same for both
//! traits. Source: NXP PCA9685 data sheet, rev. 4, sections 7.3 and 7.4.

mod registers;

use registers::Registers;

/// Outputs of one chip.
const OUTPUTS: usize = 16;

/// From the oscillator's start until it runs.
const START_US: u32 = 500;

/// How a chip is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pca9685Settings {
    /// I²C address, 0x40 to 0x7F.
    pub address: u8,
    /// Frequency of its oscillator: 25 MHz by the data sheet, 23 to 27 MHz as found. To find it, command 1500 µs,
    /// measure t µs with an oscilloscope, and multiply by 1500 / t.
    pub oscillator_hz: u32,
    /// Pulses a second, for most servos 50.
    pub rate_hz: u16,
}

impl Default for Pca9685Settings {
    fn default() -> Self {
        Self { address: 0x40, oscillator_hz: 25_000_000, rate_hz: 50 }
    }
}

/// Why a chip could not be set up or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pca9685Error<E> {
    /// The bus failed. What was to be written is written by the next call.
    Bus(E),
    /// No PCA9685 has this oscillator: 20 to 30 MHz.
    BadOscillator {
        /// Frequency in the settings.
        oscillator_hz: u32,
    },
    /// The chip cannot make this rate: 40 to 400 a second.
    BadRate {
        /// Rate in the settings.
        rate_hz: u16,
    },
}

/// One chip and its bus. About 150 bytes.
#[derive(Clone, Debug)]
pub struct Pca9685<I2C> {
    bus: I2C,
    address: u8,
    registers: Registers,
}

impl<I2C> Pca9685<I2C> {
    /// Forgets what was written, so that the next write sends everything: after the chip, but not this program, lost
    /// its supply. It must then be started again as well.
    pub fn forget(&mut self) {
        self.registers.forget();
    }

    /// The bus.
    pub fn release(self) -> I2C {
        self.bus
    }

    fn new<E>(bus: I2C, settings: Pca9685Settings) -> Result<Self, Pca9685Error<E>> {
        let Pca9685Settings { address, oscillator_hz, rate_hz } = settings;
        if !(20_000_000..=30_000_000).contains(&oscillator_hz) {
            return Err(Pca9685Error::BadOscillator { oscillator_hz });
        }
        if !(40..=400).contains(&rate_hz) {
            return Err(Pca9685Error::BadRate { rate_hz });
        }
        Ok(Self { bus, address, registers: Registers::new(oscillator_hz, rate_hz) })
    }
}

#[cfg(feature = "embedded-hal-1")]
impl<I2C: embedded_hal::i2c::I2c> Pca9685<I2C> {
    /// Sets the chip up, without a pulse at any output, and waits until its oscillator runs.
    ///
    /// # Errors
    /// [`Pca9685Error`].
    pub fn start(
        bus: I2C,
        settings: Pca9685Settings,
        delay: &mut impl embedded_hal::delay::DelayNs,
    ) -> Result<Self, Pca9685Error<I2C::Error>> {
        let mut chip = Self::new(bus, settings)?;
        for write in chip.registers.start_up() {
            chip.bus.write(chip.address, &write).map_err(Pca9685Error::Bus)?;
        }
        delay.delay_us(START_US);
        Ok(chip)
    }

    /// Makes pulses of these widths, microseconds, 0: none; outputs beyond them stay as they are, pulses beyond the
    /// sixteenth are left out (`pulses_us.chunks(16)` serves several chips). One write from the first output that
    /// changes to the last, after which all change at once; no write where none does.
    ///
    /// # Accuracy
    /// Nearest of 4096 steps a period, ties up: half of 4.9 µs at 50 Hz, plus 1/2^15 of the pulse.
    ///
    /// # Errors
    /// [`Pca9685Error::Bus`]; the next call writes what was not written.
    pub fn write(&mut self, pulses_us: &[u16]) -> Result<(), Pca9685Error<I2C::Error>> {
        if let Some(burst) = self.registers.burst(pulses_us) {
            self.bus.write(self.address, burst).map_err(Pca9685Error::Bus)?;
            self.registers.confirm();
        }
        Ok(())
    }
}

#[cfg(feature = "embedded-hal-async-1")]
impl<I2C: embedded_hal_async::i2c::I2c> Pca9685<I2C> {
    /// [`start`](Self::start) without blocking.
    ///
    /// # Errors
    /// [`Pca9685Error`].
    pub async fn start_async(
        bus: I2C,
        settings: Pca9685Settings,
        delay: &mut impl embedded_hal_async::delay::DelayNs,
    ) -> Result<Self, Pca9685Error<I2C::Error>> {
        let mut chip = Self::new(bus, settings)?;
        for write in chip.registers.start_up() {
            chip.bus.write(chip.address, &write).await.map_err(Pca9685Error::Bus)?;
        }
        delay.delay_us(START_US).await;
        Ok(chip)
    }

    /// [`write`](Self::write) without blocking. Where the write is dropped before its end, the next one sends it
    /// again.
    ///
    /// # Errors
    /// [`Pca9685Error::Bus`].
    pub async fn write_async(&mut self, pulses_us: &[u16]) -> Result<(), Pca9685Error<I2C::Error>> {
        if let Some(burst) = self.registers.burst(pulses_us) {
            self.bus.write(self.address, burst).await.map_err(Pca9685Error::Bus)?;
            self.registers.confirm();
        }
        Ok(())
    }
}

#[cfg(all(test, feature = "embedded-hal-1", feature = "embedded-hal-async-1"))]
mod tests;
