//! What one servo does with a pose: which number it follows, and the pulse that asks for.
//!
//! In:  the builder's calibration; a pose.
//! Out: the pulse asked for and the farthest way of a tick, to `servo.rs`.
//!
//! Why here: a joint with three axes is one group of six channels and up to three servos; each works
//! out its own angle, so servos stay independent of each other and in any order.

use crate::error::ServoError;
use crate::pose::Pose;
use crate::rotation::{Axis, AxisOrder, Rotation};
use crate::servo::ServoStage;

/// Fraction bits of a pulse between two ticks, so that slow limits do not stall at whole
/// microseconds.
pub(crate) const PULSE_FRACTION_BITS: u32 = 8;

/// Calibration of one servo: which channel drives it, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServoMap {
    channel: u16,
    input: ServoInput,
    pub(crate) pulse_us_min: u16,
    pub(crate) pulse_us_neutral: u16,
    pub(crate) pulse_us_max: u16,
    pub(crate) pulse_us_per_unit_q16: i32,
    pub(crate) pulse_us_per_s_max: u32,
    channel_at_neutral_q16: i32,
}

impl ServoMap {
    /// A servo that follows channel number `channel` of the pose (a scalar; see `Model::groups`; of
    /// a rotation, see [`Self::following_angle`] and [`Self::following_twist`]).
    ///
    /// `pulses_us` are the shortest, the neutral and the longest pulse; neutral is where channel
    /// value 0 leads and where the servo is parked. `pulse_us_per_unit_q16` is Q15.16 µs per
    /// channel unit; its sign is the direction.
    ///
    /// # Errors
    /// [`ServoError`] when the pulses are not in this order or the speed is 0.
    pub const fn new(
        channel: u16,
        pulses_us: [u16; 3],
        pulse_us_per_unit_q16: i32,
        pulse_us_per_s_max: u32,
    ) -> Result<Self, ServoError> {
        let [pulse_us_min, pulse_us_neutral, pulse_us_max] = pulses_us;
        if pulse_us_min > pulse_us_neutral || pulse_us_neutral > pulse_us_max {
            return Err(ServoError::PulsesOutOfOrder { channel, pulses_us });
        }
        if pulse_us_per_s_max == 0 {
            return Err(ServoError::NoSpeed { channel });
        }
        Ok(Self {
            channel,
            input: ServoInput::Channel,
            pulse_us_min,
            pulse_us_neutral,
            pulse_us_max,
            pulse_us_per_unit_q16,
            pulse_us_per_s_max,
            channel_at_neutral_q16: 0,
        })
    }

    /// The same servo with its neutral pulse at another channel value than 0, Q15.16; a channel
    /// that is a pulse width itself has it at that width.
    pub const fn with_neutral_at(self, channel_q16: i32) -> Self {
        Self { channel_at_neutral_q16: channel_q16, ..self }
    }

    /// The servo about `axis` of three in series that together make a rotation; `channel` is the
    /// first of its six, the unit of the map becomes the degree.
    ///
    /// An angle that passes ±180° jumps to the other end, and in gimbal lock the outer two angles
    /// may turn fast: choose the order so that the joint stays away from both.
    pub const fn following_angle(self, order: AxisOrder, axis: Axis) -> Self {
        Self { input: ServoInput::Angle { order, axis }, ..self }
    }

    /// The only servo of a rotation, which turns as far about `axis` as the rotation does;
    /// `channel` is the first of its six, the unit of the map becomes the degree.
    pub const fn following_twist(self, axis: Axis) -> Self {
        Self { input: ServoInput::Twist(axis), ..self }
    }

    /// The number of the pose that this servo follows, or `None` where the pose ends before it.
    pub(crate) fn read_q16(&self, pose: &Pose) -> Option<i32> {
        self.input.read_q16(pose.channels().get(usize::from(self.channel)..)?)
    }

    /// Pulse that a channel value asks for, before any limit, in 2^-8 µs: nearest, ties up.
    pub(crate) fn asked_q8(&self, channel_q16: i32) -> i64 {
        let from_neutral_q16 = i64::from(channel_q16) - i64::from(self.channel_at_neutral_q16);
        let offset_q32 = from_neutral_q16.saturating_mul(i64::from(self.pulse_us_per_unit_q16));
        let shift = 32 - PULSE_FRACTION_BITS;
        let offset_q8 = offset_q32.saturating_add(1 << (shift - 1)) >> shift;
        pulse_q8(self.pulse_us_neutral).saturating_add(offset_q8)
    }

    /// Farthest way of one tick in 2^-8 µs, rounded down, so that ticks never add up to more than
    /// the limit.
    pub(crate) fn step_q8(&self, elapsed_us: u32) -> i64 {
        let elapsed_us = u64::from(elapsed_us.min(ServoStage::ELAPSED_US_MAX));
        // Below 2^32 · 10^5 · 2^8 < 2^57.
        let product_q8 = (u64::from(self.pulse_us_per_s_max) * elapsed_us) << PULSE_FRACTION_BITS;
        (product_q8 / 1_000_000) as i64
    }
}

pub(crate) const fn pulse_q8(pulse_us: u16) -> i64 {
    (pulse_us as i64) << PULSE_FRACTION_BITS
}

/// What a servo reads at its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ServoInput {
    /// The channel itself.
    Channel,
    /// The rotation that begins there, as three servos in series: the angle of the one about `axis`.
    Angle { order: AxisOrder, axis: Axis },
    /// The rotation that begins there, for one servo alone: its turn about the axis.
    Twist(Axis),
}

impl ServoInput {
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
