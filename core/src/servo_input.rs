//! Which number of a pose a servo follows: a channel, or an angle of a rotation.
//!
//! In:  the channels of a pose, from the servo's own on.
//! Out: one number in Q15.16 to `servo.rs`: the channel's unit, or degrees.
//!
//! Why here: a joint with three axes is one group of six channels and up to three servos; each works
//! out its own angle, so servos stay independent of each other and in any order.

use crate::rotation::{Axis, AxisOrder, Rotation};

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
    /// The number to follow, or `None` where the pose has too few channels.
    pub(crate) fn read_q16(self, channels: &[i32]) -> Option<i32> {
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
