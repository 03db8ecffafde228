//! The servos that a motion is baked for: which number of a pose each follows, and the pulse that asks for.
//!
//! In:  the layout of a model.
//! Out: [`Servo`]s to `pulse_track.rs`.
//!
//! Why here: the one place where pulses come from, so that a real calibration replaces the stand-in below for every
//! format at once.

use crate::error::{Error, Result};
use crate::layout::{GroupKind, PoseLayout, Unit};

/// Shortest, neutral and longest pulse of a servo that nobody calibrated, µs: a hobby servo's full travel.
pub const DEFAULT_PULSES_US: [f64; 3] = [500.0, 1500.0, 2500.0];
/// Its gain, µs per degree: 2000 µs over 200° of travel.
pub const DEFAULT_US_PER_DEGREE: f64 = 10.0;
/// Its speed limit, µs/s: 600 °/s at the default gain, a small hobby servo without load.
pub const DEFAULT_US_PER_S_MAX: f64 = 6000.0;

/// Calibration of one servo.
#[derive(Clone, Debug, PartialEq)]
pub struct Servo {
    /// Name of the joint.
    pub name: String,
    /// The channel that it follows.
    pub channel: usize,
    /// Shortest, neutral and longest pulse, µs.
    pub pulses_us: [f64; 3],
    /// µs per unit of the channel; negative: reversed.
    pub us_per_unit: f64,
    /// Value of the channel at the neutral pulse.
    pub value_at_neutral: f64,
    /// Speed limit, µs of pulse per second.
    pub us_per_s_max: f64,
}

impl Servo {
    /// The pulse that a pose asks for, before any limit, µs. // pose: (channel)
    pub fn asked_us(&self, pose: &[f32]) -> f64 {
        let value = f64::from(pose[self.channel]);
        self.pulses_us[1] + self.us_per_unit * (value - self.value_at_neutral)
    }
}

/// One servo for every scalar channel, all calibrated alike.
///
/// # Errors
/// No channel is a scalar.
pub fn default_servos(layout: &PoseLayout) -> Result<Vec<Servo>> {
    let scalars = layout.ranges().filter(|(group, _)| group.kind == GroupKind::Scalar);
    let servos: Vec<Servo> = scalars
        .map(|(group, range)| Servo {
            name: group.name.clone(),
            channel: range.start,
            pulses_us: DEFAULT_PULSES_US,
            us_per_unit: match group.unit {
                Unit::Radian => DEFAULT_US_PER_DEGREE.to_degrees(),
                Unit::Microsecond => 1.0,
                _ => DEFAULT_US_PER_DEGREE,
            },
            value_at_neutral: match group.unit {
                Unit::Microsecond => DEFAULT_PULSES_US[1],
                _ => 0.0,
            },
            us_per_s_max: DEFAULT_US_PER_S_MAX,
        })
        .collect();
    match servos.is_empty() {
        false => Ok(servos),
        true => Err(Error::bad_input(
            "model",
            "number of scalar channels",
            0,
            "at least 1: this format holds servo pulses",
            "bake csv or bvh, or a model of servo tracks; a body of joints first needs the kinematics of a robot",
        )),
    }
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
        let pose = [30.0, 0.0, 0.0, 0.0, std::f32::consts::FRAC_PI_6, 1234.5];
        let asked: Vec<f64> = servos.iter().map(|servo| servo.asked_us(&pose)).collect();
        assert!((asked[0] - 1800.0).abs() < 1e-9 && (asked[1] - 1800.0).abs() < 1e-4, "{asked:?}");
        assert_eq!(asked[2], 1234.5);
    }
}
