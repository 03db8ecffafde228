//! Whether commands keep the limits of their servos, by a judge that knows nothing of the limiter.
//!
//! In:  commands and the time between them; what calibration promises.
//! Out: [`Violation`]s.
//!
//! Why here: the same code that limits must not be what finds it right. This one sees pulses in whole microseconds, and
//! knows their rounding.

use karakuri::ServoMap;
use serde::Serialize;

/// A command that asks a servo for what it must not do.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// The tick.
    pub tick: u32,
    /// The servo.
    pub servo: usize,
    /// What was broken: `range`, `speed` or `acceleration`.
    pub limit: &'static str,
    /// How much was asked for: µs, µs/s, µs/s².
    pub value: f64,
    /// How much is allowed, rounding of pulses included.
    pub max: f64,
}

/// What was asked of a servo within the last two ticks.
#[derive(Clone, Copy, Debug, Default)]
struct Last {
    pulse_us: f64,
    /// Mean over the tick before, and its length.
    speed: Option<(f64, f64)>,
}

/// The judge.
#[derive(Clone, Debug)]
pub struct Monitor {
    maps: Vec<ServoMap>,
    last: Vec<Option<Last>>,
}

impl Monitor {
    /// Judges commands to these servos.
    pub fn new(maps: Vec<ServoMap>) -> Self {
        Self { last: vec![None; maps.len()], maps }
    }

    /// Takes a command that was sent `elapsed_us` after the one before. Servos that were released may begin anywhere:
    /// nobody knows where they stood.
    pub fn judge(&mut self, tick: u32, elapsed_us: u32, pulses: &[Option<u16>]) -> Vec<Violation> {
        let elapsed_s = f64::from(elapsed_us) / 1e6;
        let mut violations = Vec::new();
        for (servo, (map, last)) in self.maps.iter().zip(&mut self.last).enumerate() {
            let Some(pulse_us) = pulses.get(servo).copied().flatten().map(f64::from) else {
                *last = None;
                continue;
            };
            let mut found = |limit, value: f64, max: f64| {
                if value > max {
                    violations.push(Violation { tick, servo, limit, value, max });
                }
            };
            let [min_us, _, max_us] = map.pulses_us().map(f64::from);
            found("range", pulse_us, max_us);
            found("range", -pulse_us, -min_us);
            let Some(before) = *last else {
                *last = Some(Last { pulse_us, speed: None });
                continue;
            };
            if elapsed_s <= 0.0 {
                found("speed", (pulse_us - before.pulse_us).abs(), 0.0);
                continue;
            }
            let limits = map.limits();
            let speed = (pulse_us - before.pulse_us) / elapsed_s;
            // Both pulses are rounded by half a microsecond at the most.
            let speed_max = f64::from(limits.pulse_us_per_s_max) + 1.0 / elapsed_s;
            found("speed", speed.abs(), speed_max);
            if let Some((speed_before, elapsed_before_s)) = before.speed {
                // Mean speeds of two neighbouring spans differ by at most the limit times what lies between their
                // middles.
                let apart_s = 0.5 * (elapsed_s + elapsed_before_s);
                let rounding = 1.0 / elapsed_s + 1.0 / elapsed_before_s;
                let change = (speed - speed_before).abs() / apart_s;
                let allowed = f64::from(limits.pulse_us_per_s2_max) + rounding / apart_s;
                found("acceleration", change, allowed);
            }
            *last = Some(Last { pulse_us, speed: Some((speed, elapsed_s)) });
        }
        violations
    }
}
