//! Calibration of one servo: which number of a pose it follows, the pulse that asks for, and its limits.
//!
//! In:  what the builder measured, by hand or through the blob; a pose.
//! Out: the pulse asked for to `servo.rs`, the limits to `servo_limiter.rs`.
//!
//! Why here: a joint with three axes is one group of six channels and up to three servos; each works
//! out its own angle, so servos stay independent of each other and in any order.

use crate::error::ServoError;
use crate::pose::Pose;
use crate::rotation::{Axis, AxisOrder, Rotation};

/// Longest pulse, µs: the period of a common servo. In 2^-16 µs it fits 31 bits.
pub const PULSE_US_MAX: u16 = 20_000;

/// How fast a servo may be told to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServoLimits {
    /// Speed, microseconds of pulse a second: (pulse width per degree) · (degrees per second).
    pub pulse_us_per_s_max: u32,
    /// Acceleration and braking, microseconds of pulse a second, every second. Ten times the speed reaches it in 0.1 s.
    pub pulse_us_per_s2_max: u32,
}

/// Calibration of one servo: which channel drives it, how, and what it must never be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServoMap {
    channel: u16,
    input: ServoInput,
    output: u8,
    pulse_us_min: u16,
    pulse_us_neutral: u16,
    pulse_us_max: u16,
    pulse_us_park: u16,
    trim_us: i16,
    pulse_us_per_unit_q16: i32,
    channel_at_neutral_q16: i32,
    limits: ServoLimits,
}

impl ServoMap {
    /// A servo that follows channel number `channel` of the pose (a scalar; see `Model::groups`; of a rotation, see
    /// [`Self::following_angle`] and [`Self::following_twist`]).
    ///
    /// `pulses_us` are the shortest, the neutral and the longest pulse; neutral is where channel value 0 leads and
    /// where the servo is parked. `pulse_us_per_unit_q16` is Q15.16 µs per channel unit; its sign is the direction.
    /// The output is number 0.
    ///
    /// # Errors
    /// * [`ServoError::PulsesOutOfOrder`], [`ServoError::PulseImpossible`], [`ServoError::NoSpan`]: the pulses.
    /// * [`ServoError::NoSpeed`], [`ServoError::NoAcceleration`], [`ServoError::CannotBrake`]: the limits.
    pub const fn new(
        channel: u16,
        pulses_us: [u16; 3],
        pulse_us_per_unit_q16: i32,
        limits: ServoLimits,
    ) -> Result<Self, ServoError> {
        let [pulse_us_min, pulse_us_neutral, pulse_us_max] = pulses_us;
        if pulse_us_min > pulse_us_neutral || pulse_us_neutral > pulse_us_max {
            return Err(ServoError::PulsesOutOfOrder { channel, pulses_us });
        }
        if pulse_us_min == 0 || pulse_us_max > PULSE_US_MAX {
            return Err(ServoError::PulseImpossible { channel, pulses_us });
        }
        if pulse_us_min == pulse_us_max {
            return Err(ServoError::NoSpan { channel, pulse_us: pulse_us_min });
        }
        if let Err(error) = limits.check(channel, pulse_us_max - pulse_us_min) {
            return Err(error);
        }
        Ok(Self {
            channel,
            input: ServoInput::Channel,
            output: 0,
            pulse_us_min,
            pulse_us_neutral,
            pulse_us_max,
            pulse_us_park: pulse_us_neutral,
            trim_us: 0,
            pulse_us_per_unit_q16,
            channel_at_neutral_q16: 0,
            limits,
        })
    }

    /// The same servo with its neutral pulse at another channel value than 0, Q15.16; a channel that is a pulse width
    /// itself has it at that width.
    pub const fn with_neutral_at(self, channel_q16: i32) -> Self {
        Self { channel_at_neutral_q16: channel_q16, ..self }
    }

    /// The same servo with another park pulse: where it stands when nobody drives it, and where it starts.
    ///
    /// # Errors
    /// [`ServoError::ParkOutside`] the range.
    pub const fn with_park_at(self, pulse_us: u16) -> Result<Self, ServoError> {
        if pulse_us < self.pulse_us_min || pulse_us > self.pulse_us_max {
            let range_us = [self.pulse_us_min, self.pulse_us_max];
            return Err(ServoError::ParkOutside { channel: self.channel, pulse_us, range_us });
        }
        Ok(Self { pulse_us_park: pulse_us, ..self })
    }

    /// The same servo with its horn a little off: `trim_us` is added to every pulse that a pose asks for. Range and
    /// park pulse stay as measured.
    ///
    /// # Errors
    /// [`ServoError::TrimOutside`] when the neutral pulse leaves the range by it.
    pub const fn with_trim(self, trim_us: i16) -> Result<Self, ServoError> {
        let neutral_us = self.pulse_us_neutral as i32 + trim_us as i32;
        if neutral_us < self.pulse_us_min as i32 || neutral_us > self.pulse_us_max as i32 {
            let range_us = [self.pulse_us_min, self.pulse_us_max];
            return Err(ServoError::TrimOutside { channel: self.channel, trim_us, range_us });
        }
        Ok(Self { trim_us, ..self })
    }

    /// The same servo on another output: number of the PCA9685's channel (16 a board) or of the bus servo.
    pub const fn on_output(self, output: u8) -> Self {
        Self { output, ..self }
    }

    /// The servo about `axis` of three in series that together make a rotation; `channel` is the first of its six, the
    /// unit of the map becomes the degree.
    ///
    /// An angle that passes ±180° jumps to the other end, and in gimbal lock the outer two angles may turn fast: choose
    /// the order so that the joint stays away from both.
    pub const fn following_angle(self, order: AxisOrder, axis: Axis) -> Self {
        Self { input: ServoInput::Angle { order, axis }, ..self }
    }

    /// The only servo of a rotation, which turns as far about `axis` as the rotation does; `channel` is the first of
    /// its six, the unit of the map becomes the degree.
    pub const fn following_twist(self, axis: Axis) -> Self {
        Self { input: ServoInput::Twist(axis), ..self }
    }

    pub(crate) const fn following(self, input: ServoInput) -> Self {
        Self { input, ..self }
    }

    pub(crate) const fn input(&self) -> ServoInput {
        self.input
    }

    /// Channel of the pose, the first one of a rotation.
    pub const fn channel(&self) -> u16 {
        self.channel
    }

    /// Number of the output.
    pub const fn output(&self) -> u8 {
        self.output
    }

    /// Shortest, neutral and longest pulse.
    pub const fn pulses_us(&self) -> [u16; 3] {
        [self.pulse_us_min, self.pulse_us_neutral, self.pulse_us_max]
    }

    /// Pulse of the park pose.
    pub const fn pulse_us_park(&self) -> u16 {
        self.pulse_us_park
    }

    /// Added to every pulse that a pose asks for.
    pub const fn trim_us(&self) -> i16 {
        self.trim_us
    }

    /// Gain: Q15.16 µs per unit; negative is reversed.
    pub const fn pulse_us_per_unit_q16(&self) -> i32 {
        self.pulse_us_per_unit_q16
    }

    /// Channel value at the neutral pulse, Q15.16.
    pub const fn channel_at_neutral_q16(&self) -> i32 {
        self.channel_at_neutral_q16
    }

    /// Speed and acceleration.
    pub const fn limits(&self) -> ServoLimits {
        self.limits
    }

    /// Pulse that a pose asks for, before any limit, in 2^-16 µs: nearest, ties up. `None` where the pose ends before
    /// the servo's channels do.
    pub fn asked_q16(&self, pose: &Pose) -> Option<i64> {
        let channel_q16 = self.input.read_q16(pose.channels().get(usize::from(self.channel)..)?)?;
        let from_neutral_q16 = i64::from(channel_q16) - i64::from(self.channel_at_neutral_q16);
        let offset_q32 = from_neutral_q16.saturating_mul(i64::from(self.pulse_us_per_unit_q16));
        let offset_q16 = offset_q32.saturating_add(1 << 15) >> 16;
        let neutral_us = i64::from(self.pulse_us_neutral) + i64::from(self.trim_us);
        Some((neutral_us << 16) + offset_q16)
    }

    /// The nearest pulse that the servo can make, 2^-16 µs.
    pub(crate) fn in_range(&self, pulse: i64) -> i32 {
        let (min, max) = (pulse_q16(self.pulse_us_min), pulse_q16(self.pulse_us_max));
        // Between the two, so that it fits.
        pulse.max(i64::from(min)).min(i64::from(max)) as i32
    }
}

impl ServoLimits {
    /// Way from full speed to standing, whole microseconds of pulse: speed² / (2 · acceleration).
    pub const fn braking_us(self) -> u64 {
        let speed = self.pulse_us_per_s_max as u64;
        match (speed * speed).checked_div(2 * self.pulse_us_per_s2_max as u64) {
            Some(braking_us) => braking_us,
            None => u64::MAX,
        }
    }

    const fn check(self, channel: u16, span_us: u16) -> Result<(), ServoError> {
        if self.pulse_us_per_s_max == 0 {
            return Err(ServoError::NoSpeed { channel });
        }
        if self.pulse_us_per_s2_max == 0 {
            return Err(ServoError::NoAcceleration { channel });
        }
        // Without a division, which every image that loads a blob would have to pay for.
        let speed = self.pulse_us_per_s_max as u64;
        if speed * speed >= (span_us as u64 + 1) * 2 * self.pulse_us_per_s2_max as u64 {
            return Err(ServoError::CannotBrake { channel, limits: self, span_us });
        }
        Ok(())
    }
}

/// In 2^-16 µs.
pub(crate) const fn pulse_q16(pulse_us: u16) -> i32 {
    (pulse_us as i32) << 16
}

/// The nearest whole microsecond, ties up, of a pulse in 2^-16 µs.
pub(crate) const fn whole_us(pulse_q16: i32) -> u16 {
    ((pulse_q16 + (1 << 15)) >> 16) as u16
}

/// What a servo reads at its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ServoInput {
    /// The channel itself.
    Channel,
    /// The rotation that begins there, as three servos in series: the angle of the one about `axis`.
    Angle { order: AxisOrder, axis: Axis },
    /// The rotation that begins there, for one servo alone: its turn about the axis.
    Twist(Axis),
}

impl ServoInput {
    /// Channels that it reads.
    pub const fn channel_count(self) -> usize {
        match self {
            Self::Channel => 1,
            Self::Angle { .. } | Self::Twist(_) => 6,
        }
    }

    /// The number to follow, or `None` where the pose has too few channels.
    fn read_q16(self, channels: &[i32]) -> Option<i32> {
        match self {
            Self::Channel => channels.first().copied(),
            Self::Angle { order, axis } => {
                let angles_deg_q16 = rotation(channels)?.angles_deg_q16(order);
                let mut angles = order.axes().into_iter().zip(angles_deg_q16);
                angles.find_map(|(of, deg_q16)| (of == axis).then_some(deg_q16))
            }
            Self::Twist(axis) => Some(rotation(channels)?.twist_deg_q16(axis)),
        }
    }
}

fn rotation(channels: &[i32]) -> Option<Rotation> {
    channels.first_chunk().copied().map(Rotation::from_6d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deviation::Deviation;
    use std::string::ToString;
    use std::vec::Vec;

    const LIMITS: ServoLimits =
        ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };
    const ONE_Q16: i32 = 1 << 16;

    fn refusal(pulses_us: [u16; 3], speed: u32, acceleration: u32) -> ServoError {
        let limits = ServoLimits { pulse_us_per_s_max: speed, pulse_us_per_s2_max: acceleration };
        ServoMap::new(7, pulses_us, 1, limits).unwrap_err()
    }

    #[test]
    fn pulses_out_of_order_are_rejected() {
        for pulses_us in [[1501, 1500, 2500], [500, 1500, 1499], [3, 2, 1]] {
            let error = refusal(pulses_us, 1, 1);
            assert_eq!(error, ServoError::PulsesOutOfOrder { channel: 7, pulses_us });
        }
    }

    #[test]
    fn pulse_that_no_servo_knows_is_rejected() {
        for pulses_us in [[0, 1500, 2500], [500, 1500, 20_001]] {
            let error = refusal(pulses_us, 1, 1);
            assert_eq!(error, ServoError::PulseImpossible { channel: 7, pulses_us });
        }
    }

    #[test]
    fn servo_without_span_speed_or_acceleration_is_rejected() {
        let pulses_us = [500, 1500, 2500];
        assert_eq!(refusal([900; 3], 1, 1), ServoError::NoSpan { channel: 7, pulse_us: 900 });
        assert_eq!(refusal(pulses_us, 0, 1), ServoError::NoSpeed { channel: 7 });
        assert_eq!(refusal(pulses_us, 1, 0), ServoError::NoAcceleration { channel: 7 });
    }

    #[test]
    fn servo_that_cannot_brake_within_its_range_is_rejected() {
        let error = refusal([500, 1500, 2500], 6000, 8_990);
        let limits = ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 8_990 };
        let expected = ServoError::CannotBrake { channel: 7, limits, span_us: 2000 };
        assert_eq!(error, expected);
        assert!(error.to_string().contains("2002 us to stop"), "{error}");
        let limits = ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 9_000 };
        assert!(ServoMap::new(7, [500, 1500, 2500], 1, limits).is_ok());
    }

    #[test]
    fn park_pulse_and_trim_outside_the_range_are_rejected() {
        let map = ServoMap::new(7, [500, 1500, 2500], 1, LIMITS).unwrap();
        let range_us = [500, 2500];
        for pulse_us in [499, 2501] {
            let error = ServoError::ParkOutside { channel: 7, pulse_us, range_us };
            assert_eq!(map.with_park_at(pulse_us), Err(error));
        }
        for trim_us in [-1001, 1001, i16::MIN, i16::MAX] {
            let error = ServoError::TrimOutside { channel: 7, trim_us, range_us };
            assert_eq!(map.with_trim(trim_us), Err(error));
        }
    }

    fn pose(channels: &[i32]) -> Pose {
        Pose { channels: channels.iter().copied().collect() }
    }

    #[test]
    fn trim_moves_the_pulse_and_not_the_range() {
        let map = ServoMap::new(0, [1300, 1500, 1700], 10 * ONE_Q16, LIMITS).unwrap();
        let map = map.with_trim(-20).unwrap();
        let pulse_us = |channel| whole_us(map.in_range(map.asked_q16(&pose(&[channel])).unwrap()));
        assert_eq!([0, 5, 30, -19].map(|deg| pulse_us(deg * ONE_Q16)), [1480, 1530, 1700, 1300]);
    }

    #[test]
    fn pulse_error_over_the_whole_range() {
        // 999.9 µs either way; gains with and without a fraction, in both directions.
        for gain in [10 * ONE_Q16, 700_001, -655_361, 55_555] {
            let map = ServoMap::new(0, [500, 1500, 2500], gain, LIMITS).unwrap();
            let mut errors_us = Deviation::default();
            let end = (999.9 / f64::from(gain.abs()) * 4_294_967_296.0) as i32;
            for channel in (-end..=end).step_by(1 + end as usize / 500_000) {
                let pulse_us = whole_us(map.in_range(map.asked_q16(&pose(&[channel])).unwrap()));
                let exact_us = 1500.0 + f64::from(channel) * f64::from(gain) / 4_294_967_296.0;
                errors_us.add(f64::from(pulse_us) - exact_us);
            }
            errors_us.assert_at_most(0.50001, 0.29);
        }
    }

    #[test]
    fn pulse_error_of_three_servos_of_a_rotation() {
        let order = AxisOrder::Zyx;
        let maps = order.axes().map(|axis| {
            let map = ServoMap::new(1, [1, 2000, 4000], 10 * ONE_Q16, LIMITS).unwrap();
            map.following_angle(order, axis)
        });
        let mut errors_us = Deviation::default();
        for index in 0..200_000u64 {
            let wanted_deg = [7_919, 104_729, 1_299_709]
                .map(|stride| ((index * stride) % 160_000) as f64 / 1000.0 - 80.0);
            let mut channels = Vec::from([123]);
            channels.extend(rows_of(wanted_deg));
            let pose = pose(&channels);
            for (map, wanted_deg) in maps.iter().zip(wanted_deg) {
                let pulse_us = whole_us(map.in_range(map.asked_q16(&pose).unwrap()));
                errors_us.add(f64::from(pulse_us) - 2000.0 - 10.0 * wanted_deg);
            }
        }
        errors_us.assert_at_most(0.65, 0.3);
    }

    #[test]
    fn lone_servo_follows_the_twist() {
        let map = ServoMap::new(0, [500, 1500, 2500], 10 * ONE_Q16, LIMITS).unwrap();
        let pose = pose(&rows_of([30.0, 0.0, 0.0]));
        let pulses_us = [Axis::X, Axis::Y, Axis::Z].map(|axis| {
            let map = map.following_twist(axis);
            whole_us(map.in_range(map.asked_q16(&pose).unwrap()))
        });
        assert_eq!(pulses_us, [1500, 1500, 1800]);
    }

    /// First two rows of Rz(yaw) · Ry(pitch) · Rx(roll), Q15.16.
    fn rows_of(angles_deg: [f64; 3]) -> [i32; 6] {
        let [(sy, cy), (sp, cp), (sr, cr)] =
            angles_deg.map(|deg| (libm::sin(deg.to_radians()), libm::cos(deg.to_radians())));
        let first = [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr];
        let second = [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr];
        let [[a, b, c], [d, e, f]] = [first, second];
        [a, b, c, d, e, f].map(|x| libm::round(x * 65_536.0) as i32)
    }
}
