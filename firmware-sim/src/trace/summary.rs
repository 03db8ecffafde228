//! A trace in a few numbers: how far and how fast every servo goes, and how often a limit
//! intervenes.

use karakuri::ServoCommand;
use serde::Serialize;

use super::{Options, Tick, Trace};

/// A trace in a few numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Model, number format and hash of the configuration.
    pub provenance: String,
    /// What was traced, with the length that it really has.
    #[serde(flatten)]
    pub options: Options,
    /// Number of commands.
    pub tick_count: usize,
    /// One for every servo.
    pub servos: Vec<ServoSummary>,
}

/// What one servo goes through.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ServoSummary {
    /// Name of its channel.
    pub name: String,
    /// Shortest, neutral and longest pulse that it may have.
    pub pulses_us: [u16; 3],
    /// Shortest pulse.
    pub pulse_us_min: u16,
    /// Longest pulse.
    pub pulse_us_max: u16,
    /// Largest change from tick to tick, per second; of whole microseconds, so up to 1 µs a tick
    /// above the limit.
    pub us_per_s_max: f64,
    /// Share of the ticks at which the pose asked for a pulse beyond the range, 0 to 1.
    pub range_limited_share: f64,
    /// Share of the ticks at which the servo could not follow because of its speed limit, 0 to 1.
    pub speed_limited_share: f64,
    /// The same because of its acceleration limit.
    pub acceleration_limited_share: f64,
}

impl Trace {
    /// What every servo goes through.
    pub fn summary(&self) -> Summary {
        let servos = self.servos.iter().enumerate();
        Summary {
            provenance: self.provenance.clone(),
            options: self.options.clone(),
            tick_count: self.ticks.len(),
            servos: servos.map(|(servo, name)| self.servo_summary(servo, name)).collect(),
        }
    }

    fn servo_summary(&self, servo: usize, name: &str) -> ServoSummary {
        let pulse_us = |tick: &Tick| tick.command.pulses_us().get(servo).copied();
        let pulses_us = || self.ticks.iter().filter_map(pulse_us);
        let speeds_us_per_s = self.ticks.windows(2).filter_map(|pair| {
            let travel_us = pulse_us(&pair[0])?.abs_diff(pulse_us(&pair[1])?);
            Some(f64::from(travel_us) * 1e6 / f64::from(pair[1].time_us - pair[0].time_us))
        });
        // No time passes before the first tick: it says nothing about limits.
        let moving = self.ticks.get(1..).unwrap_or_default();
        let share = |is_limited: fn(&ServoCommand, usize) -> bool| {
            let count = moving.iter().filter(|tick| is_limited(&tick.command, servo)).count();
            count as f64 / moving.len().max(1) as f64
        };
        ServoSummary {
            name: name.to_owned(),
            pulses_us: self.maps.get(servo).map_or([0; 3], |map| map.pulses_us()),
            pulse_us_min: pulses_us().min().unwrap_or_default(),
            pulse_us_max: pulses_us().max().unwrap_or_default(),
            us_per_s_max: speeds_us_per_s.fold(0.0, f64::max),
            range_limited_share: share(ServoCommand::is_range_limited),
            speed_limited_share: share(ServoCommand::is_speed_limited),
            acceleration_limited_share: share(ServoCommand::is_acceleration_limited),
        }
    }
}
