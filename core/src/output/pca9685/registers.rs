//! What the registers of a PCA9685 should hold, and what they are known to hold.

use super::OUTPUTS;

const MODE1: u8 = 0x00;
const MODE1_SLEEP: u8 = 0x10;
const MODE1_AUTO_INCREMENT: u8 = 0x20;
const MODE2: u8 = 0x01;
const MODE2_PUSH_PULL: u8 = 0x04;
const OUTPUT_0: u8 = 0x06;
const ALL_OUTPUTS_OFF_HIGH: u8 = 0xFD;
const FULLY_OFF: u8 = 0x10;
const PRESCALE: u8 = 0xFE;

const STEPS: u32 = 4096;
const BYTES_PER_OUTPUT: usize = 4;

/// Steps of a pulse; not a value of 12 bits where nobody knows.
const UNKNOWN: u16 = u16::MAX;

/// Registers of one chip.
#[derive(Clone, Debug)]
pub(super) struct Registers {
    prescale: u8,
    steps_per_us_q20: u32,
    /// Steps of each output's pulse; 0: none.
    asked: [u16; OUTPUTS],
    /// The same, as far as writing it has succeeded.
    written: [u16; OUTPUTS],
    /// The address of a register and what goes there and after it.
    burst: [u8; 1 + OUTPUTS * BYTES_PER_OUTPUT],
}

impl Registers {
    /// No pulses are asked for, nothing is known to be written. The oscillator has 20 to 30 MHz, the rate is 40 to
    /// 400 Hz.
    pub fn new(oscillator_hz: u32, rate_hz: u16) -> Self {
        let steps_per_s = STEPS * u32::from(rate_hz.max(1));
        let divider = ((oscillator_hz + steps_per_s / 2) / steps_per_s).clamp(4, 256);
        let steps_per_us_q20 = (u64::from(oscillator_hz) << 20) / (u64::from(divider) * 1_000_000);
        Self {
            prescale: (divider - 1) as u8,
            steps_per_us_q20: steps_per_us_q20 as u32,
            asked: [0; OUTPUTS],
            written: [UNKNOWN; OUTPUTS],
            burst: [0; 1 + OUTPUTS * BYTES_PER_OUTPUT],
        }
    }

    /// Register and value, in this order: no pulses, asleep, rate (only heard asleep), push-pull outputs, awake.
    pub fn start_up(&self) -> [[u8; 2]; 5] {
        [
            [ALL_OUTPUTS_OFF_HIGH, FULLY_OFF],
            [MODE1, MODE1_SLEEP | MODE1_AUTO_INCREMENT],
            [PRESCALE, self.prescale],
            [MODE2, MODE2_PUSH_PULL],
            [MODE1, MODE1_AUTO_INCREMENT],
        ]
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        self.written = [UNKNOWN; OUTPUTS];
    }

    /// What to write so that these pulses are made, if anything. Until [`confirm`](Self::confirm) nobody knows
    /// whether it was.
    pub fn burst(&mut self, pulses_us: &[u16]) -> Option<&[u8]> {
        for (asked, &pulse_us) in self.asked.iter_mut().zip(pulses_us) {
            *asked = steps(pulse_us, self.steps_per_us_q20);
        }
        let outputs = self.asked.iter().zip(&self.written);
        let mut changed = outputs.enumerate().filter(|(_, (asked, written))| asked != written);
        let (first, _) = changed.next()?;
        let last = changed.next_back().map_or(first, |(last, _)| last);
        let count = last + 1 - first;
        let (register, places) = self.burst.split_first_mut()?;
        *register = OUTPUT_0 + (first * BYTES_PER_OUTPUT) as u8;
        let outputs = self.asked.iter().zip(&mut self.written).skip(first).take(count);
        for ((asked, written), place) in outputs.zip(places.chunks_exact_mut(BYTES_PER_OUTPUT)) {
            *written = UNKNOWN;
            let [low, high] = asked.to_le_bytes();
            let off_high = if *asked == 0 { FULLY_OFF } else { high };
            // On at step 0 of the period.
            place.copy_from_slice(&[0, 0, low, off_high]);
        }
        self.burst.get(..1 + count * BYTES_PER_OUTPUT)
    }

    /// The last burst has been written.
    pub fn confirm(&mut self) {
        self.written = self.asked;
    }
}

/// Nearest step, ties up; the longest pulse is a step shorter than the period. No pulse is 0, and so is one shorter
/// than half a step.
fn steps(pulse_us: u16, steps_per_us_q20: u32) -> u16 {
    let steps_q20 = u64::from(pulse_us) * u64::from(steps_per_us_q20);
    let rounded = (steps_q20 + (1 << 19)) >> 20;
    rounded.min(u64::from(STEPS - 1)) as u16
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn rate_of_fifty_is_the_usual_prescale() {
        assert_eq!(Registers::new(25_000_000, 50).prescale, 121);
        assert_eq!(Registers::new(27_000_000, 50).prescale, 131);
        assert_eq!(Registers::new(20_000_000, 400).prescale, 11);
        assert_eq!(Registers::new(30_000_000, 40).prescale, 182);
    }

    proptest! {
        #[test]
        fn pulse_is_within_half_a_step(pulse_us in 3_u16..2600, oscillator_hz in 20_000_000_u32..=30_000_000,
                                       rate_hz in 40_u16..=300) {
            let registers = Registers::new(oscillator_hz, rate_hz);
            let steps = steps(pulse_us, registers.steps_per_us_q20);
            let divider = f64::from(registers.prescale) + 1.0;
            let exact = f64::from(pulse_us) * f64::from(oscillator_hz) / divider / 1e6;
            prop_assert!(steps < 4096 && (f64::from(steps) - exact).abs() < 0.5 + exact / 32_768.0);
        }
    }
}
