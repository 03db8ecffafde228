//! `report.md`: our figures beside the papers', and what differs and why.
//!
//! In:  [`Reproduction`] and the experiments it follows.
//! Out: Markdown and SVG pictures in the folder of the reproduction.
//!
//! Why here: everything in the report stands in the records of the stages or in the experiments' file; nothing is
//! written by hand, so that it can be made again.

mod chart;
mod tables;

use std::fmt::Write;
use std::path::Path;

use crate::atomic_file::{self, Overwrite};
use crate::error::Result;
use crate::reproduce::Reproduction;
use crate::reproduce::experiments::Experiments;
use crate::reproduce::record::{JobRecord, Outcome, RowRecord, SourceRecord};

/// The report's file.
pub const FILE_NAME: &str = "report.md";

/// What a reader of the table of trainings has to know.
const SHARED_TRAININGS: &str = "Rows that differ in their mixture alone share a training. Wall time is that of this \
                                machine with whatever else it did.";

/// Writes report and pictures.
///
/// # Errors
/// `Io` when a file cannot be written.
pub fn write(experiments: &Experiments, reproduction: &Reproduction, out: &Path) -> Result<()> {
    let charts = chart::all(experiments, reproduction);
    for chart in &charts {
        atomic_file::write(&out.join(chart.file), chart.svg.as_bytes(), Overwrite::Replace)?;
    }
    let text = markdown(experiments, reproduction, &charts);
    atomic_file::write(&out.join(FILE_NAME), text.as_bytes(), Overwrite::Replace)
}

fn markdown(
    experiments: &Experiments,
    reproduction: &Reproduction,
    charts: &[chart::Chart],
) -> String {
    let mut text =
        format!("# {}\n\nLength of training: {}.", experiments.title, reproduction.budget);
    if let Some(repetitions) = reproduction.repetitions {
        let _ =
            write!(text, " Repetitions of a measurement: {repetitions}, each with fresh draws.");
    }
    let mut section = |heading: &str, body: &str| {
        if !body.is_empty() {
            let _ = write!(text, "\n\n## {heading}\n\n{}", body.trim_end());
        }
    };
    section("Generated motions", &tables::generated(experiments, reproduction));
    section("Clips given back, and what a pose costs", &tables::costs(reproduction));
    section("Bytes by part", &tables::parts(reproduction));
    let trainings = tables::trainings(reproduction);
    section("Training", &format!("{SHARED_TRAININGS}\n\n{trainings}"));
    let pictures = charts.iter().map(|chart| format!("![{}]({})", chart.title, chart.file));
    section("Pictures", &pictures.collect::<Vec<_>>().join("\n\n"));
    section("Rows", &rows(reproduction));
    section("Rows that failed", &failures(reproduction));
    section("What differs from the papers, and why", &differences(experiments, reproduction));
    text.push('\n');
    text
}

fn rows(reproduction: &Reproduction) -> String {
    let lines = reproduction.rows.iter().map(|row| format!("* `{}`: {}\n", row.name, row.about));
    lines.collect()
}

fn failures(reproduction: &Reproduction) -> String {
    let jobs = reproduction.rows.iter().flat_map(outcomes);
    let lines = jobs.filter_map(|(name, outcome)| match outcome {
        Outcome::Done(_) => None,
        Outcome::Failed(error) => Some(format!("* `{name}`: {error}\n")),
    });
    lines.collect()
}

fn differences(experiments: &Experiments, reproduction: &Reproduction) -> String {
    let budgets = jobs(reproduction)
        .map(|(_, job)| job.training.steps as f64 / job.training.preset_steps.max(1) as f64);
    let (least, most) = budgets
        .fold((f64::INFINITY, 0.0_f64), |(least, most), share| (least.min(share), most.max(share)));
    let budget = (least < 0.995).then(|| {
        let [least, most] = [least, most].map(|share| format!("{:.1}", 100.0 * share));
        let range = if least == most { least } else { format!("{least} to {most}") };
        format!("Trainings are shortened to {range} % of the steps that their presets ask for.")
    });
    let sentences = budget.iter().chain(&experiments.differences);
    sentences.map(|sentence| format!("* {sentence}\n")).collect()
}

/// Both jobs of a row, by name.
fn outcomes(row: &RowRecord) -> impl Iterator<Item = (String, &Outcome)> {
    let twin = row.held_out.as_ref().map(|twin| (format!("{}-held-out", row.name), twin));
    std::iter::once((row.name.clone(), &row.result)).chain(twin)
}

/// Everything that was done, by name.
fn jobs(reproduction: &Reproduction) -> impl Iterator<Item = (String, &JobRecord)> {
    let all = reproduction.rows.iter().flat_map(outcomes);
    all.filter_map(|(name, outcome)| Some((name, outcome.done()?)))
}

/// Every source of poses of the rows trained on all clips, with the same source of the twin.
fn sources(
    reproduction: &Reproduction,
) -> impl Iterator<Item = (&RowRecord, &SourceRecord, Option<&SourceRecord>)> {
    reproduction.rows.iter().flat_map(|row| {
        let twin = row.held_out.as_ref().and_then(Outcome::done);
        let done = row.result.done().into_iter().flat_map(|job| &job.sources);
        done.map(move |source| {
            let same = |other: &&SourceRecord| other.source == source.source;
            (row, source, twin.and_then(|twin| twin.sources.iter().find(same)))
        })
    })
}
