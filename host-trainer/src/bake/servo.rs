//! The servos that a motion is baked for, and the pulse that a pose asks each for.
//!
//! In:  a calibration file, or the servos in a blob, or the layout of a model that nobody calibrated.
//! Out: [`Servo`]s to `pulse_track.rs`.
//!
//! Why here: the one place where pulses come from. They are core's own record's, as on the chip; where nobody
//! measured a robot, every scalar channel gets the same hobby servo, and the user hears so.

use karakuri::limits::SERVOS_MAX;
use karakuri::{Model, Pose, ServoError, ServoLimits, ServoMap};

use crate::calibration::Servo;
use crate::error::{Error, Result};
use crate::generate::layout_of;
use crate::layout::{GroupKind, PoseLayout, Unit};

/// Shortest, neutral and longest pulse of a servo that nobody calibrated, µs: a hobby servo's full travel.
pub const DEFAULT_PULSES_US: [u16; 3] = [500, 1500, 2500];
/// Its gain, µs per degree: 2000 µs over 200° of travel.
pub const DEFAULT_US_PER_DEGREE: f64 = 10.0;
/// Its limits: 600 °/s at the default gain, a small hobby servo without load, reached in 0.1 s.
pub const DEFAULT_LIMITS: ServoLimits =
    ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };

/// A pose as a decoder gives it: Q15.16, nearest. // values: (channel)
pub fn pose_of(values: &[f32]) -> Pose {
    values.iter().map(|&value| (f64::from(value) * 65_536.0).round() as i32).collect()
}

/// The pulse that a pose asks for, before any limit, µs; neutral where the pose has no such channel.
pub fn asked_us(servo: &Servo, pose: &Pose) -> f64 {
    let neutral = || f64::from(servo.map.pulses_us()[1]);
    servo.map.asked_q16(pose).map_or_else(neutral, |pulse_q16| pulse_q16 as f64 / 65_536.0)
}

/// Shortest, neutral and longest pulse, µs.
pub fn pulses_us(servo: &Servo) -> [f64; 3] {
    servo.map.pulses_us().map(f64::from)
}

/// Speed limit, µs/s.
pub fn us_per_s_max(servo: &Servo) -> f64 {
    f64::from(servo.map.limits().pulse_us_per_s_max)
}

/// The servos that a blob carries, by the names of what they follow; none where it was not calibrated.
pub fn servos_of(model: &Model<'_>) -> Vec<Servo> {
    let layout = layout_of(model);
    let mut servos: Vec<Servo> = Vec::new();
    for map in model.servos() {
        let group = layout.ranges().find(|(_, range)| range.contains(&usize::from(map.channel())));
        let group = group.map_or("servo", |(group, _)| group.name.as_str());
        let is_taken = |name: &str| servos.iter().any(|servo| servo.name == name);
        // Three servos of one rotation share its name.
        let name = match is_taken(group) {
            true => format!("{group}_{}", servos.len()),
            false => group.to_owned(),
        };
        servos.push(Servo { name, map });
    }
    servos
}

/// One servo for every scalar channel, all calibrated alike.
///
/// # Errors
/// No channel is a scalar.
pub fn default_servos(layout: &PoseLayout) -> Result<Vec<Servo>> {
    let scalars = layout.ranges().filter(|(group, _)| group.kind == GroupKind::Scalar);
    let servos: Vec<Servo> = scalars
        .map(|(group, range)| {
            let map = default_map(range.start as u16, group.unit).map_err(|error| {
                Error::bad_input("model", &group.name, error, "a servo", "calibrate the robot")
            })?;
            Ok(Servo { name: group.name.clone(), map })
        })
        .collect::<Result<_>>()?;
    if (1..=SERVOS_MAX).contains(&servos.len()) {
        return Ok(servos);
    }
    Err(Error::bad_input(
        "model",
        "number of scalar channels",
        servos.len(),
        format!("1 to {SERVOS_MAX}: this format holds servo pulses"),
        "bake csv or bvh, or give --calibration with the servos of the robot",
    ))
}

fn default_map(channel: u16, unit: Unit) -> std::result::Result<ServoMap, ServoError> {
    let us_per_unit = match unit {
        Unit::Radian => DEFAULT_US_PER_DEGREE.to_degrees(),
        Unit::Microsecond => 1.0,
        _ => DEFAULT_US_PER_DEGREE,
    };
    let gain_q16 = (us_per_unit * 65_536.0).round() as i32;
    let map = ServoMap::new(channel, DEFAULT_PULSES_US, gain_q16, DEFAULT_LIMITS)?;
    let neutral_q16 = i32::from(DEFAULT_PULSES_US[1]) << Pose::FRACTION_BITS;
    Ok(if unit == Unit::Microsecond { map.with_neutral_at(neutral_q16) } else { map })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Group;

    fn layout(groups: &[(&str, GroupKind, Unit)]) -> PoseLayout {
        let group =
            |&(name, kind, unit): &(&str, _, _)| Group { name: str::to_owned(name), kind, unit };
        PoseLayout { groups: groups.iter().map(group).collect() }
    }

    #[test]
    fn model_without_scalar_channels_is_refused() {
        let layout = layout(&[("root", GroupKind::Translation, Unit::Metre)]);
        let error = default_servos(&layout).unwrap_err().to_string();
        assert!(error.contains("number of scalar channels is 0"), "{error}");
    }

    #[test]
    fn angles_are_converted_and_pulse_widths_taken_as_they_are() {
        let layout = layout(&[
            ("jaw", GroupKind::Scalar, Unit::Degree),
            ("root", GroupKind::Translation, Unit::Metre),
            ("neck", GroupKind::Scalar, Unit::Radian),
            ("lid", GroupKind::Scalar, Unit::Microsecond),
        ]);
        let servos = default_servos(&layout).unwrap();
        let pose = pose_of(&[30.0, 0.0, 0.0, 0.0, std::f32::consts::FRAC_PI_6, 1234.5]);
        let asked: Vec<f64> = servos.iter().map(|servo| asked_us(servo, &pose)).collect();
        assert!((asked[0] - 1800.0).abs() < 1e-3 && (asked[1] - 1800.0).abs() < 1e-2, "{asked:?}");
        assert_eq!(asked[2], 1234.5);
    }

    #[test]
    fn servos_of_a_blob_are_those_that_were_put_in() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/creature-tiny-w8a16.kara");
        let blob = std::fs::read(path).unwrap();
        let model = Model::from_bytes(&blob).unwrap();
        assert!(servos_of(&model).is_empty());
        let servos = default_servos(&layout_of(&model)).unwrap();
        let maps: Vec<ServoMap> = servos.iter().map(|servo| servo.map).collect();
        let room = karakuri::servo_records::servos_bytes(maps.len());
        let mut output = vec![0; blob.len() + room];
        let length =
            karakuri::servo_records::with_servos(&blob, &maps, 25_000_000, &mut output).unwrap();
        let model = Model::from_bytes(&output[..length]).unwrap();
        assert_eq!(servos_of(&model), servos);
    }
}
