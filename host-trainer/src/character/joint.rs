//! The joints of the built-in character: what each servo can do and how the part on its horn
//! behaves.
//!
//! In:  nothing; these are design numbers.
//! Out: ranges and speeds to `follow_through.rs`, the pose layout to every clip.
//!
//! Why here: all design numbers of the puppet stand in one table, so that changing the puppet is
//! changing this table.

use crate::layout::{Group, GroupKind, PoseLayout, Unit};

/// A joint of the character; the number is its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Joint {
    /// Turns the whole body on its base; left is positive.
    BodyYaw,
    /// Tips the body on its base; forward is positive.
    BodyLean,
    /// Nods the head; down is positive.
    NeckPitch,
    /// Turns the head on the body; left is positive.
    NeckYaw,
    /// Tilts the head; towards its left shoulder is positive.
    NeckRoll,
    /// Both upper lids on one rod; closing is positive.
    Eyelid,
    /// Both brows on one rod; up is positive.
    Brow,
    /// The chin; opening is positive.
    Jaw,
    /// The left arm; up is positive.
    ArmLeft,
    /// The right arm; up is positive.
    ArmRight,
    /// The bamboo tea whisk that is its topknot; towards the face is positive.
    Whisk,
}

/// Number of joints, and of channels of a pose.
pub const JOINT_COUNT: usize = 11;

/// One servo and the part on its horn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpec {
    /// Name of the channel, without its unit.
    pub name: &'static str,
    /// Mechanical end stop.
    pub min_deg: f64,
    /// Where it stands when nothing happens.
    pub rest_deg: f64,
    /// Mechanical end stop.
    pub max_deg: f64,
    /// Fastest command; well under the 600 deg/s of a small hobby servo without load.
    pub speed_deg_per_s_max: f64,
    /// Natural frequency of the part: heavy parts are slow.
    pub frequency_hz: f64,
    /// 1 never swings past its goal; the lower, the longer it swings.
    pub damping_ratio: f64,
}

const fn spec(
    name: &'static str,
    range_deg: [f64; 3],
    speed_deg_per_s_max: f64,
    frequency_hz: f64,
    damping_ratio: f64,
) -> JointSpec {
    JointSpec {
        name,
        min_deg: range_deg[0],
        rest_deg: range_deg[1],
        max_deg: range_deg[2],
        speed_deg_per_s_max,
        frequency_hz,
        damping_ratio,
    }
}

//   name          min, rest, max      deg/s    Hz  damping
const SPECS: [JointSpec; JOINT_COUNT] = [
    spec("body_yaw", [-55.0, 0.0, 55.0], 220.0, 3.2, 0.72),
    spec("body_lean", [-16.0, 0.0, 28.0], 180.0, 3.2, 0.66),
    spec("neck_pitch", [-30.0, 0.0, 36.0], 300.0, 5.0, 0.58),
    spec("neck_yaw", [-60.0, 0.0, 60.0], 360.0, 5.5, 0.62),
    spec("neck_roll", [-26.0, 0.0, 26.0], 240.0, 3.6, 0.46),
    spec("eyelid", [-8.0, 0.0, 24.0], 400.0, 18.0, 0.90),
    spec("brow", [-16.0, 0.0, 18.0], 300.0, 5.5, 0.48),
    spec("jaw", [-3.0, 0.0, 26.0], 360.0, 8.0, 0.55),
    spec("arm_left", [-25.0, 10.0, 95.0], 380.0, 3.4, 0.42),
    spec("arm_right", [-25.0, 10.0, 95.0], 380.0, 3.4, 0.42),
    spec("whisk", [-32.0, 0.0, 32.0], 400.0, 3.0, 0.24),
];

impl Joint {
    /// Every joint, in channel order.
    pub const ALL: [Self; JOINT_COUNT] = [
        Self::BodyYaw,
        Self::BodyLean,
        Self::NeckPitch,
        Self::NeckYaw,
        Self::NeckRoll,
        Self::Eyelid,
        Self::Brow,
        Self::Jaw,
        Self::ArmLeft,
        Self::ArmRight,
        Self::Whisk,
    ];

    /// The joint's channel.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The servo of this joint.
    pub const fn spec(self) -> &'static JointSpec {
        &SPECS[self.index()]
    }
}

/// One scalar group in degrees a joint.
pub fn layout() -> PoseLayout {
    let group = |joint: &Joint| Group {
        name: joint.spec().name.to_owned(),
        kind: GroupKind::Scalar,
        unit: Unit::Degree,
    };
    PoseLayout { groups: Joint::ALL.iter().map(group).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two files say where the puppet ends: they must say the same.
    #[test]
    fn calibration_has_the_ranges_and_rests_of_the_joints() {
        let servos = crate::character::calibration().servos(&layout()).unwrap();
        assert_eq!(servos.len(), JOINT_COUNT);
        for (servo, joint) in servos.iter().zip(Joint::ALL) {
            let spec = joint.spec();
            let gain = f64::from(servo.map.pulse_us_per_unit_q16()) / 65_536.0;
            let degrees = |pulse_us: u16| (f64::from(pulse_us) - 1500.0) / gain;
            let [min_us, _, max_us] = servo.map.pulses_us();
            let mut ends_deg = [degrees(min_us), degrees(max_us)];
            ends_deg.sort_by(f64::total_cmp);
            assert_eq!((servo.name.as_str(), ends_deg), (spec.name, [spec.min_deg, spec.max_deg]));
            assert_eq!(degrees(servo.map.pulse_us_park()), spec.rest_deg);
        }
    }
}
