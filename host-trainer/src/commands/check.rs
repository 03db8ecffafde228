//! `host-trainer check CLIPS --calibration FILE`: can this robot do these clips?

use std::path::PathBuf;

use serde::Serialize;

use crate::calibration::Calibration;
use crate::calibration::check::{ClipCheck, check};
use crate::commands::inspect_clips::ImportArgs;
use crate::error::{Error, Result};
use crate::import;
use crate::stdout::{print, print_json};
use crate::table::Table;

/// Arguments of `check`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Exit code 1 where a clip exceeds a limit.\n\nExample:\n  \
    host-trainer check clips --calibration robot.toml")]
pub struct CheckArgs {
    /// Clip file or folder of clip files
    pub path: PathBuf,
    /// Calibration of the robot's servos
    #[arg(long, value_name = "FILE.toml")]
    pub calibration: PathBuf,
    /// Print JSON instead of tables
    #[arg(long)]
    pub json: bool,
    /// What the files do not say themselves
    #[command(flatten)]
    pub import: ImportArgs,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    clip_count: usize,
    exceeding_count: usize,
    /// Slowest of the highest rates, where every clip has one.
    rate_max: Option<f64>,
    clips: Vec<ClipCheck>,
}

/// Prints on stdout which clips exceed which limit.
///
/// # Errors
/// [`Error::LimitsExceeded`] if any does; what import and calibration have to say about a file.
pub fn run(args: &CheckArgs) -> Result<()> {
    let calibration = Calibration::read(&args.calibration)?;
    // Labels do not matter here.
    let mut options = args.import.options()?;
    options.tolerate_missing_labels = true;
    let clip_set = import::read(&args.path, &options)?;
    clip_set.remarks.iter().for_each(|remark| eprintln!("{remark}"));
    let clips = check(&clip_set, &calibration.servos(&clip_set.layout)?);
    let exceeding_count = clips.iter().filter(|clip| !clip.excesses.is_empty()).count();
    let rates = clips.iter().map(|clip| clip.rate_max).collect::<Option<Vec<f64>>>();
    let rate_max = rates.and_then(|rates| rates.into_iter().reduce(f64::min));
    let report = Report { clip_count: clips.len(), exceeding_count, rate_max, clips };
    if args.json {
        print_json(&report)?
    } else {
        print(text(&report))?
    }
    match exceeding_count {
        0 => Ok(()),
        _ => Err(Error::LimitsExceeded { exceeding_count, clip_count: report.clip_count }),
    }
}

fn text(report: &Report) -> String {
    let mut table = Table::new(["clip", "servo", "limit", "at s", "asked", "allowed", "", "rate"]);
    for clip in &report.clips {
        let rate = clip.rate_max.map_or_else(|| "–".into(), |rate| format!("{rate:.2}"));
        for excess in &clip.excesses {
            let (limit, unit) = excess.limit.names();
            table.push([
                clip.clip.clone(),
                excess.servo.clone(),
                limit.into(),
                format!("{:.2}", excess.at_s),
                format!("{:.0}", excess.asked),
                format!("{:.0}", excess.allowed),
                unit.into(),
                rate.clone(),
            ]);
        }
    }
    let Report { clip_count, exceeding_count, rate_max, .. } = report;
    let rate = rate_max.map_or(String::new(), |rate| {
        format!("; all of them stay within speed and acceleration at {rate:.2} times their rate")
    });
    let summary = format!("{exceeding_count} of {clip_count} clips exceed a limit{rate}\n");
    if *exceeding_count == 0 { summary } else { format!("{table}\n{summary}") }
}
