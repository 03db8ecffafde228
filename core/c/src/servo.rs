//! The calibration of a servo as C says it.

use karakuri::limits::SERVOS_MAX;
use karakuri::{ServoLimits, ServoMap};

/// `karakuri_servo_t`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
#[allow(missing_docs, reason = "the header says it")]
pub struct CServo {
    pub channel: u16,
    pub pulse_us_min: u16,
    pub pulse_us_neutral: u16,
    pub pulse_us_max: u16,
    pub pulse_us_park: u16,
    pub pulse_us_per_unit_q16: i32,
    pub pulse_us_per_s_max: u32,
    pub pulse_us_per_s2_max: u32,
}

impl CServo {
    fn map(&self) -> Option<ServoMap> {
        let pulses_us = [self.pulse_us_min, self.pulse_us_neutral, self.pulse_us_max];
        let limits = ServoLimits {
            pulse_us_per_s_max: self.pulse_us_per_s_max,
            pulse_us_per_s2_max: self.pulse_us_per_s2_max,
        };
        let map = ServoMap::new(self.channel, pulses_us, self.pulse_us_per_unit_q16, limits);
        map.and_then(|map| map.with_park_at(self.pulse_us_park)).ok()
    }
}

/// The maps of all servos; `None` where one cannot be, or there are too many.
pub(crate) fn maps(servos: &[CServo]) -> Option<Maps> {
    let first = servos.first()?.map()?;
    let mut maps = Maps { maps: [first; SERVOS_MAX], count: servos.len() };
    for (index, servo) in servos.iter().enumerate() {
        *maps.maps.get_mut(index)? = servo.map()?;
    }
    Some(maps)
}

/// Up to [`SERVOS_MAX`] maps.
pub(crate) struct Maps {
    maps: [ServoMap; SERVOS_MAX],
    count: usize,
}

impl core::ops::Deref for Maps {
    type Target = [ServoMap];

    fn deref(&self) -> &[ServoMap] {
        self.maps.get(..self.count).unwrap_or_default()
    }
}
