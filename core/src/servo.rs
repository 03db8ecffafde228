//! Station 10: pose → pulse widths that keep every servo inside its range and its speed.
//!
//! In:  a [`Pose`], the calibration of every servo, the time since the last command.
//! Out: a [`ServoCommand`] to whatever makes the pulses.
//!
//! Why here: the last place before the hardware. No pose, however wrong, may ask a servo for what
//! it cannot do.
//!
//! **Not a safety-rated system.** This stage limits range and speed, nothing else. Still missing:
//! limits of acceleration and jerk (a servo may start and stop at full speed), braking ahead of an
//! end, a watchdog for commands that stop coming, faults of servo and supply, and any knowledge of
//! where a servo really stands: it begins at the neutral pulse, to which a servo that stands
//! elsewhere travels as fast as it can. Keep a hardware power cut.

use crate::error::ServoError;
use crate::limits::SERVOS_MAX;
use crate::pose::Pose;
use crate::servo_map::{PULSE_FRACTION_BITS, ServoMap, pulse_q8};

/// Pulse widths of all servos at one tick, in the order of the [`ServoMap`]s.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServoCommand {
    pulses_us: heapless::Vec<u16, SERVOS_MAX>,
    /// Bit i: servo i.
    range_limited: u32,
    speed_limited: u32,
}

// A bit for every servo.
const _: () = assert!(SERVOS_MAX <= u32::BITS as usize);

impl ServoCommand {
    /// Pulse widths, microseconds.
    pub fn pulses_us(&self) -> &[u16] {
        &self.pulses_us
    }

    /// Whether the pose asked this servo for a pulse beyond its range.
    pub fn is_range_limited(&self, servo: usize) -> bool {
        self.range_limited.unbounded_shr(servo as u32) & 1 == 1
    }

    /// Whether this servo is still on its way to what the pose asked for, because of its speed
    /// limit.
    pub fn is_speed_limited(&self, servo: usize) -> bool {
        self.speed_limited.unbounded_shr(servo as u32) & 1 == 1
    }
}

/// All servos of a robot: their calibration and their last pulses. About 30 bytes a servo, up to
/// the limit; no heap.
#[derive(Clone, Debug)]
pub struct ServoStage {
    maps: heapless::Vec<ServoMap, SERVOS_MAX>,
    /// Last pulses before rounding, in 2^-8 µs.
    pulses_q8: heapless::Vec<i32, SERVOS_MAX>,
    command: ServoCommand,
}

impl ServoStage {
    /// Longest time that one tick makes up for; after a longer pause servos still move only this
    /// far at once.
    pub const ELAPSED_US_MAX: u32 = 100_000;

    /// Servos in their park pose: every pulse neutral.
    ///
    /// # Errors
    /// [`ServoError::TooMany`].
    pub fn new(maps: &[ServoMap]) -> Result<Self, ServoError> {
        let mut stage = Self {
            maps: heapless::Vec::new(),
            pulses_q8: heapless::Vec::new(),
            command: ServoCommand::default(),
        };
        let too_many = ServoError::TooMany { count: maps.len(), max: SERVOS_MAX };
        for &map in maps {
            let neutral_us = map.pulse_us_neutral;
            stage.maps.push(map).map_err(|_| too_many)?;
            stage.pulses_q8.push(pulse_q8(neutral_us) as i32).map_err(|_| too_many)?;
            stage.command.pulses_us.push(neutral_us).map_err(|_| too_many)?;
        }
        Ok(stage)
    }

    /// Moves every servo towards `pose`, as far as range and speed allow since the last call,
    /// `elapsed_us` ago (0: nothing moves). A servo whose channel the pose does not have holds its
    /// pulse.
    ///
    /// # Accuracy
    /// Where no limit intervenes, within 0.502 µs of the exact pulse, 0.29 µs RMS (asserted by
    /// `pulse_error_over_the_whole_range`): to nearest 2^-8 µs, then to nearest µs, ties up. An
    /// angle of a rotation adds its own error: at 10 µs per degree 0.65 µs in all, 0.3 µs RMS
    /// (asserted by `pulse_error_of_three_servos_of_a_rotation`). Over any number of ticks a pulse travels at most
    /// its speed limit, plus 1 µs for the rounding of both ends. A tick moves in steps of 2^-8 µs: at 4 µs/s it must
    /// last a millisecond, at 600 µs/s 7 µs, or nothing moves.
    pub fn command(&mut self, pose: &Pose, elapsed_us: u32) -> &ServoCommand {
        let (mut range_limited, mut speed_limited) = (0, 0);
        let last = self.pulses_q8.iter_mut().zip(self.command.pulses_us.iter_mut());
        for (servo, (map, (last_q8, pulse_us))) in self.maps.iter().zip(last).enumerate() {
            let Some(channel_q16) = map.read_q16(pose) else {
                continue;
            };
            let asked_q8 = map.asked_q8(channel_q16);
            let (min_q8, max_q8) = (pulse_q8(map.pulse_us_min), pulse_q8(map.pulse_us_max));
            let goal_q8 = asked_q8.max(min_q8).min(max_q8);
            let (from_q8, step_q8) = (i64::from(*last_q8), map.step_q8(elapsed_us));
            let next_q8 = goal_q8.max(from_q8 - step_q8).min(from_q8 + step_q8);
            // Between the shortest and the longest pulse, so that it fits both types.
            *last_q8 = next_q8 as i32;
            let rounded_q8 = next_q8 + (1 << (PULSE_FRACTION_BITS - 1));
            *pulse_us = (rounded_q8 >> PULSE_FRACTION_BITS) as u16;
            range_limited |= u32::from(asked_q8 != goal_q8).wrapping_shl(servo as u32);
            speed_limited |= u32::from(next_q8 != goal_q8).wrapping_shl(servo as u32);
        }
        self.command.range_limited = range_limited;
        self.command.speed_limited = speed_limited;
        &self.command
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deviation::Deviation;
    use crate::rotation::{Axis, AxisOrder};
    use proptest::prelude::*;
    use std::vec::Vec;

    const ONE_Q16: i32 = 1 << 16;
    const TICK_US: u32 = 20_000;

    fn pose(channels: &[i32]) -> Pose {
        Pose { channels: channels.iter().copied().collect() }
    }

    /// 10 µs per degree about 1500 µs.
    fn map(pulse_us_per_s_max: u32) -> ServoMap {
        ServoMap::new(0, [500, 1500, 2500], 10 * ONE_Q16, pulse_us_per_s_max).unwrap()
    }

    #[test]
    fn pulses_out_of_order_are_rejected() {
        for pulses_us in [[1501, 1500, 2500], [500, 1500, 1499], [3, 2, 1]] {
            let error = ServoMap::new(7, pulses_us, 1, 1).unwrap_err();
            assert_eq!(error, ServoError::PulsesOutOfOrder { channel: 7, pulses_us });
        }
    }

    #[test]
    fn servo_without_speed_is_rejected() {
        let error = ServoMap::new(7, [500, 1500, 2500], 1, 0).unwrap_err();
        assert_eq!(error, ServoError::NoSpeed { channel: 7 });
    }

    #[test]
    fn more_servos_than_the_limit_are_rejected() {
        assert!(ServoStage::new(&[map(1); SERVOS_MAX]).is_ok());
        let error = ServoStage::new(&[map(1); SERVOS_MAX + 1]).unwrap_err();
        assert_eq!(error, ServoError::TooMany { count: SERVOS_MAX + 1, max: SERVOS_MAX });
    }

    #[test]
    fn servo_whose_channel_is_missing_holds() {
        let mut stage = ServoStage::new(&[map(6000)]).unwrap();
        let held = stage.command(&pose(&[ONE_Q16]), TICK_US).clone();
        assert_eq!(held.pulses_us(), [1510]);
        assert_eq!(*stage.command(&pose(&[]), TICK_US), held);
    }

    #[test]
    fn servo_whose_rotation_is_cut_off_holds() {
        for map in
            [map(6000).following_angle(AxisOrder::Zyx, Axis::X), map(1).following_twist(Axis::X)]
        {
            let mut stage = ServoStage::new(&[map]).unwrap();
            assert_eq!(stage.command(&pose(&[0, 1, 2, 3, 4]), TICK_US).pulses_us(), [1500]);
        }
    }

    #[test]
    fn pulse_error_over_the_whole_range() {
        // 999.9 µs either way; gains with and without a fraction, in both directions.
        for gain in [10 * ONE_Q16, 700_001, -655_361, 55_555] {
            let map = ServoMap::new(0, [500, 1500, 2500], gain, u32::MAX).unwrap();
            let mut stage = ServoStage::new(&[map]).unwrap();
            let mut errors_us = Deviation::default();
            let end = (999.9 / f64::from(gain.abs()) * 4_294_967_296.0) as i32;
            for channel in (-end..=end).step_by(1 + end as usize / 500_000) {
                let pulse_us = stage.command(&pose(&[channel]), TICK_US).pulses_us()[0];
                let exact_us = 1500.0 + f64::from(channel) * f64::from(gain) / 4_294_967_296.0;
                errors_us.add(f64::from(pulse_us) - exact_us);
            }
            errors_us.assert_at_most(0.502, 0.29);
        }
    }

    #[test]
    fn pulse_error_of_three_servos_of_a_rotation() {
        let order = AxisOrder::Zyx;
        let gain = 10 * ONE_Q16;
        let maps = order.axes().map(|axis| {
            ServoMap::new(1, [0, 2000, 4000], gain, u32::MAX).unwrap().following_angle(order, axis)
        });
        let mut stage = ServoStage::new(&maps).unwrap();
        let mut errors_us = Deviation::default();
        for index in 0..200_000u64 {
            let wanted_deg = [7_919, 104_729, 1_299_709]
                .map(|stride| ((index * stride) % 160_000) as f64 / 1000.0 - 80.0);
            let [[a, b, c], [d, e, f], _] = yaw_pitch_roll(wanted_deg);
            let rows = [a, b, c, d, e, f].map(|x| libm::round(x * 65_536.0) as i32);
            let mut channels = Vec::from([123]);
            channels.extend(rows);
            let pulses_us = stage.command(&pose(&channels), TICK_US).pulses_us();
            for (pulse_us, wanted_deg) in pulses_us.iter().zip(wanted_deg) {
                errors_us.add(f64::from(*pulse_us) - 2000.0 - 10.0 * wanted_deg);
            }
        }
        errors_us.assert_at_most(0.65, 0.3);
    }

    #[test]
    fn lone_servo_follows_the_twist() {
        let [[a, b, c], [d, e, f], _] = yaw_pitch_roll([30.0, 0.0, 0.0]);
        let rows = [a, b, c, d, e, f].map(|x| libm::round(x * 65_536.0) as i32);
        let map = map(u32::MAX);
        let maps = [Axis::X, Axis::Y, Axis::Z].map(|axis| map.following_twist(axis));
        let mut stage = ServoStage::new(&maps).unwrap();
        assert_eq!(stage.command(&pose(&rows), TICK_US).pulses_us(), [1500, 1500, 1800]);
    }

    /// Rz(yaw) · Ry(pitch) · Rx(roll).
    fn yaw_pitch_roll(angles_deg: [f64; 3]) -> [[f64; 3]; 3] {
        let [(sy, cy), (sp, cp), (sr, cr)] =
            angles_deg.map(|deg| (libm::sin(deg.to_radians()), libm::cos(deg.to_radians())));
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    }

    #[test]
    fn direction_neutral_and_limits_are_those_of_the_map() {
        let reversed = ServoMap::new(1, [900, 1500, 2100], -10 * ONE_Q16, 1000).unwrap();
        let width = ServoMap::new(2, [500, 1500, 2500], ONE_Q16, u32::MAX).unwrap();
        let width = width.with_neutral_at(1500 * ONE_Q16);
        let mut stage = ServoStage::new(&[map(u32::MAX), reversed, width]).unwrap();
        let asked = pose(&[200 * ONE_Q16, 30 * ONE_Q16, 1800 * ONE_Q16]);
        assert_eq!(stage.command(&asked, 0).pulses_us(), [1500, 1500, 1500]);
        let command = stage.command(&asked, TICK_US);
        assert_eq!(command.pulses_us(), [2500, 1480, 1800]);
        assert_eq!(
            [0, 1, 2, 99].map(|servo| command.is_range_limited(servo)),
            [true, false, false, false]
        );
        assert_eq!(
            [0, 1, 2, 99].map(|servo| command.is_speed_limited(servo)),
            [false, true, false, false]
        );
        // However long the pause, no more than ELAPSED_US_MAX is made up for.
        assert_eq!(stage.command(&asked, u32::MAX).pulses_us(), [2500, 1380, 1800]);
    }

    #[test]
    fn slow_limit_does_not_stall() {
        let mut stage = ServoStage::new(&[map(1)]).unwrap();
        let asked = pose(&[i32::MAX]);
        // 100 s at 1 µs/s; 5 of 5.12 steps a tick are whole.
        for _ in 0..5000 {
            stage.command(&asked, TICK_US);
        }
        assert_eq!(stage.command.pulses_us(), [1598]);
    }

    fn any_map() -> impl Strategy<Value = ServoMap> {
        let speed = prop_oneof![1..=10_000u32, 1..=u32::MAX];
        (any::<[u16; 3]>(), any::<i32>(), speed, any::<i32>()).prop_map(
            |(mut pulses_us, gain, speed, neutral_at)| {
                pulses_us.sort_unstable();
                ServoMap::new(0, pulses_us, gain, speed).unwrap().with_neutral_at(neutral_at)
            },
        )
    }

    fn any_tick() -> impl Strategy<Value = (i32, u32)> {
        let channel = prop_oneof![Just(i32::MIN), Just(i32::MAX), any::<i32>()];
        let elapsed_us = prop_oneof![Just(0), Just(u32::MAX), 1..200_000u32, any::<u32>()];
        (channel, elapsed_us)
    }

    proptest! {
        #[test]
        fn no_command_leaves_range_or_speed(
            map in any_map(), ticks in prop::collection::vec(any_tick(), 1..100)
        ) {
            let mut stage = ServoStage::new(&[map]).unwrap();
            // Pulse and time counted by the limiter, at the start and after every tick.
            let mut course = Vec::from([(map.pulse_us_neutral, 0u64)]);
            for (channel, elapsed_us) in ticks {
                let pulse_us = stage.command(&pose(&[channel]), elapsed_us).pulses_us()[0];
                prop_assert!((map.pulse_us_min..=map.pulse_us_max).contains(&pulse_us));
                let (last_us, time_us) = *course.last().unwrap();
                prop_assert!(elapsed_us > 0 || pulse_us == last_us);
                course.push((pulse_us, time_us + u64::from(elapsed_us.min(100_000))));
            }
            for (index, &(from_us, start_us)) in course.iter().enumerate() {
                for &(to_us, end_us) in &course[index..] {
                    let travel_us = u128::from(from_us.abs_diff(to_us).saturating_sub(1));
                    let elapsed_us = u128::from(end_us - start_us);
                    let speed = u128::from(map.pulse_us_per_s_max);
                    prop_assert!(travel_us * 1_000_000 <= speed * elapsed_us);
                }
            }
        }

        #[test]
        fn constant_target_within_range_is_reached_exactly_and_kept(
            channel in -100 * ONE_Q16..=100 * ONE_Q16, gain in -10 * ONE_Q16..=10 * ONE_Q16,
            speed in 500..20_000u32, elapsed_us in 1_000..200_000u32,
            later_us in prop::collection::vec(any::<u32>(), 20)
        ) {
            let map = ServoMap::new(0, [500, 1500, 2500], gain, speed).unwrap();
            let mut stage = ServoStage::new(&[map]).unwrap();
            let asked = pose(&[channel]);
            let mut ticks = 0;
            while stage.command(&asked, elapsed_us).is_speed_limited(0) {
                ticks += 1;
                prop_assert!(ticks < 3000, "2 s at most, in ticks of a millisecond at least");
            }
            let reached = stage.command.clone();
            let exact_q32 = (1500i64 << 32) + i64::from(channel) * i64::from(gain);
            let error_q32 = (i64::from(reached.pulses_us()[0]) << 32) - exact_q32;
            prop_assert!(error_q32.abs() <= (1 << 31) + (1 << 23));
            prop_assert!(!reached.is_range_limited(0));
            for elapsed_us in later_us {
                prop_assert_eq!(stage.command(&asked, elapsed_us), &reached);
            }
        }

        #[test]
        fn reversed_servo_mirrors_the_pose(
            map in any_map(), ticks in prop::collection::vec(any_tick(), 1..50)
        ) {
            let gain = map.pulse_us_per_unit_q16.max(-i32::MAX);
            let map = map.with_neutral_at(0);
            let (mut forward, mut reversed) = (map, map);
            forward.pulse_us_per_unit_q16 = gain;
            reversed.pulse_us_per_unit_q16 = -gain;
            let [mut forward, mut reversed] =
                [forward, reversed].map(|map| ServoStage::new(&[map]).unwrap());
            for (channel, elapsed_us) in ticks {
                let channel = channel.max(-i32::MAX);
                let mirrored = reversed.command(&pose(&[-channel]), elapsed_us);
                prop_assert_eq!(forward.command(&pose(&[channel]), elapsed_us), mirrored);
            }
        }
    }
}
