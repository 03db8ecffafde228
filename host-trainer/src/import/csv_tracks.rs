//! Station 1: servo tracks as comma-separated values → clips of scalars.
//!
//! ```text
//! # anything after a hash is a comment
//! time_s, jaw_deg, neck_yaw_rad, eyelid_us
//! 0.00, 12.5, 0.1, 1500
//! 0.02, 12.7, 0.1, 1500
//! ```
//!
//! Every column but `time_s` is a servo: its name, an underscore, its unit. Without `time_s`,
//! `--fps` gives the rate.

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
            let expected =
                format!("{} as in {}", layout.channel_names().join(","), first.display());
            let remedy = "give all files the same columns";
            return Err(Error::bad_input(&file.path, "header", value, expected, remedy));
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

/// The file's poses at the rate of the set, which the first file with time decides if nothing else
/// did.
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
            None => Err(Error::bad_input(file, "rate", "unknown", expected, "add one of them")),
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

/// The rate that fits the times: a whole number if it does, else a hundredth if it does, else the
/// nearest whole number.
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
    let mut reader =
        csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(bytes);
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
                return Err(Error::bad_input(file, field, text, "a finite number", remedy));
            };
            match is_time {
                true => times_s.push(number),
                false => poses.push(number as f32),
            }
        }
        lines.push(line);
    }
    check_times(file, &times_s, |index| format!("line {}, column {TIME_COLUMN}", lines[index]))?;
    Ok(Tracks { layout, times_s: has_time.then_some(times_s), poses })
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
            return Err(Error::bad_input(file, field, column, expected, "rename the column"));
        };
        if layout.groups.iter().any(|group| group.name == name) {
            let expected = "a name that no other column has";
            return Err(Error::bad_input(file, field, column, expected, "rename the column"));
        }
        layout.groups.push(Group { name: name.into(), kind: GroupKind::Scalar, unit });
    }
    match layout.groups.is_empty() {
        false => Ok(layout),
        true => {
            let value = format!("{:?}", header.iter().collect::<Vec<_>>().join(","));
            let expected = "time_s and at least one <name>_<unit>";
            Err(Error::bad_input(file, "header", value, expected, "add the header line"))
        }
    }
}

fn name_and_unit(column: &str) -> Option<(&str, Unit)> {
    let (name, suffix) = column.rsplit_once('_')?;
    let is_name = !name.is_empty() && !name.contains([';', '\t']);
    unit_of_suffix(suffix).filter(|_| is_name).map(|unit| (name, unit))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::support::{assert_refused, folder};
    use super::super::{Format, read as import};
    use super::*;
    use crate::clip::ClipSet;

    fn imported_at(rate_hz: Option<f64>, files: &[(&str, &str)]) -> Result<ClipSet> {
        let files: Vec<(&str, &[u8])> =
            files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
        let folder = folder(&files);
        let options =
            ImportOptions { rate_hz, tolerate_missing_labels: true, ..Default::default() };
        import(folder.path(), &options)
    }

    fn refused(text: &str, words: &[&str]) {
        assert_refused(imported_at(None, &[("nod.csv", text)]), &[&["nod.csv"], words].concat());
    }

    #[test]
    fn headers_without_names_or_units_are_refused() {
        refused("", &["header", "time_s and at least one"]);
        refused("time_s\n0\n1\n", &["header", "at least one"]);
        refused("time_s,jaw\n0,1\n", &["header, column 2 is jaw", "<name>_<unit>", "us"]);
        refused("time_s,jaw_furlong\n0,1\n", &["jaw_furlong"]);
        refused("time_s,_deg\n0,1\n", &["column 2 is _deg"]);
        refused("time_s;jaw_deg\n0;1\n", &["time_s;jaw_deg", "split by commas"]);
        refused("0.0,1.5\n0.1,1.6\n", &["header, column 1 is 0.0"]);
        refused("time_s,jaw_deg,jaw_rad\n0,1,1\n", &["column 3", "no other column"]);
    }

    #[test]
    fn values_that_are_no_numbers_are_refused_with_line_and_column() {
        let words = ["line 4, column jaw_deg", "a finite number"];
        for value in ["x", "", "NaN", "inf", "1e300", "1;2"] {
            let text = format!("# made by hand\ntime_s,jaw_deg\n0,1\n0.1,{value}\n");
            refused(&text, &words);
        }
        refused("time_s,jaw_deg\n0,1\nx,2\n", &["line 3, column time_s is x"]);
    }

    #[test]
    fn ragged_rows_are_refused_with_their_line() {
        refused("time_s,jaw_deg\n0,1\n0.1,2,3\n", &["line: 3", "3 fields"]);
        refused("time_s,jaw_deg\n0,1\n0.1\n", &["line: 3", "1 field"]);
    }

    #[test]
    fn times_that_go_back_are_refused_with_their_line() {
        refused("time_s,jaw_deg\n0,1\n#\n0.1,2\n0.1,3\n", &["line 5, column time_s"]);
    }

    #[test]
    fn short_tracks_are_refused() {
        refused("time_s,jaw_deg\n", &["0 frames"]);
        refused("time_s,jaw_deg\n0,1\n", &["1 frame", "at least 2"]);
    }

    #[test]
    fn missing_rate_is_refused() {
        refused("jaw_deg\n1\n2\n", &["rate is unknown", "time_s", "--fps"]);
    }

    #[test]
    fn rate_that_no_body_has_is_refused() {
        refused("time_s,jaw_deg\n0,1\n0.00001,2\n", &["rate is 100000", "1.0..=1000.0"]);
    }

    #[test]
    fn files_with_other_columns_are_refused() {
        let files = [("a.csv", "jaw_deg\n1\n2\n"), ("b.csv", "neck_deg\n1\n2\n")];
        let result = imported_at(Some(50.0), &files);
        assert_refused(result, &["b.csv", "neck_deg", "jaw_deg as in"]);
    }

    #[test]
    fn tracks_become_scalars_in_their_units() {
        let text =
            "\u{feff}# a comment\r\ntime_s, jaw_deg ,eye_lid_us\r\n0, 1.5,1500\r\n0.02,2,1501\r\n";
        let set = imported_at(None, &[("nod.csv", text)]).unwrap();
        assert_eq!(set.layout.channel_names(), ["jaw_deg", "eye_lid_us"]);
        assert_eq!((set.rate_hz, &set.clips[0].poses[..]), (50.0, &[1.5, 1500.0, 2.0, 1501.0][..]));
        assert_eq!(set.remarks, Vec::<String>::new());
    }

    #[test]
    fn file_without_time_runs_at_the_given_rate() {
        let set = imported_at(Some(25.0), &[("nod.csv", "jaw_deg\n1\n2\n")]).unwrap();
        assert_eq!((set.rate_hz, &set.clips[0].poses[..]), (25.0, &[1.0, 2.0][..]));
    }

    #[test]
    fn jittered_times_are_resampled_and_remarked() {
        let text = "time_s,jaw_deg\n0,0\n0.019,19\n0.042,42\n0.06,60\n0.08,80\n";
        let set = imported_at(None, &[("nod.csv", text)]).unwrap();
        assert_eq!(set.rate_hz, 50.0);
        assert_eq!(set.clips[0].poses, [0.0, 20.0, 40.0, 60.0, 80.0]);
        assert!(set.remarks[0].contains("nod.csv: resampled to 50"));
    }

    #[test]
    fn first_file_decides_the_rate_unless_a_flag_does() {
        let files = [
            ("a.csv", "time_s,jaw_deg\n0,0\n0.1,1\n0.2,2\n"),
            ("b.csv", "time_s,jaw_deg\n0,0\n0.05,1\n0.1,2\n"),
        ];
        let set = imported_at(None, &files).unwrap();
        assert_eq!((set.rate_hz, set.clips[1].poses.as_slice()), (10.0, &[0.0, 2.0][..]));
        let set = imported_at(Some(20.0), &files).unwrap();
        assert_eq!((set.rate_hz, set.clips[0].poses.len()), (20.0, 5));
    }

    #[test]
    fn non_finite_value_passes_where_it_is_to_be_reported() {
        let folder = folder(&[("nod.csv", b"time_s,jaw_deg\n0,1\n0.1,nan\n")]);
        let options = ImportOptions {
            format: Some(Format::Csv),
            tolerate_missing_labels: true,
            tolerate_non_finite: true,
            ..Default::default()
        };
        let set = import(folder.path(), &options).unwrap();
        assert!(set.clips[0].poses[1].is_nan());
    }

    proptest! {
        #[test]
        fn any_track_survives_the_round_trip(
            values in prop::collection::vec(proptest::num::f32::NORMAL, 2..60),
        ) {
            let rows: String = values.iter().map(|value| format!("{value}\n")).collect();
            let text = format!("jaw_deg\n{rows}");
            let tracks = parse(Path::new("a.csv"), text.as_bytes(), &ImportOptions::default()).unwrap();
            prop_assert_eq!(tracks.poses, values);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = parse(Path::new("a.csv"), &bytes, &ImportOptions::default());
        }

        #[test]
        fn arbitrary_tables_never_panic(text in "(time_s,)?a_deg(\n[-0-9.einf,#\" ]{0,12}){0,6}") {
            let _ = imported_at(None, &[("a.csv", &text)]);
        }
    }
}
