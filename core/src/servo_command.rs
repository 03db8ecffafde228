//! Station 10: what goes out to the servos at one tick.
//!
//! In:  pulses and interventions from `servo.rs`.
//! Out: to whatever makes the pulses: PWM, PCA9685, serial bus, simulator.

use crate::limits::SERVOS_MAX;
use crate::servo_limiter::Intervention;

/// Pulse widths of all servos at one tick, in the order of the [`ServoMap`](crate::ServoMap)s. At most 88 bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServoCommand {
    pulses_us: heapless::Vec<u16, SERVOS_MAX>,
    /// Bit i: servo i.
    range_limited: u32,
    speed_limited: u32,
    acceleration_limited: u32,
}

// A bit for every servo.
const _: () = assert!(SERVOS_MAX <= u32::BITS as usize);

impl ServoCommand {
    /// Pulse widths, microseconds; 0 is no pulse at all: the servo is released.
    pub fn pulses_us(&self) -> &[u16] {
        &self.pulses_us
    }

    /// Whether no servo gets a pulse.
    pub fn is_released(&self) -> bool {
        self.pulses_us.iter().all(|&pulse_us| pulse_us == 0)
    }

    /// Whether the pose asks this servo for a pulse beyond its range.
    pub fn is_range_limited(&self, servo: usize) -> bool {
        bit(self.range_limited, servo)
    }

    /// Whether this servo is at least a microsecond from where it should be because of its speed limit.
    pub fn is_speed_limited(&self, servo: usize) -> bool {
        bit(self.speed_limited, servo)
    }

    /// The same because of its acceleration limit, which also brakes it before an end of its range and before its goal.
    pub fn is_acceleration_limited(&self, servo: usize) -> bool {
        bit(self.acceleration_limited, servo)
    }

    /// Servos that are not where the pose wants them, whatever the reason; bit i: servo i.
    pub fn limited_servos(&self) -> u32 {
        self.range_limited | self.speed_limited | self.acceleration_limited
    }

    /// One more servo, without a pulse; `Err` where none fits.
    pub(crate) fn push(&mut self) -> Result<(), u16> {
        self.pulses_us.push(0)
    }

    /// No pulses.
    pub(crate) fn release(&mut self) {
        self.pulses_us.iter_mut().for_each(|pulse_us| *pulse_us = 0);
        self.clear();
    }

    pub(crate) fn pulses_us_mut(&mut self) -> impl Iterator<Item = &mut u16> {
        self.pulses_us.iter_mut()
    }

    /// Forgets the interventions of the last tick.
    pub(crate) fn clear(&mut self) {
        (self.range_limited, self.speed_limited, self.acceleration_limited) = (0, 0, 0);
    }

    pub(crate) fn note(&mut self, servo: usize, is_in_range: bool, intervention: Intervention) {
        let bit = 1u32.unbounded_shl(servo as u32);
        if !is_in_range {
            self.range_limited |= bit;
        }
        match intervention {
            Intervention::None => {}
            Intervention::Speed => self.speed_limited |= bit,
            Intervention::Acceleration => self.acceleration_limited |= bit,
        }
    }
}

fn bit(bits: u32, servo: usize) -> bool {
    bits.unbounded_shr(servo as u32) & 1 == 1
}
