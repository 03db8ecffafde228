//! `firmware-sim trace`: what will the servos be told?

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use karakuri::Model;

use super::{print, print_json, read_blob};
use crate::error::{Error, Result};
use crate::trace::{Options, Summary, TICK_HZ, US_PER_S_MAX, US_PER_S2_MAX, US_PER_UNIT, trace};

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = CALIBRATION)]
pub struct TraceArgs {
    /// Blob of `host-trainer quantize`
    model: PathBuf,
    /// What to do
    #[arg(long)]
    action: String,
    /// How long to do it
    #[arg(long)]
    seconds: f64,
    /// Seed of the motion
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Take the nearest trained length when the one asked for was never trained
    #[arg(long)]
    clamp: bool,
    /// Commands per second
    #[arg(long, value_name = "HZ", default_value_t = TICK_HZ,
          value_parser = clap::value_parser!(u32).range(10..=1000))]
    tick_hz: u32,
    /// Drive stand-ins even where the blob has servos of its own
    #[arg(long)]
    stand_in: bool,
    /// Stand-ins: pulse width per degree (of radians too), or per unit of any other channel; negative reverses
    #[arg(long, value_name = "US", default_value_t = US_PER_UNIT, allow_negative_numbers = true)]
    us_per_unit: f64,
    /// Stand-ins: speed limit, in microseconds of pulse width per second
    #[arg(long, value_name = "US", default_value_t = US_PER_S_MAX,
          value_parser = clap::value_parser!(u32).range(1..))]
    speed_us_per_s: u32,
    /// Stand-ins: acceleration limit, in microseconds of pulse width per second squared
    #[arg(long, value_name = "US", default_value_t = US_PER_S2_MAX,
          value_parser = clap::value_parser!(u32).range(1..))]
    acceleration_us_per_s2: u32,
    /// File for the trace, instead of standard output
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON on standard output; the trace then goes to --out only
    #[arg(long)]
    json: bool,
}

const CALIBRATION: &str = "Servos are those that the blob is calibrated for; without any, \
    every scalar channel drives a stand-in of 500 to 2500 us about 1500 us. \
    Limits of range, speed and acceleration are core's; nothing here proves safety.\n\nExample:\n  \
    firmware-sim trace creature.kara --action nod --seconds 2.4 --seed 7 --out nod.csv";

impl TraceArgs {
    fn options(&self) -> Options {
        Options {
            action: self.action.clone(),
            seconds: self.seconds,
            seed: self.seed,
            clamp: self.clamp,
            tick_hz: self.tick_hz,
            stand_in: self.stand_in,
            us_per_unit: self.us_per_unit,
            us_per_s_max: self.speed_us_per_s,
            us_per_s2_max: self.acceleration_us_per_s2,
        }
    }
}

/// Writes the trace, and its summary to standard error.
///
/// # Errors
/// See [`trace()`]; an output file that exists already, unless `--force`.
pub fn run(args: &TraceArgs) -> Result<()> {
    if let Some(out) = &args.out {
        check_new(out, args.force)?;
    }
    let blob = read_blob(&args.model)?;
    let in_file = |error: Error| error.in_file(&args.model);
    let model = Model::from_bytes(&blob).map_err(|error| in_file(error.into()))?;
    let trace = trace(&model, &args.options()).map_err(in_file)?;
    match &args.out {
        Some(out) => write_file(out, &trace.csv()?, args.force)?,
        None if args.json => {}
        None => print(trace.csv()?)?,
    }
    let summary = trace.summary();
    if args.json {
        return print_json(&summary);
    }
    eprint!("{}", table(&summary));
    Ok(())
}

fn table(summary: &Summary) -> String {
    let options = &summary.options;
    let names = summary.servos.iter().map(|servo| servo.name.chars().count());
    let width = names.chain(["servo".len()]).max().unwrap_or_default();
    let mut text = format!(
        "{}, {} s, seed {}: {} commands at {} Hz, {}\n\n\
         {:<width$}  {:>6}  {:>6}  {:>10}  {:>13}  {:>13}  {:>20}\n",
        options.action,
        options.seconds,
        options.seed,
        summary.tick_count,
        options.tick_hz,
        options.servos(),
        "servo",
        "min us",
        "max us",
        "max us/s",
        "range-limited",
        "speed-limited",
        "acceleration-limited",
    );
    for servo in &summary.servos {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:<width$}  {:>6}  {:>6}  {:>10.0}  {:>11.1} %  {:>11.1} %  {:>18.1} %",
            servo.name,
            servo.pulse_us_min,
            servo.pulse_us_max,
            servo.us_per_s_max,
            100.0 * servo.range_limited_share,
            100.0 * servo.speed_limited_share,
            100.0 * servo.acceleration_limited_share,
        );
    }
    text
}

pub(super) fn check_new(path: &Path, force: bool) -> Result<()> {
    if !force && path.exists() {
        let remedy = "choose another --out, or replace it with --force";
        return Err(Error::bad_input(path, "output file", "there already", "a new file", remedy));
    }
    Ok(())
}

/// Writes the whole file or none of it: beside its place first, then there.
pub(super) fn write_file(path: &Path, bytes: &[u8], force: bool) -> Result<()> {
    check_new(path, force)?;
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".partial");
    let partial = path.with_file_name(name);
    let write = || {
        let mut file = File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().map_err(|error| {
        // Best effort: the error that brought us here is the one to report.
        let _ = fs::remove_file(&partial);
        Error::io("write", path)(error)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use clap::Parser;
    use karakuri::NumberFormat;

    #[derive(Parser)]
    struct CommandLine {
        #[command(flatten)]
        trace: TraceArgs,
    }

    /// The arguments after the model, which is the fixture in `folder`.
    fn args(folder: &Path, rest: &[&str]) -> TraceArgs {
        let model = folder.join("fixture.kara");
        fs::write(&model, Fixture::new(1).blob(NumberFormat::W8A16)).unwrap();
        let motion = ["--action", "write", "--seconds", "1.2", "--seed", "7"];
        let words = ["trace", model.to_str().unwrap()].into_iter().chain(motion);
        CommandLine::try_parse_from(words.chain(rest.iter().copied())).unwrap().trace
    }

    #[test]
    fn missing_model_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), &[]);
        args.model = "no/such.kara".into();
        let error = run(&args).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        assert!(error.to_string().contains("no/such.kara"), "{error}");
    }

    #[test]
    fn file_that_is_no_blob_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let args = args(folder.path(), &[]);
        fs::write(&args.model, "KRKR").unwrap();
        let error = run(&args).unwrap_err();
        assert_eq!(error.exit_code(), 5);
        assert!(error.to_string().contains("fixture.kara"), "{error}");
    }

    #[test]
    fn existing_file_is_left_alone_unless_told() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("trace.csv");
        fs::write(&out, "mine").unwrap();
        let words = ["--out", out.to_str().unwrap()];
        let error = run(&args(folder.path(), &words)).unwrap_err();
        assert!(error.to_string().contains("--force"), "{error}");
        assert_eq!(fs::read_to_string(&out).unwrap(), "mine");
        run(&args(folder.path(), &[&words[..], &["--force"]].concat())).unwrap();
        assert!(fs::read_to_string(&out).unwrap().contains("time_s,neck_us"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn missing_folder_is_an_error_that_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("none/trace.csv");
        let error = run(&args(folder.path(), &["--out", out.to_str().unwrap()])).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        assert!(error.to_string().contains("none/trace.csv"), "{error}");
    }

    /// A gain that leaves the range and a limit that is felt, so that every column has something to
    /// say.
    #[test]
    fn summary_reads_as_it_always_did() {
        let folder = tempfile::tempdir().unwrap();
        let words = ["--us-per-unit", "-9000", "--speed-us-per-s", "6000"];
        let args = args(folder.path(), &words);
        let blob = read_blob(&args.model).unwrap();
        let model = Model::from_bytes(&blob).unwrap();
        let text = table(&trace(&model, &args.options()).unwrap().summary());
        assert_eq!(text, SUMMARY, "{text}");
    }

    const SUMMARY: &str = "\
write, 1.2 s, seed 7: 60 commands at 50 Hz, -9000 us per unit, 6000 us/s, 60000 us/s2

servo  min us  max us    max us/s  range-limited  speed-limited  acceleration-limited
neck      500    2500        6000         39.0 %         16.9 %                47.5 %
";
}
