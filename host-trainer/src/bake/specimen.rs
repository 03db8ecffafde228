//! Small motions for the tests of this folder: one servo by hand, or the built-in character on all of its servos.

use karakuri::{ServoLimits, ServoMap};

use crate::bake::pulse_track::PulseTrack;
use crate::bake::servo::{DEFAULT_LIMITS, default_servos};
use crate::calibration::Servo;
use crate::character;
use crate::export::Motion;
use crate::layout::{Group, GroupKind, PoseLayout, Unit};

/// One servo in degrees, 50 poses per second.
pub fn motion_of(degrees: &[f32]) -> Motion {
    let jaw = Group { name: "jaw".into(), kind: GroupKind::Scalar, unit: Unit::Degree };
    Motion {
        layout: PoseLayout { groups: vec![jaw] },
        skeleton: None,
        rate_hz: 50.0,
        poses: degrees.to_vec(),
        action: "nod".into(),
        seconds: degrees.len() as f64 / 50.0,
        seed: 7,
        provenance: "test in core's w8a16, config 00ff, blob CRC-32 deadbeef".into(),
    }
}

/// Clips of the built-in character as motions.
pub fn character(count: usize) -> Vec<Motion> {
    let clip_set = character::clip_set(3, 1);
    let motion = |(seed, clip): (u64, crate::clip::Clip)| Motion {
        layout: clip_set.layout.clone(),
        seconds: clip.frame_count(&clip_set.layout) as f64 / clip_set.rate_hz,
        poses: clip.poses,
        action: clip.action,
        seed,
        ..motion_of(&[])
    };
    (1..).zip(clip_set.clips.clone()).take(count).map(motion).collect()
}

/// Servos by default.
pub fn servos(motion: &Motion) -> Vec<Servo> {
    default_servos(&motion.layout).unwrap()
}

/// What the servos do in each motion; what was clamped is not asked for.
pub fn tracks<'m>(motions: &'m [Motion], servos: &'m [Servo]) -> Vec<PulseTrack<'m>> {
    motions.iter().map(|motion| PulseTrack::new(motion, servos, &mut Vec::new())).collect()
}

/// A servo of the first channel at 10 µs per degree.
pub fn servo(pulses_us: [u16; 3]) -> Servo {
    // Slow, so that it can brake within any range.
    let limits = ServoLimits { pulse_us_per_s_max: 500, ..DEFAULT_LIMITS };
    let map = ServoMap::new(0, pulses_us, 10 << 16, limits).unwrap();
    Servo { name: "jaw".into(), map }
}
