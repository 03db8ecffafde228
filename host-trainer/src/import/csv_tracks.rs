//! Station 1: servo tracks as comma-separated values → clips of scalars.
//!
//! ```text
//! # anything after a hash is a comment
//! time_s, jaw_deg, neck_yaw_rad, eyelid_us
//! 0.00, 12.5, 0.1, 1500
//! 0.02, 12.7, 0.1, 1500
//! ```
//!
//! Every column but `time_s` is a servo: its name, an underscore, its unit. Without `time_s`, `--fps` gives the rate.

use std::path::Path;

use super::files::ClipFile;
use super::resample::{check_times, is_regular, resample, rounded_rate_hz};
use super::{
    ImportOptions, Recordings, Remarks, UNITS, check_poses, unit_of_suffix, with_progress,
};
use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};

const TIME_COLUMN: &str = "time_s";

/// One parsed file.
#[derive(Debug)]
struct Tracks {
    layout: PoseLayout,
    times_s: Option<Vec<f64>>, // (frame)
    poses: Vec<f32>,           // (frame, channel)
}

/// Reads every file; all must have the columns of the first, and are brought to its rate.
pub(crate) fn read(
    files: &[ClipFile],
    options: &ImportOptions,
    remarks: &mut Remarks,
) -> Result<Recordings> {
    let first = &files[0].path;
    let mut layout: Option<PoseLayout> = None;
    let mut set_rate_hz = options.rate_hz;
    let mut poses = Vec::with_capacity(files.len());
    for file in with_progress(files) {
        let bytes = std::fs::read(&file.path).map_err(Error::io("read", &file.path))?;
        let tracks = parse(&file.path, &bytes, options)?;
        let layout = layout.get_or_insert_with(|| tracks.layout.clone());
        if tracks.layout != *layout {
            let value = tracks.layout.channel_names().join(",");
            let expected = format!(
                "{} as in {}",
                layout.channel_names().join(","),
                first.display()
            );
            let remedy = "give all files the same columns";
            return Err(Error::bad_input(
                &file.path, "header", value, expected, remedy,
            ));
        }
        check_poses(&file.path, layout, &tracks.poses, options)?;
        let regular = regular_poses(&file.path, tracks, &mut set_rate_hz, remarks)?;
        check_poses(&file.path, layout, &regular, options)?;
        poses.push(regular);
    }
    Ok(Recordings {
        layout: layout.unwrap_or_default(),
        rate_hz: set_rate_hz.unwrap_or_default(),
        skeleton: None,
        poses,
    })
}

/// The file's poses at the rate of the set, which the first file with time decides if nothing else did.
fn regular_poses(
    file: &Path,
    tracks: Tracks,
    set_rate_hz: &mut Option<f64>,
    remarks: &mut Remarks,
) -> Result<Vec<f32>> {
    let Some(times_s) = &tracks.times_s else {
        let expected = "a column time_s, or --fps RATE";
        return match set_rate_hz {
            Some(_) => Ok(tracks.poses),
            None => Err(Error::bad_input(
                file,
                "rate",
                "unknown",
                expected,
                "add one of them",
            )),
        };
    };
    let rate_hz = *set_rate_hz.get_or_insert_with(|| rate_of(times_s));
    super::check_rate(file, rate_hz)?;
    if is_regular(times_s, rate_hz) {
        return Ok(tracks.poses);
    }
    remarks.note(file, format!("resampled to {rate_hz} poses per second"));
    Ok(resample(&tracks.layout, times_s, &tracks.poses, rate_hz))
}

/// The rate that fits the times: a whole number if it does, else a hundredth if it does, else the nearest whole number.
fn rate_of(times_s: &[f64]) -> f64 {
    let span_s = times_s[times_s.len() - 1] - times_s[0];
    let exact_hz = rounded_rate_hz(span_s / (times_s.len() - 1) as f64);
    let whole_hz = exact_hz.round().max(1.0);
    match is_regular(times_s, exact_hz) && !is_regular(times_s, whole_hz) {
        true => exact_hz,
        false => whole_hz,
    }
}

/// Decodes one file; times are checked, values only for being numbers.
fn parse(file: &Path, bytes: &[u8], options: &ImportOptions) -> Result<Tracks> {
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(bytes);
    let malformed = |error: csv::Error| {
        let expected = "rows of as many values as the header has columns";
        Error::bad_input(file, "table", error, expected, "correct the line")
    };
    let header = reader.headers().map_err(malformed)?.clone();
    let layout = layout_of(file, &header)?;
    let has_time = header.get(0) == Some(TIME_COLUMN);
    let (mut times_s, mut lines, mut poses) = (Vec::new(), Vec::new(), Vec::new());
    for record in reader.records() {
        let record = record.map_err(malformed)?;
        let line = record.position().map_or(0, csv::Position::line);
        for (index, text) in record.iter().enumerate() {
            let number = text.parse::<f64>().ok();
            let is_time = has_time && index == 0;
            let is_usable = |number: &f64| {
                (*number as f32).is_finite() || options.tolerate_non_finite && !is_time
            };
            let Some(number) = number.filter(is_usable) else {
                let field = format!("line {line}, column {}", &header[index]);
                let remedy = "correct the line";
                return Err(Error::bad_input(
                    file,
                    field,
                    text,
                    "a finite number",
                    remedy,
                ));
            };
            match is_time {
                true => times_s.push(number),
                false => poses.push(number as f32),
            }
        }
        lines.push(line);
    }
    check_times(file, &times_s, |index| {
        format!("line {}, column {TIME_COLUMN}", lines[index])
    })?;
    Ok(Tracks {
        layout,
        times_s: has_time.then_some(times_s),
        poses,
    })
}

fn layout_of(file: &Path, header: &csv::StringRecord) -> Result<PoseLayout> {
    let columns = header.iter().enumerate();
    let servos = columns.filter(|(index, column)| *index > 0 || *column != TIME_COLUMN);
    let mut layout = PoseLayout::default();
    for (index, column) in servos {
        let field = format!("header, column {}", index + 1);
        let Some((name, unit)) = name_and_unit(column) else {
            let suffixes = UNITS.map(Unit::suffix).join(", ");
            let expected =
                format!("<name>_<unit>, unit one of {suffixes}, columns split by commas");
            return Err(Error::bad_input(
                file,
                field,
                column,
                expected,
                "rename the column",
            ));
        };
        if layout.groups.iter().any(|group| group.name == name) {
            let expected = "a name that no other column has";
            return Err(Error::bad_input(
                file,
                field,
                column,
                expected,
                "rename the column",
            ));
        }
        layout.groups.push(Group {
            name: name.into(),
            kind: GroupKind::Scalar,
            unit,
        });
    }
    match layout.groups.is_empty() {
        false => Ok(layout),
        true => {
            let value = format!("{:?}", header.iter().collect::<Vec<_>>().join(","));
            let expected = "time_s and at least one <name>_<unit>";
            Err(Error::bad_input(
                file,
                "header",
                value,
                expected,
                "add the header line",
            ))
        }
    }
}

fn name_and_unit(column: &str) -> Option<(&str, Unit)> {
    let (name, suffix) = column.rsplit_once('_')?;
    let is_name = !name.is_empty() && !name.contains([';', '\t']);
    unit_of_suffix(suffix)
        .filter(|_| is_name)
        .map(|unit| (name, unit))
}
