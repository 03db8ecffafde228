//! One `[[servo]]` of a calibration file, in a builder's words and units.
//!
//! In:  TOML; the group of channels that the servo follows.
//! Out: core's [`ServoMap`], or a refusal that names servo, key, value and remedy.

use std::path::Path;

use karakuri::{Axis, AxisOrder, PULSE_US_MAX, ServoError, ServoLimits, ServoMap};
use serde::Deserialize;

use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, Unit};

/// What a builder says about one servo; README has the meaning of every key.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "keys of the file, described in README")]
pub struct ServoRow {
    pub channel: String,
    pub axis: Option<String>,
    pub order: Option<String>,
    pub output: Option<i64>,
    pub min_us: i64,
    pub neutral_us: i64,
    pub max_us: i64,
    pub park_us: Option<i64>,
    pub trim_us: Option<i64>,
    pub us_per_degree: Option<f64>,
    pub us_per_unit: Option<f64>,
    #[serde(default)]
    pub reverse: bool,
    pub neutral_at: Option<f64>,
    pub speed_us_per_s: Option<f64>,
    pub speed_deg_per_s: Option<f64>,
    pub acceleration_us_per_s2: Option<f64>,
    pub acceleration_deg_per_s2: Option<f64>,
}

/// A row with what is needed to refuse it well.
struct Place<'a> {
    source: &'a Path,
    row: &'a ServoRow,
}

impl ServoRow {
    /// Group and axis.
    pub fn name(&self, group: &Group) -> String {
        match &self.axis {
            Some(axis) if group.kind == GroupKind::Rotation6d => format!("{}_{axis}", group.name),
            _ => group.name.clone(),
        }
    }

    /// The record of this servo, which follows `group` from channel `start` on and is number `index` of the file.
    ///
    /// # Errors
    /// `BadInput`: a number that no servo can have, a key too many or too few, whatever core refuses.
    pub fn map(
        &self,
        source: &Path,
        group: &Group,
        start: usize,
        index: usize,
    ) -> Result<ServoMap> {
        let place = Place { source, row: self };
        let unit = place.unit(group)?;
        let pulses_us = [
            place.pulse("min_us", self.min_us)?,
            place.pulse("neutral_us", self.neutral_us)?,
            place.pulse("max_us", self.max_us)?,
        ];
        let park_us = place.pulse("park_us", self.park_us.unwrap_or(self.neutral_us))?;
        let gain = place.gain_q16(unit)?;
        let limits = ServoLimits {
            pulse_us_per_s_max: place.speed()?,
            pulse_us_per_s2_max: place.acceleration()?,
        };
        let output = self.output.unwrap_or(index as i64);
        let output = place.number("output", output, "0 to 255", "number the outputs from 0 on")?;
        let trim_us = self.trim_us.unwrap_or(0);
        let trim_us = place.number("trim_us", trim_us, "-20000 to 20000", "measure it again")?;
        let map = ServoMap::new(start as u16, pulses_us, gain, limits)
            .and_then(|map| map.with_park_at(park_us)?.with_trim(trim_us))
            .map_err(|error| place.refused(&error))?;
        let map = map.with_neutral_at(place.neutral_at_q16(unit)?).on_output(output);
        place.following(map, group)
    }
}

impl Place<'_> {
    fn bad(
        &self,
        key: &str,
        value: impl ToString,
        expected: impl ToString,
        remedy: impl ToString,
    ) -> Error {
        let field = format!("servo {}, {key}", self.row.channel);
        Error::bad_input(self.source, field, value, expected, remedy)
    }

    fn number<Number: TryFrom<i64>>(
        &self,
        key: &str,
        value: i64,
        expected: &str,
        remedy: &str,
    ) -> Result<Number> {
        Number::try_from(value).map_err(|_| self.bad(key, value, expected, remedy))
    }

    fn pulse(&self, key: &str, value: i64) -> Result<u16> {
        let pulse_us = u16::try_from(value).ok();
        pulse_us.filter(|pulse_us| (1..=PULSE_US_MAX).contains(pulse_us)).ok_or_else(|| {
            let expected = format!("1 to {PULSE_US_MAX}");
            self.bad(key, value, expected, "give the pulse in whole microseconds, such as 1500")
        })
    }

    /// The unit of what the servo reads; angles of rotations are degrees.
    fn unit(&self, group: &Group) -> Result<Unit> {
        let row = self.row;
        match group.kind {
            GroupKind::Scalar if row.axis.is_some() || row.order.is_some() => {
                let remedy = "axis and order are for rotations: remove them";
                Err(self.bad("axis", "given", "none for a scalar channel", remedy))
            }
            GroupKind::Scalar => Ok(group.unit),
            GroupKind::Rotation6d if row.axis.is_none() => {
                let remedy =
                    "write axis = \"x\" (twist), with order = \"zyx\" for three servos in series";
                Err(self.bad("axis", "missing", "x, y or z", remedy))
            }
            GroupKind::Rotation6d => Ok(Unit::Degree),
            GroupKind::Translation | GroupKind::Position => {
                let remedy =
                    "train on servo tracks or rotations: positions first need inverse kinematics";
                Err(self.bad("channel", group.kind.name(), "a scalar or a rotation", remedy))
            }
        }
    }

    /// µs per unit of the channel, with its sign.
    fn gain_q16(&self, unit: Unit) -> Result<i32> {
        let row = self.row;
        let (key, us_per_unit) = match (row.us_per_degree, row.us_per_unit, unit) {
            (Some(us), None, Unit::Degree) => ("us_per_degree", us),
            (Some(us), None, Unit::Radian) => ("us_per_degree", us.to_degrees()),
            (None, Some(us), _) => ("us_per_unit", us),
            (None, None, Unit::Microsecond) => ("us_per_unit", 1.0),
            (Some(us), None, _) => {
                let expected = format!("us_per_unit for a channel in {}", unit.suffix());
                return Err(self.bad("us_per_degree", us, expected, "give us_per_unit"));
            }
            (given, _, _) => {
                let found = if given.is_some() { "given twice" } else { "missing" };
                let remedy = "give us_per_degree for angles, us_per_unit for anything else";
                return Err(self.bad("us_per_degree", found, "one of the two", remedy));
            }
        };
        let gain = (us_per_unit * 65_536.0).round();
        // NaN is in no range.
        if !(1.0..=f64::from(i32::MAX)).contains(&gain) {
            let remedy = "give microseconds of pulse, such as 10; `reverse = true` turns round";
            return Err(self.bad(key, us_per_unit, "0.00002 to 32767", remedy));
        }
        Ok(if row.reverse { -(gain as i32) } else { gain as i32 })
    }

    /// Channel value at the neutral pulse.
    fn neutral_at_q16(&self, unit: Unit) -> Result<i32> {
        let neutral_us = if unit == Unit::Microsecond { self.row.neutral_us } else { 0 };
        let value = self.row.neutral_at.unwrap_or(neutral_us as f64);
        let value_q16 = (value * 65_536.0).round();
        if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value_q16) {
            let remedy = "give the channel's value at the neutral pulse, in the channel's unit";
            return Err(self.bad("neutral_at", value, "-32768 to 32767", remedy));
        }
        Ok(value_q16 as i32)
    }

    fn speed(&self) -> Result<u32> {
        let keys = ["speed_us_per_s", "speed_deg_per_s"];
        let remedy = "60° in 0.1 s is 600 °/s without load; give two thirds of that";
        self.limit(keys, self.row.speed_us_per_s, self.row.speed_deg_per_s, remedy)
    }

    fn acceleration(&self) -> Result<u32> {
        let keys = ["acceleration_us_per_s2", "acceleration_deg_per_s2"];
        let (in_us, in_degrees) =
            (self.row.acceleration_us_per_s2, self.row.acceleration_deg_per_s2);
        self.limit(keys, in_us, in_degrees, "ten times the speed is reached in 0.1 s")
    }

    /// A limit in µs, rounded down.
    fn limit(
        &self,
        [key_us, key_degrees]: [&str; 2],
        in_us: Option<f64>,
        in_degrees: Option<f64>,
        remedy: &str,
    ) -> Result<u32> {
        let (key, given, us) = match (in_us, in_degrees, self.row.us_per_degree) {
            (Some(us), None, _) => (key_us, us, us),
            (None, Some(degrees), Some(us_per_degree)) => {
                (key_degrees, degrees, degrees * us_per_degree)
            }
            (None, Some(degrees), None) => {
                let expected = format!("{key_us}, or us_per_degree beside it");
                return Err(self.bad(key_degrees, degrees, expected, remedy));
            }
            (given, _, _) => {
                let found = if given.is_some() { "given twice" } else { "missing" };
                let expected = format!("{key_us} or {key_degrees}");
                return Err(self.bad(key_us, found, expected, remedy));
            }
        };
        // Less than a whole microsecond, NaN too, is no limit to move within.
        if !(1.0..=f64::from(u32::MAX)).contains(&us) {
            return Err(self.bad(key, given, "at least 1 us, at most 4294967295 us", remedy));
        }
        Ok(us as u32)
    }

    fn following(&self, map: ServoMap, group: &Group) -> Result<ServoMap> {
        if group.kind == GroupKind::Scalar {
            return Ok(map);
        }
        let row = self.row;
        let axes = [("x", Axis::X), ("y", Axis::Y), ("z", Axis::Z)];
        let given = row.axis.as_deref().unwrap_or_default();
        let axis = axes.into_iter().find(|(name, _)| *name == given).map(|(_, axis)| axis);
        let axis = axis.ok_or_else(|| self.bad("axis", given, "x, y or z", "name one axis"))?;
        let Some(given) = &row.order else {
            return Ok(map.following_twist(axis));
        };
        let order = AxisOrder::ALL.into_iter().find(|order| order_name(*order) == *given);
        let names = AxisOrder::ALL.map(order_name).join(", ");
        let remedy = "name the axes from the servo at the parent to the one at the part";
        let order =
            order.ok_or_else(|| self.bad("order", given, format!("one of {names}"), remedy))?;
        Ok(map.following_angle(order, axis))
    }

    /// What core refuses, in the words of the file.
    fn refused(&self, error: &ServoError) -> Error {
        let row = self.row;
        match *error {
            ServoError::PulsesOutOfOrder { .. } => {
                let value = format!("{}, {} and {}", row.min_us, row.neutral_us, row.max_us);
                let remedy = "swap the ends; a servo that turns the other way has reverse = true";
                self.bad("min_us, neutral_us, max_us", value, "in rising order", remedy)
            }
            ServoError::NoSpan { pulse_us, .. } => {
                let remedy = "measure both ends, or list the channel in undriven";
                self.bad("min_us and max_us", pulse_us, "a span between them", remedy)
            }
            ServoError::ParkOutside { pulse_us, range_us: [min, max], .. } => {
                let remedy = "park the servo within its range";
                self.bad("park_us", pulse_us, format!("{min} to {max}"), remedy)
            }
            ServoError::TrimOutside { trim_us, range_us: [min, max], .. } => {
                let expected = format!("neutral_us and trim_us together in {min} to {max}");
                self.bad("trim_us", trim_us, expected, "mount the horn closer to its middle")
            }
            ServoError::CannotBrake { limits, span_us, .. } => {
                let braking_us = limits.braking_us();
                let found = format!("too small: from full speed it takes {braking_us} us to stop");
                let expected = format!("at most the {span_us} us of its range");
                self.bad("acceleration", found, expected, "allow more acceleration or less speed")
            }
            _ => self.bad("calibration", error, "one that core accepts", "correct it"),
        }
    }
}

/// `zyx`.
fn order_name(order: AxisOrder) -> String {
    let letter = |axis| match axis {
        Axis::X => 'x',
        Axis::Y => 'y',
        Axis::Z => 'z',
    };
    order.axes().map(letter).iter().collect()
}
