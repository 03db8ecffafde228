//! `host-trainer bake`: new motions as files that other software and firmware play.

use std::path::PathBuf;

use serde::Serialize;

use crate::atomic_file::{self, Overwrite};
use crate::bake::servo::{default_servos, servos_of};
use crate::bake::{self, BakeFormat, BakeOptions};
use crate::calibration::{Calibration, Servo};
use crate::commands::motions::MotionArgs;
use crate::error::{Error, Result};
use crate::export::{self, Motion};
use crate::inspect::blob::{load, read_blob};
use crate::stdout::{print, print_json};

/// Remarks that are printed.
const REMARKS_MAX: usize = 20;

/// Arguments of `bake`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  host-trainer bake creature.kara --action nod --seconds 2.4 --seed 7 --count 5 --format \
    blender-h --out sketch\n  host-trainer bake creature.kara --action nod --seconds 2.4 --format c-header --out nod.h"
)]
pub struct BakeArgs {
    /// What to move.
    #[command(flatten)]
    pub motions: MotionArgs,
    /// What to write.
    #[arg(long, value_enum)]
    pub format: BakeFormat,
    /// Folder, or a file where all motions fit into one.
    #[arg(long, value_name = "DIR|FILE")]
    pub out: PathBuf,
    /// Calibration of the robot's servos; otherwise those in the blob, otherwise 500 to 2500 µs at 10 µs a degree.
    #[arg(long, value_name = "FILE.toml")]
    pub calibration: Option<PathBuf>,
    /// Bottango: how far its curves may be from the motion, microseconds.
    #[arg(long, value_name = "US", default_value_t = 5.0, value_parser = tolerance)]
    pub tolerance_us: f64,
    /// Bottango: pin of every servo, separated by commas; otherwise from 2 on.
    #[arg(long, value_delimiter = ',', value_name = "PIN")]
    pub pins: Vec<u8>,
    /// Print a summary as JSON instead of the files' names.
    #[arg(long)]
    pub json: bool,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

/// What was baked.
#[derive(Serialize)]
struct Summary<'a> {
    format: String,
    motions: Vec<MotionSummary<'a>>,
    servos: Vec<&'a str>,
    files: Vec<FileSummary>,
    remarks: Vec<String>,
}

#[derive(Serialize)]
struct MotionSummary<'a> {
    action: &'a str,
    seed: u64,
    seconds: f64,
    frames: usize,
    rate_hz: f64,
    provenance: &'a str,
}

#[derive(Serialize)]
struct FileSummary {
    path: PathBuf,
    bytes: usize,
}

/// Writes the files, says on stderr what a format could not hold exactly, and prints the files' names on stdout.
///
/// # Errors
/// Those of [`MotionArgs::generate`] and [`bake::bake`]; a file that exists, without `--force`. Nothing is written.
pub fn run(args: &BakeArgs) -> Result<()> {
    let motions = args.motions.generate()?;
    let servos = servos(args, &motions)?;
    let options =
        BakeOptions { servos: &servos, pins: &args.pins, tolerance_us: args.tolerance_us };
    let (files, remarks) = bake::bake(&motions, args.format, &options, &args.out)?;
    say(&remarks);
    let overwrite = Overwrite::from_force(args.force);
    // Before the folder is made: a refusal leaves nothing behind.
    files.iter().try_for_each(|(file, _)| atomic_file::check(file, overwrite))?;
    let folder = files.first().and_then(|(file, _)| file.parent());
    if let Some(folder) = folder.filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    }
    export::write_files(&files, overwrite)?;
    if !args.json {
        let names: String = files.iter().map(|(file, _)| format!("{}\n", file.display())).collect();
        return print(names);
    }
    print_json(&Summary {
        format: clap::ValueEnum::to_possible_value(&args.format)
            .map_or_else(String::new, |value| value.get_name().to_owned()),
        motions: motions.iter().map(summary).collect(),
        servos: servos.iter().map(|servo| servo.name.as_str()).collect(),
        files: files
            .into_iter()
            .map(|(path, bytes)| FileSummary { path, bytes: bytes.len() })
            .collect(),
        remarks,
    })
}

/// On stderr; of many the first, so that nothing scrolls away.
fn say(remarks: &[String]) {
    remarks.iter().take(REMARKS_MAX).for_each(|remark| eprintln!("{remark}"));
    if let Some(more @ 1..) = remarks.len().checked_sub(REMARKS_MAX) {
        eprintln!("… and {more} remarks more; --json has all of them");
    }
}

fn tolerance(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (1.0..=500.0).contains(number));
    number.ok_or_else(|| "expected 1 to 500 microseconds".to_owned())
}

/// Of the calibration, else of the blob, else stand-ins; none where the format holds no pulses.
fn servos(args: &BakeArgs, motions: &[Motion]) -> Result<Vec<Servo>> {
    let Some(motion) = motions.first().filter(|_| args.format.has_pulses()) else {
        return Ok(Vec::new());
    };
    if let Some(path) = &args.calibration {
        return Calibration::read(path)?.servos(&motion.layout);
    }
    let source = &args.motions.source;
    if source.is_file() {
        let servos = servos_of(&load(source, &read_blob(source)?)?);
        if !servos.is_empty() {
            return Ok(servos);
        }
    }
    eprintln!(
        "no servos are calibrated: 500 to 2500 µs at 10 µs a degree stand in; see --calibration"
    );
    default_servos(&motion.layout)
}

fn summary(motion: &Motion) -> MotionSummary<'_> {
    MotionSummary {
        action: &motion.action,
        seed: motion.seed,
        seconds: motion.seconds,
        frames: motion.frame_count(),
        rate_hz: motion.rate_hz,
        provenance: &motion.provenance,
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    const BLOB: &str =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/creature-tiny-w8a16.kara");

    #[derive(Debug, clap::Parser)]
    struct Command {
        #[command(flatten)]
        bake: BakeArgs,
    }

    fn bake(out: &std::path::Path, line: &str) -> Result<()> {
        let words = format!("bake {BLOB} --action nod --seconds 2 {line} --out");
        let words = words.split_whitespace().map(String::from).chain([out.display().to_string()]);
        run(&Command::try_parse_from(words).unwrap().bake)
    }

    #[test]
    fn several_motions_do_not_fit_into_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("nod.csv");
        let error = bake(&out, "--count 2 --format csv").unwrap_err().to_string();
        assert!(error.contains("one file for 2 motions") && error.contains("c-header"), "{error}");
        assert!(!out.exists());
    }

    #[test]
    fn existing_file_is_left_alone_unless_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("nod_seed2.bin");
        std::fs::write(&path, "mine").unwrap();
        let error = bake(folder.path(), "--count 2 --format blender-bin").unwrap_err().to_string();
        assert!(error.contains("--force"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        bake(folder.path(), "--count 2 --format blender-bin --force").unwrap();
        assert_eq!(std::fs::read(&path).unwrap()[0], 0x3C);
    }

    #[test]
    fn rate_and_seconds_that_no_motion_has_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for line in ["--fps 0", "--fps NaN", "--seconds inf", "--seconds 0"] {
            let words = ["bake", BLOB, "--action", "nod", "--format", "csv", "--out", "x"];
            let line =
                if line.starts_with("--fps") { format!("{line} --seconds 2") } else { line.into() };
            let words = words.into_iter().chain(line.split_whitespace());
            let args = Command::try_parse_from(words).unwrap().bake;
            assert_eq!(run(&args).unwrap_err().exit_code(), 3, "{line}");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn other_rates_decode_the_same_motion_between_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let rows = |rate: &str| {
            let out = folder.path().join(format!("{rate}.csv"));
            bake(&out, &format!("--format csv --fps {rate}")).unwrap();
            let text = std::fs::read_to_string(&out).unwrap();
            let rows = text.lines().filter(|line| line.starts_with(char::is_numeric));
            rows.map(String::from).collect::<Vec<_>>()
        };
        let (all, half) = (rows("50"), rows("25"));
        assert_eq!((all.len(), half.len(), rows("30").len()), (100, 50, 60));
        assert!(half.iter().zip(all.iter().step_by(2)).all(|(a, b)| a == b));
    }

    #[test]
    fn pulses_are_those_of_the_calibration() {
        let folder = tempfile::tempdir().unwrap();
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/calibrations/chako.toml");
        let baked = |name: &str, flags: &str| {
            let out = folder.path().join(name);
            bake(&out, &format!("--format c-header {flags}")).unwrap();
            std::fs::read_to_string(&out).unwrap()
        };
        let (standing_in, calibrated) =
            (baked("a.h", ""), baked("b.h", &format!("--calibration {file}")));
        assert!(standing_in.contains("servo 0: body_yaw, 500 to 2500, neutral 1500"));
        assert!(!calibrated.contains("500 to 2500, neutral 1500"), "{calibrated}");
        // A blob that carries the calibration says the same without the file.
        let own = folder.path().join("own.kara");
        let blob = Calibration::read(file.as_ref()).unwrap();
        let blob = blob.put_into(BLOB.as_ref(), &read_blob(BLOB.as_ref()).unwrap()).unwrap();
        std::fs::write(&own, blob).unwrap();
        let out = folder.path().join("c.h");
        let words = ["bake", "--action", "nod", "--seconds", "2", "--format", "c-header"];
        let paths = [own.as_os_str(), "--out".as_ref(), out.as_os_str()];
        let words = words.iter().map(std::ffi::OsStr::new).chain(paths);
        run(&Command::try_parse_from(words).unwrap().bake).unwrap();
        let text = std::fs::read_to_string(&out).unwrap();
        let numbers = |text: &str| text.split_once("KARAKURI_PROGMEM = {").unwrap().1.to_owned();
        assert_eq!(numbers(&text), numbers(&calibrated));
    }
}
