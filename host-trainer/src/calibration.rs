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

use karakuri::limits::SERVOS_MAX;
use karakuri::servo_records::{OSCILLATOR_HZ, servos_bytes, with_servos};
use karakuri::{Model, ServoMap};
use serde::Deserialize;

use crate::error::{Error, Result};
use crate::inspect::blob::load;
use crate::layout::{Group, GroupKind, PoseLayout};
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

/// The layout of a model's poses.
pub fn layout_of(model: &Model<'_>) -> PoseLayout {
    let groups = model.groups().map(|group| Group {
        name: group.name.to_owned(),
        kind: group.kind,
        unit: group.unit,
    });
    PoseLayout { groups: groups.collect() }
}
