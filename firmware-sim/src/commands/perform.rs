//! `firmware-sim perform`: an hour with a character that has no body yet.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use karakuri::Model;
use serde::Serialize;

use super::{print, print_json, progress_bar, read_blob};
use crate::cue::Stint;
use crate::error::{Error, Result};
use crate::performance::{
    COUNTED_TICKS_MAX, ChipPerformance, InstructionsPerTick, NearestRepeat, Performance, Summary,
    clip_courses, draw, perform_on_chip, perform_on_host, servo_names, summarize,
};
use crate::script;
use crate::show::show;
use crate::target::Target;

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = script::HELP)]
pub struct PerformArgs {
    /// Calibrated blob of `host-trainer quantize`
    model: PathBuf,
    /// File of what to tell the character and when; without one a working day is made from the seed
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Length of the performance
    #[arg(long, default_value_t = 60.0, value_parser = minutes)]
    minutes: f64,
    /// Seed of idling, and of the day that is made without a script
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Commands per second
    #[arg(long, value_name = "HZ", default_value_t = 50, value_parser = clap::value_parser!(u32).range(20..=200))]
    tick_hz: u32,
    /// Frames of the model between two decoded poses
    #[arg(long, value_name = "FRAMES", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    frames_per_key: u8,
    /// Also perform on this emulated chip and compare every command; may be given several times
    #[arg(long, value_enum)]
    target: Vec<Target>,
    /// Also count the instructions of each tick on these chips; a minute at most
    #[arg(long, requires = "target")]
    count: bool,
    /// Also write trace.csv, summary.json and performance.svg into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

fn minutes(text: &str) -> std::result::Result<f64, String> {
    let minutes: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if (0.01..=1440.0).contains(&minutes) {
        Ok(minutes)
    } else {
        Err("expected 0.01 to 1440".into())
    }
}

/// Everything that is printed and written.
#[derive(Clone, Debug, Serialize)]
struct Report {
    /// The blob's name, and the hash of the configuration that made it.
    model: String,
    config_hash: String,
    seed: u64,
    tick_hz: u32,
    frames_per_key: u8,
    script: Option<PathBuf>,
    #[serde(flatten)]
    summary: Summary,
    /// The same on emulated chips.
    chips: Vec<ChipPerformance>,
}

/// Performs; false when a command broke a limit or a chip differs.
///
/// # Errors
/// A blob without servos, a script that cannot be read, files that exist already; see [`perform_on_chip`].
pub fn run(args: &PerformArgs) -> Result<bool> {
    if let Some(out) = &args.out {
        check_new(out, args.force)?;
    }
    let blob = read_blob(&args.model)?;
    let in_file = |error: Error| error.in_file(&args.model);
    let model = Model::from_bytes(&blob).map_err(|error| in_file(error.into()))?;
    let cues = match &args.script {
        None => show(&model, args.minutes, args.tick_hz, args.seed),
        Some(path) => {
            let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
            script::read(&text, &model, args.tick_hz)?
        }
    };
    let stint = Stint {
        tick_count: (args.minutes * 60.0 * f64::from(args.tick_hz)).round() as u32,
        tick_us: 1_000_000 / args.tick_hz,
        frames_per_key: args.frames_per_key,
        seed: args.seed,
    };
    check_counted(args, stint)?;
    let progress = progress_bar();
    progress.set_message("performing");
    let outcome = (|| -> Result<_> {
        let performance = perform_on_host(&model, stint, &cues, &progress).map_err(in_file)?;
        let chips = args.target.iter().map(|target| {
            perform_on_chip(&blob, &cues, &performance, *target, args.count, &progress)
        });
        Ok((chips.collect::<Result<Vec<_>>>()?, performance))
    })();
    progress.finish_and_clear();
    let (chips, performance) = outcome?;
    let clips = clip_courses(&model, f64::from(args.tick_hz)).map_err(in_file)?;
    let hash = model.provenance().config_hash;
    let report = Report {
        model: model.manifest().name.to_owned(),
        config_hash: hash.iter().map(|byte| format!("{byte:02x}")).collect(),
        seed: args.seed,
        tick_hz: args.tick_hz,
        frames_per_key: args.frames_per_key,
        script: args.script.clone(),
        summary: summarize(&performance, &clips),
        chips,
    };
    if let Some(out) = &args.out {
        write_all(out, &report, &performance, &servo_names(&model), args.force)?;
    }
    if args.json {
        print_json(&report)?
    } else {
        print(table(&report))?
    }
    let equal = report.chips.iter().all(|chip| chip.differences.bits_differing == 0);
    Ok(report.summary.violations == 0 && equal)
}

fn check_counted(args: &PerformArgs, stint: Stint) -> Result<()> {
    if args.count && stint.tick_count > COUNTED_TICKS_MAX {
        let (value, expected) = (stint.tick_count, format!("{COUNTED_TICKS_MAX} to be counted"));
        let remedy = "shorten the performance, for example `--minutes 0.4`";
        return Err(Error::bad_input("--count", "number of ticks", value, expected, remedy));
    }
    Ok(())
}

const FILES: [&str; 3] = ["trace.csv", "summary.json", "performance.svg"];

fn check_new(out: &Path, force: bool) -> Result<()> {
    for path in FILES.map(|name| out.join(name)) {
        super::trace::check_new(&path, force)?;
    }
    Ok(())
}

fn write_all(
    out: &Path,
    report: &Report,
    performance: &Performance,
    names: &[String],
    force: bool,
) -> Result<()> {
    fs::create_dir_all(out).map_err(Error::io("create", out))?;
    let encode = |error: serde_json::Error| Error::io("encode", out)(error.into());
    let picture = draw(performance, names);
    let picture = picture.map_err(|error| Error::io("draw", out)(std::io::Error::other(error)))?;
    let contents = [
        csv(report, performance, names).into_bytes(),
        serde_json::to_vec_pretty(report).map_err(encode)?,
        picture.into_bytes(),
    ];
    for (name, bytes) in FILES.iter().zip(contents) {
        super::trace::write_file(&out.join(name), &bytes, force)?;
    }
    Ok(())
}

/// One row a tick: time, a pulse a servo (empty where released), where its horn is, which servos are held back.
fn csv(report: &Report, performance: &Performance, names: &[String]) -> String {
    let Report { model, config_hash, seed, .. } = report;
    let mut text = format!("# {model}, config {config_hash}, seed {seed}\ntime_s");
    for name in names {
        let _ = write!(text, ",{name}_us");
    }
    text += ",limited_servos\n";
    for tick in &performance.ticks {
        let _ = write!(text, "{:.4}", tick.time_s);
        for pulse_us in &tick.pulses_us {
            let _ = match pulse_us {
                Some(us) => write!(text, ",{us}"),
                None => write!(text, ","),
            };
        }
        let _ = writeln!(text, ",{}", tick.limited);
    }
    text
}

fn table(report: &Report) -> String {
    let summary = &report.summary;
    let mut lines = vec![
        (
            "performed",
            format!(
                "{:.1} minutes, {} ticks, {} commands",
                summary.minutes, summary.ticks, summary.commands
            ),
        ),
        ("violations", summary.violations.to_string()),
        (
            "interventions",
            format!(
                "{:.1} a minute; some servo held back in {:.1} % of the ticks",
                summary.interventions_per_minute,
                100.0 * summary.limited_fraction
            ),
        ),
        (
            "active",
            format!(
                "{:.1} % of the time, in a motion {:.1} %",
                100.0 * summary.active_fraction,
                100.0 * summary.in_motion_fraction
            ),
        ),
        ("horn jerk", format!("{:.0} us/s^3 RMS while active", summary.horn_jerk_rms)),
    ];
    lines.push(("nearest repeat", describe(summary.nearest_repeat.as_ref())));
    lines.push(("of the clips", describe(summary.nearest_among_clips.as_ref())));
    if let Some(first) = &summary.first_violation {
        lines.push((
            "first violation",
            format!(
                "tick {}, servo {}: {} {:.0}, at most {:.0}",
                first.tick, first.servo, first.limit, first.value, first.max
            ),
        ));
    }
    for chip in &report.chips {
        lines.push((
            chip.target,
            format!(
                "{} commands compared, {} bits differing; {} bytes of stack",
                chip.commands, chip.differences.bits_differing, chip.ram.stack_bytes_max
            ),
        ));
        if let Some(counts) = &chip.instructions_per_tick {
            lines.push(("", describe_counts(counts)));
        }
    }
    lines.into_iter().map(|(name, value)| format!("{name:<16}{value}\n")).collect()
}

fn describe_counts(counts: &InstructionsPerTick) -> String {
    let parts = [
        ("at rest", counts.resting),
        ("in a motion without a pose", counts.without_pose),
        ("at most", counts.without_pose_max),
        ("with one", counts.with_pose),
        ("beginning a motion at most", counts.start_max),
        ("mean", counts.mean),
    ];
    let known = parts.into_iter().filter_map(|(name, count)| Some(format!("{name} {}", count?)));
    let known: Vec<String> = known.collect();
    format!("instructions a tick: {}", known.join(", "))
}

fn describe(repeat: Option<&NearestRepeat>) -> String {
    let Some(repeat) = repeat else {
        return "none: hardly anything moved".to_owned();
    };
    let NearestRepeat { distance, first_s, second_s, median, window_count } = repeat;
    format!(
        "{distance:.2} units RMS, windows at {first_s:.1} s and {second_s:.1} s; \
         median of {window_count} windows {median:.2}"
    )
}
