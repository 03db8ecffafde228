//! The servos of a trace: those of the blob, or one for every scalar channel, all calibrated alike.
//!
//! In:  the model, [`Options`].
//! Out: names and [`ServoMap`]s to `trace.rs`.
//!
//! Why here: until a robot is measured, a blob says what its channels mean, not how the robot is
//! built; until then the second kind stands in.

use karakuri::limits::SERVOS_MAX;
use karakuri::manifest::Group;
use karakuri::{GroupKind, Model, Pose, ServoError, ServoLimits, ServoMap, Unit};

use super::Options;
use crate::error::{Error, Result};

/// Shortest, neutral and longest pulse of every servo: a hobby servo's full travel about its
/// middle.
pub const PULSES_US: [u16; 3] = [500, 1500, 2500];
/// Default gain: 10 µs per degree, 2000 µs over 200° of travel.
pub const US_PER_UNIT: f64 = 10.0;
/// Default speed limit: 600 °/s at the default gain, a small hobby servo without load (60° in 0.1
/// s).
pub const US_PER_S_MAX: u32 = 6000;
/// Default acceleration limit: full speed in 0.1 s.
pub const US_PER_S2_MAX: u32 = 60_000;

/// The blob's own servos, `None` where it has none; named by their groups.
pub fn own_servos(model: &Model<'_>) -> Option<(Vec<String>, Vec<ServoMap>)> {
    let maps: Vec<ServoMap> = model.servos().collect();
    let mut names: Vec<String> = Vec::new();
    for map in &maps {
        let mut end = 0;
        let group = model.groups().find(|group| {
            end += group.kind.channel_count();
            usize::from(map.channel()) < end
        });
        let group = group.map_or_else(String::new, |group| group.name.to_owned());
        // Three servos of one rotation share its name.
        let is_taken = |name: &String| *name == group;
        let name =
            if names.iter().any(is_taken) { format!("{group}_{}", map.output()) } else { group };
        names.push(name);
    }
    (!maps.is_empty()).then_some((names, maps))
}

/// Every scalar channel's name and calibration.
pub fn stand_ins<'g>(
    groups: impl Iterator<Item = Group<'g>>,
    options: &Options,
) -> Result<(Vec<String>, Vec<ServoMap>)> {
    let (mut names, mut maps, mut channel) = (Vec::new(), Vec::new(), 0);
    for group in groups {
        if group.kind == GroupKind::Scalar {
            names.push(group.name.to_owned());
            maps.push(servo(channel as u16, group.unit, options)?);
        }
        channel += group.kind.channel_count();
    }
    if names.is_empty() {
        let expected = format!("1 to {SERVOS_MAX} of them, a servo each");
        let remedy = "trace a model of servo tracks (`host-trainer demo` makes one); rotations and \
            positions first need the inverse kinematics of a certain robot";
        return Err(Error::bad_input("model", "number of scalar channels", 0, expected, remedy));
    }
    Ok((names, maps))
}

fn servo(channel: u16, unit: Unit, options: &Options) -> Result<ServoMap> {
    let us_per_channel_unit = match unit {
        // What stands per degree is more per radian.
        Unit::Radian => options.us_per_unit.to_degrees(),
        Unit::Microsecond => 1.0,
        Unit::One | Unit::Degree | Unit::Metre | Unit::Centimetre | Unit::Millimetre => {
            options.us_per_unit
        }
    };
    let q16 = (us_per_channel_unit * 65_536.0).round();
    // NaN is in no range.
    if !(1.0..=f64::from(i32::MAX)).contains(&q16.abs()) {
        let field = format!("pulse width per {}, µs", unit.suffix());
        let expected = "0.00002 to 32767, or the negative of it";
        let remedy = "give microseconds per degree, such as 10";
        return Err(Error::bad_input(
            "--us-per-unit",
            field,
            us_per_channel_unit,
            expected,
            remedy,
        ));
    }
    let limits = ServoLimits {
        pulse_us_per_s_max: options.us_per_s_max,
        pulse_us_per_s2_max: options.us_per_s2_max,
    };
    let map = ServoMap::new(channel, PULSES_US, q16 as i32, limits).map_err(refused)?;
    let neutral_q16 = i32::from(PULSES_US[1]) << Pose::FRACTION_BITS;
    Ok(if unit == Unit::Microsecond { map.with_neutral_at(neutral_q16) } else { map })
}

/// Why core does not take the limits.
fn refused(error: ServoError) -> Error {
    let (flag, expected) = match error {
        ServoError::NoSpeed { .. } => ("--speed-us-per-s", "at least 1"),
        ServoError::NoAcceleration { .. } => ("--acceleration-us-per-s2", "at least 1"),
        _ => ("--acceleration-us-per-s2", "limits that stop a servo within its range"),
    };
    let remedy = "give the servo's speed in microseconds of pulse per second, and about ten times \
        as much for its acceleration";
    Error::bad_input(flag, "the limit", error, expected, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use crate::trace::tests::options;

    fn group(name: &str, kind: GroupKind, unit: Unit) -> Group<'_> {
        Group { name, kind, unit }
    }

    #[test]
    fn model_without_scalar_channels_is_rejected() {
        let groups = [
            group("root", GroupKind::Translation, Unit::Metre),
            group("head", GroupKind::Rotation6d, Unit::One),
        ];
        let error = stand_ins(groups.into_iter(), &options()).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains("number of scalar channels is 0"), "{error}");
    }

    #[test]
    fn gain_that_no_calibration_can_hold_is_rejected() {
        for us_per_unit in [0.0, 1e-9, 1e9, f64::NAN, f64::NEG_INFINITY] {
            let error = servo(0, Unit::Degree, &Options { us_per_unit, ..options() }).unwrap_err();
            assert!(error.to_string().contains("--us-per-unit"), "{error}");
        }
    }

    #[test]
    fn servo_without_speed_is_rejected() {
        let error = servo(0, Unit::Degree, &Options { us_per_s_max: 0, ..options() }).unwrap_err();
        assert!(error.to_string().contains("--speed-us-per-s"), "{error}");
    }

    #[test]
    fn servo_that_cannot_start_or_brake_is_rejected() {
        for us_per_s2_max in [0, 8000] {
            let options = Options { us_per_s2_max, ..options() };
            let error = servo(0, Unit::Degree, &options).unwrap_err();
            assert!(error.to_string().contains("--acceleration-us-per-s2"), "{error}");
        }
    }

    #[test]
    fn servos_of_the_blob_are_taken_with_their_names() {
        let plain = Fixture::new(1).blob(karakuri::NumberFormat::W8A16);
        assert!(own_servos(&Model::from_bytes(&plain).unwrap()).is_none());
        let limits = ServoLimits { pulse_us_per_s_max: 3000, pulse_us_per_s2_max: 30_000 };
        let neck = ServoMap::new(0, [600, 1400, 2200], -9 << 16, limits).unwrap();
        let servos = [neck.on_output(4), neck.on_output(5)];
        let mut blob = vec![0; plain.len() + 100];
        let length =
            karakuri::servo_records::with_servos(&plain, &servos, 25_000_000, &mut blob).unwrap();
        let model = Model::from_bytes(&blob[..length]).unwrap();
        let names = vec!["neck".to_owned(), "neck_5".to_owned()];
        assert_eq!(own_servos(&model), Some((names, servos.to_vec())));
        let trace = crate::trace(&model, &options()).unwrap();
        assert!(!trace.options.stand_in);
        assert!(trace.csv().unwrap().starts_with(b"# fixture"));
    }

    #[test]
    fn angles_are_converted_and_pulse_widths_taken_as_they_are() {
        let groups = [
            group("jaw", GroupKind::Scalar, Unit::Degree),
            group("root", GroupKind::Translation, Unit::Metre),
            group("neck", GroupKind::Scalar, Unit::Radian),
            group("lid", GroupKind::Scalar, Unit::Microsecond),
        ];
        let (names, maps) = stand_ins(groups.into_iter(), &options()).unwrap();
        assert_eq!(names, ["jaw", "neck", "lid"]);
        let limits =
            ServoLimits { pulse_us_per_s_max: US_PER_S_MAX, pulse_us_per_s2_max: US_PER_S2_MAX };
        let map = |channel, q16| ServoMap::new(channel, PULSES_US, q16, limits).unwrap();
        // 10 · 180/π · 2^16 = 37,549,361.7…
        let lid = map(5, 1 << 16).with_neutral_at(1500 << 16);
        assert_eq!(maps, [map(0, 10 << 16), map(4, 37_549_362), lid]);
    }
}
