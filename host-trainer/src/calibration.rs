//! How the servos of one robot are built: one TOML file for trainer, simulator and chip.
//!
//! In:  what the builder measured; the layout of a model or of clips.
//! Out: a [`ServoMap`] a servo, behind the tensors of a blob or to [`check`].
//!
//! Why here: a model knows channels, a robot has servos. The file is read with names and units as a builder writes
//! them and becomes core's record, so that every limit is computed once.

pub mod servo_row;
pub mod check;
pub mod template;

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use karakuri::ServoMap;
use karakuri::limits::SERVOS_MAX;
use karakuri::servo_records::{OSCILLATOR_HZ, servos_bytes, with_servos};
use serde::Deserialize;

use crate::error::{Error, Result};
use crate::generate::layout_of;
use crate::inspect::blob::load;
use crate::layout::{GroupKind, PoseLayout};
use servo_row::ServoRow;

/// The slowest and the fastest oscillator that a PCA9685 may have, Hz.
const OSCILLATOR_HZ_RANGE: std::ops::RangeInclusive<i64> = 1_000_000..=50_000_000;

/// A calibration file, before anything is known about the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    source: PathBuf,
    oscillator_hz: u32,
    rows: Vec<ServoRow>,
    undriven: Vec<String>,
}

/// One servo of a layout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Servo {
    /// Its group, with the axis where a rotation has several: `neck`, `head_z`.
    pub name: String,
    /// Its calibration.
    pub map: ServoMap,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CalibrationFile {
    pca9685: Option<Pca9685>,
    #[serde(default)]
    undriven: Vec<String>,
    servo: Vec<ServoRow>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pca9685 {
    oscillator_hz: i64,
}

impl Calibration {
    /// Reads a file.
    ///
    /// # Errors
    /// `Io`, and those of [`parse`](Self::parse).
    pub fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
        Self::parse(&text, path)
    }

    /// Reads the text of a file; `source` is for messages.
    ///
    /// # Errors
    /// `BadInput`: no TOML, a key that no calibration has, no servo, an oscillator that no PCA9685 has.
    pub fn parse(text: &str, source: &Path) -> Result<Self> {
        let file: CalibrationFile = toml::from_str(text).map_err(|error| {
            let found = error.to_string().trim_end().replace('\n', " ");
            let remedy = "correct that place; `host-trainer calibrate --template` writes a file to start from";
            Error::bad_input(source, "the calibration", found, "[[servo]] entries", remedy)
        })?;
        let given_hz = file.pca9685.map_or(i64::from(OSCILLATOR_HZ), |board| board.oscillator_hz);
        if !OSCILLATOR_HZ_RANGE.contains(&given_hz) {
            let remedy = "boards have 23,000,000 to 27,000,000; 25,000,000 if it was not measured";
            let expected = "1,000,000 to 50,000,000";
            return Err(Error::bad_input(
                source,
                "pca9685.oscillator_hz",
                given_hz,
                expected,
                remedy,
            ));
        }
        Ok(Self {
            source: source.to_owned(),
            oscillator_hz: given_hz as u32,
            rows: file.servo,
            undriven: file.undriven,
        })
    }

    /// Frequency of the PCA9685's oscillator.
    pub fn oscillator_hz(&self) -> u32 {
        self.oscillator_hz
    }

    /// The servos of a layout, in the order of the file.
    ///
    /// # Errors
    /// `BadInput` with file, servo and field: what [`ServoRow::map`] refuses, a channel that the layout does not have
    /// or that is driven twice, an output that is used twice, a scalar channel without servo.
    pub fn servos(&self, layout: &PoseLayout) -> Result<Vec<Servo>> {
        let mut servos = Vec::new();
        for (index, row) in self.rows.iter().enumerate() {
            let (group, range) = layout
                .ranges()
                .find(|(group, _)| group.name == row.channel)
                .ok_or_else(|| self.unknown_channel(&row.channel, layout))?;
            servos.push(Servo {
                name: row.name(group),
                map: row.map(&self.source, group, range.start, index)?,
            });
        }
        self.check_number(servos.len())?;
        self.check_once("channel", servos.iter().map(|servo| servo.name.clone()))?;
        self.check_once("output", servos.iter().map(|servo| servo.map.output().to_string()))?;
        self.check_all_driven(layout)?;
        Ok(servos)
    }

    /// A blob with these servos in place of those that it has.
    ///
    /// # Errors
    /// [`Error::Blob`] for a blob that does not load, and those of [`servos`](Self::servos).
    pub fn put_into(&self, path: &Path, blob: &[u8]) -> Result<Vec<u8>> {
        let servos = self.servos(&layout_of(&load(path, blob)?))?;
        let maps: Vec<ServoMap> = servos.iter().map(|servo| servo.map).collect();
        let refused = |reason: karakuri::BlobError| Error::Blob {
            path: path.into(),
            reason: reason.to_string(),
        };
        let mut output = vec![0; blob.len() + servos_bytes(maps.len())];
        let length = with_servos(blob, &maps, self.oscillator_hz, &mut output).map_err(refused)?;
        output.truncate(length);
        load(path, &output)?;
        Ok(output)
    }

    fn unknown_channel(&self, channel: &str, layout: &PoseLayout) -> Error {
        let names: Vec<&str> = layout.groups.iter().map(|group| group.name.as_str()).collect();
        let expected = format!("one of {}", names.join(", "));
        let remedy = "correct the name, or leave the servo out";
        Error::bad_input(&self.source, "channel", channel, expected, remedy)
    }

    fn check_number(&self, count: usize) -> Result<()> {
        if (1..=SERVOS_MAX).contains(&count) {
            return Ok(());
        }
        let expected = format!("1 to {SERVOS_MAX}");
        let remedy = "give a [[servo]] for each servo of one robot";
        Err(Error::bad_input(&self.source, "number of servos", count, expected, remedy))
    }

    fn check_once(&self, field: &str, values: impl Iterator<Item = String>) -> Result<()> {
        let mut seen = HashSet::new();
        for value in values {
            if seen.contains(&value) {
                let remedy = format!("give every servo {field} of its own");
                return Err(Error::bad_input(
                    &self.source,
                    field,
                    value,
                    "once in the file",
                    remedy,
                ));
            }
            seen.insert(value);
        }
        Ok(())
    }

    /// A channel that nobody drives is a servo that somebody forgot, unless the file says so.
    fn check_all_driven(&self, layout: &PoseLayout) -> Result<()> {
        let is_driven = |name: &str| self.rows.iter().any(|row| row.channel == name);
        let is_undriven = |name: &str| self.undriven.iter().any(|undriven| undriven == name);
        for name in &self.undriven {
            if !layout.groups.iter().any(|group| group.name == *name) {
                return Err(self.unknown_channel(name, layout));
            }
            if is_driven(name) {
                let remedy = "take it out of `undriven`, or its [[servo]] out of the file";
                return Err(Error::bad_input(&self.source, "undriven", name, "no servo's", remedy));
            }
        }
        let missing = layout.groups.iter().find(|group| {
            group.kind == GroupKind::Scalar && !is_driven(&group.name) && !is_undriven(&group.name)
        });
        missing.map_or(Ok(()), |group| {
            let remedy = format!("add one, or write undriven = [\"{}\"] at the top", group.name);
            let field = format!("servo of channel {}", group.name);
            Err(Error::bad_input(&self.source, field, "missing", "a [[servo]]", remedy))
        })
    }
}

#[cfg(test)]
mod tests {
    use karakuri::{Axis, AxisOrder, ServoLimits};

    use super::*;
    use crate::layout::{Group, Unit};

    const JAW: &str = "[[servo]]\nchannel = \"jaw\"\noutput = 3\nmin_us = 1000\nneutral_us = 1400\n\
        max_us = 2000\nus_per_degree = 10\nspeed_us_per_s = 2000\nacceleration_us_per_s2 = 20000\n";

    fn group(name: &str, kind: GroupKind, unit: Unit) -> Group {
        Group { name: name.to_owned(), kind, unit }
    }

    fn layout() -> PoseLayout {
        let root = group("root", GroupKind::Translation, Unit::Metre);
        let head = group("head", GroupKind::Rotation6d, Unit::One);
        let groups = vec![root, group("jaw", GroupKind::Scalar, Unit::Degree), head];
        PoseLayout { groups }
    }

    fn servos(text: &str) -> Result<Vec<Servo>> {
        Calibration::parse(text, Path::new("robot.toml"))?.servos(&layout())
    }

    /// The text with one line's key set otherwise, or added.
    fn with(key: &str, value: &str) -> String {
        let line = format!("{key} = {value}");
        let is_key = |line: &&str| line.split(" = ").next() == Some(key);
        match JAW.lines().find(is_key) {
            Some(old) => JAW.replacen(old, &line, 1),
            None => format!("{JAW}{line}\n"),
        }
    }

    fn assert_refused(text: &str, says: &[&str]) {
        let error = servos(text).expect_err(text);
        assert_eq!(error.exit_code(), 3);
        let message = error.to_string();
        assert!(message.starts_with("robot.toml: "), "{message}");
        assert!(says.iter().all(|part| message.contains(part)), "{message} lacks one of {says:?}");
    }

    #[test]
    fn calibration_with_swapped_limits_is_refused() {
        assert_refused(&with("min_us", "2100"), &["servo jaw", "2100, 1400 and 2000", "swap"]);
        assert_refused(&with("neutral_us", "900"), &["servo jaw", "rising order"]);
    }

    #[test]
    fn calibration_with_impossible_pulses_is_refused() {
        for value in ["0", "20001", "-5", "70000"] {
            assert_refused(&with("max_us", value), &["servo jaw, max_us", value, "1 to 20000"]);
        }
        let one = JAW.replace("min_us = 1000", "min_us = 1400").replace("= 2000\nus", "= 1400\nus");
        assert_refused(&one, &["servo jaw, min_us and max_us is 1400", "a span"]);
        assert_refused(&with("park_us", "2001"), &["servo jaw, park_us is 2001", "1000 to 2000"]);
        assert_refused(&with("trim_us", "-401"), &["servo jaw, trim_us is -401", "1000 to 2000"]);
    }

    #[test]
    fn calibration_with_limits_that_cannot_move_or_brake_is_refused() {
        assert_refused(&with("speed_us_per_s", "0"), &["servo jaw, speed_us_per_s is 0"]);
        assert_refused(&with("speed_us_per_s", "nan"), &["servo jaw, speed_us_per_s is NaN"]);
        let acceleration = "acceleration_us_per_s2";
        assert_refused(&with(acceleration, "-1"), &["servo jaw", acceleration, "at least 1"]);
        assert_refused(&with(acceleration, "1990"), &["servo jaw", "1005 us to stop", "1000 us"]);
        assert_refused(&with("speed_deg_per_s", "9"), &["servo jaw", "given twice"]);
        let without = JAW.replace("speed_us_per_s = 2000\n", "");
        assert_refused(&without, &["speed_us_per_s is missing", "speed_deg_per_s"]);
    }

    #[test]
    fn calibration_without_a_gain_that_fits_is_refused() {
        for value in ["0", "-10", "1e9", "inf"] {
            assert_refused(&with("us_per_degree", value), &["servo jaw, us_per_degree", "reverse"]);
        }
        assert_refused(&with("us_per_unit", "1"), &["servo jaw", "given twice"]);
        assert_refused(&JAW.replace("us_per_degree = 10\n", ""), &["us_per_degree is missing"]);
    }

    #[test]
    fn missing_unknown_and_repeated_servos_are_refused() {
        assert_refused(&JAW.replace("jaw", "chin"), &["channel is chin", "root, jaw, head"]);
        assert_refused("servo = []", &["number of servos is 0", "1 to 32"]);
        let head = JAW.replace("\"jaw\"\noutput = 3", "\"head\"\naxis = \"y\"\noutput = 4");
        assert_refused(&head, &["servo of channel jaw is missing", "undriven = [\"jaw\"]"]);
        assert_refused(&format!("{JAW}{JAW}"), &["channel is jaw", "once"]);
        assert_refused(&format!("{JAW}{}", head.replace("= 4", "= 3")), &["output is 3", "once"]);
        assert_refused(&format!("undriven = [\"jaw\"]\n{JAW}"), &["undriven is jaw"]);
        assert_refused(&format!("undriven = [\"ear\"]\n{JAW}"), &["channel is ear"]);
        assert_refused(&with("output", "256"), &["servo jaw, output is 256", "0 to 255"]);
    }

    #[test]
    fn servo_of_what_no_servo_can_follow_is_refused() {
        assert_refused(&JAW.replace("jaw", "root"), &["servo root, channel is translation"]);
        assert_refused(&JAW.replace("jaw", "head"), &["servo head, axis is missing"]);
        assert_refused(&with("axis", "\"x\""), &["servo jaw, axis is given"]);
        let head = JAW.replace("\"jaw\"", "\"head\"\naxis = \"w\"");
        assert_refused(&head, &["servo head, axis is w"]);
        let head = JAW.replace("\"jaw\"", "\"head\"\naxis = \"x\"\norder = \"xxy\"");
        assert_refused(&head, &["servo head, order is xxy", "zyx"]);
    }

    #[test]
    fn what_is_no_calibration_is_refused() {
        for text in ["", "servo", "[[servo]]", &with("color", "1"), &with("reverse", "1")] {
            assert_refused(text, &["the calibration is"]);
        }
        let board = format!("[pca9685]\noscillator_hz = 0\n{JAW}");
        assert_refused(&board, &["pca9685.oscillator_hz is 0"]);
    }

    #[test]
    fn servos_are_what_the_file_says() {
        let head = "[[servo]]\nchannel = \"head\"\naxis = \"y\"\norder = \"zxy\"\nmin_us = 500\n\
            neutral_us = 1500\nmax_us = 2500\nus_per_degree = 8\nreverse = true\ntrim_us = -12\n\
            park_us = 1600\nspeed_deg_per_s = 300\nacceleration_deg_per_s2 = 3000\n";
        let found = servos(&format!("{JAW}{head}")).unwrap();
        let limits = |speed, acceleration| ServoLimits {
            pulse_us_per_s_max: speed,
            pulse_us_per_s2_max: acceleration,
        };
        let jaw = ServoMap::new(3, [1000, 1400, 2000], 10 << 16, limits(2000, 20_000)).unwrap();
        let turn = ServoMap::new(4, [500, 1500, 2500], -(8 << 16), limits(2400, 24_000)).unwrap();
        let turn = turn.with_park_at(1600).unwrap().with_trim(-12).unwrap().on_output(1);
        let expected = [
            Servo { name: "jaw".to_owned(), map: jaw.on_output(3) },
            Servo { name: "head_y".to_owned(), map: turn.following_angle(AxisOrder::Zxy, Axis::Y) },
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn pulses_and_radians_are_read_in_their_own_unit() {
        let groups = vec![
            group("lid", GroupKind::Scalar, Unit::Microsecond),
            group("jaw", GroupKind::Scalar, Unit::Radian),
        ];
        let lid = JAW.replace("jaw", "lid").replace("us_per_degree = 10\noutput = 3", "");
        let lid = lid.replace("us_per_degree = 10\n", "").replace("output = 3\n", "output = 0\n");
        let calibration =
            Calibration::parse(&format!("{lid}{JAW}"), Path::new("robot.toml")).unwrap();
        let servos = calibration.servos(&PoseLayout { groups }).unwrap();
        let [lid, jaw] = &servos[..] else { panic!("{servos:?}") };
        assert_eq!(lid.map.pulse_us_per_unit_q16(), 1 << 16);
        assert_eq!(lid.map.channel_at_neutral_q16(), 1400 << 16);
        // 10 · 180/π · 2^16 = 37,549,361.7…
        assert_eq!(jaw.map.pulse_us_per_unit_q16(), 37_549_362);
    }

    #[test]
    fn template_is_a_calibration() {
        let text = template::template(&layout());
        let servos = servos(&text).unwrap();
        let names: Vec<&str> = servos.iter().map(|servo| servo.name.as_str()).collect();
        assert_eq!(names, ["jaw", "head_z", "head_y", "head_x"]);
    }
}
