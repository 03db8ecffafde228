//! A servo that is not there: what becomes of a pulse.
//!
//! In:  the pulses of a command, time.
//! Out: the position of the horn, in microseconds of the pulse that would hold it there.
//!
//! Why here: a command is not a motion. Between the two lie the steps of the PWM, a frame of delay, a dead band and a
//! motor that is only so fast; jerk and what an audience sees are those of the horn.
//!
//! Figures: PCA9685 at 50 Hz (4.88 µs a step); a hobby servo's 60° in 0.1 s, 3 µs of dead band and a lag of 30 ms are
//! assumptions.

use std::collections::VecDeque;

/// How a servo is built.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Build {
    /// Step of the pulse generator, µs.
    pub pwm_step_us: f64,
    /// Ticks until a pulse reaches the motor.
    pub delay_ticks: usize,
    /// The motor does not move for less, µs.
    pub dead_band_us: f64,
    /// Fastest, µs per second.
    pub us_per_s_max: f64,
    /// Time constant of the motor, s.
    pub lag_s: f64,
}

/// A hobby servo behind a PCA9685.
pub const HOBBY_SERVO: Build = Build {
    pwm_step_us: 1e6 / 50.0 / 4096.0,
    delay_ticks: 1,
    dead_band_us: 3.0,
    us_per_s_max: 6000.0,
    lag_s: 0.03,
};

/// One servo.
#[derive(Clone, Debug)]
pub struct VirtualServo {
    build: Build,
    /// `None`: no pulse.
    on_the_way: VecDeque<Option<f64>>,
    position_us: f64,
    speed_us_per_s: f64,
}

impl VirtualServo {
    /// A servo whose horn stands there.
    pub fn new(build: Build, position_us: f64) -> Self {
        Self { build, on_the_way: VecDeque::new(), position_us, speed_us_per_s: 0.0 }
    }

    /// Lets a tick pass in which this pulse was sent (`None`: released), and tells where the horn is.
    pub fn tick(&mut self, pulse_us: Option<u16>, elapsed_s: f64) -> f64 {
        let step_us = self.build.pwm_step_us;
        self.on_the_way.push_back(pulse_us.map(|us| (f64::from(us) / step_us).round() * step_us));
        if self.on_the_way.len() <= self.build.delay_ticks {
            return self.position_us;
        }
        let asked = self.on_the_way.pop_front().flatten();
        let error_us = asked.map_or(0.0, |asked| asked - self.position_us);
        let wanted = if error_us.abs() <= self.build.dead_band_us {
            0.0
        } else {
            error_us / self.build.lag_s
        };
        let limit = self.build.us_per_s_max;
        let share = 1.0 - (-elapsed_s / self.build.lag_s).exp();
        self.speed_us_per_s += (wanted.clamp(-limit, limit) - self.speed_us_per_s) * share;
        let way_us = self.speed_us_per_s * elapsed_s;
        // A motor with a brake does not swing past its goal.
        self.position_us += if way_us.abs() > error_us.abs() { error_us } else { way_us };
        self.position_us
    }
}

#[cfg(test)]
mod tests {
    use super::{HOBBY_SERVO, VirtualServo};

    #[test]
    fn servo_arrives_within_its_dead_band_and_not_faster_than_it_can() {
        let mut servo = VirtualServo::new(HOBBY_SERVO, 1500.0);
        let course: Vec<f64> = (0..100).map(|_| servo.tick(Some(2000), 0.02)).collect();
        assert!((course[99] - 2000.0).abs() < 3.0 + 2.5, "{}", course[99]);
        assert!(course.windows(2).all(|pair| (0.0..=120.0).contains(&(pair[1] - pair[0]))));
        assert_eq!(course[0], 1500.0, "a tick of delay");
    }

    #[test]
    fn servo_without_pulses_stays_where_it_is() {
        let mut servo = VirtualServo::new(HOBBY_SERVO, 1234.0);
        assert!((0..50).all(|_| servo.tick(None, 0.02) == 1234.0));
    }
}
