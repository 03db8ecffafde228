//! The tables of the report, in Markdown.
//!
//! In:  the records of the rows; what the papers print.
//! Out: text, empty where there is nothing to tell.

use std::fmt::Write;

use super::{jobs, sources};
use crate::reproduce::Reproduction;
use crate::reproduce::experiments::{Experiments, PaperFigures};
use crate::reproduce::record::{Figure, RowRecord, SourceRecord};
use crate::table::thousands;

/// A Markdown table; empty without rows.
fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut text = format!("| {} |\n|{}\n", header.join(" | "), "---|".repeat(header.len()));
    let empty = text.len();
    for row in rows {
        let _ = writeln!(text, "| {} |", row.join(" | "));
    }
    if text.len() == empty { String::new() } else { text }
}

/// Figures of generated motions: the papers', then ours beside what the paper prints for the same experiment.
pub fn generated(experiments: &Experiments, reproduction: &Reproduction) -> String {
    let is_measured = |source: &SourceRecord| source.evaluation.is_some();
    if !sources(reproduction).any(|(_, source, _)| is_measured(source)) {
        return String::new();
    }
    let real = sources(reproduction).find_map(|(_, source, _)| source.evaluation.as_ref());
    let real = real.and_then(|evaluation| evaluation.real.as_ref()).map(|real| {
        let figures = [&real.fid, &real.accuracy, &real.diversity, &real.multimodality];
        let mut cells = vec!["real motions, other crops".into(), String::new()];
        cells.extend(figures.map(|figure| with_interval(Some(figure), 3)));
        cells.extend([with_interval(real.mms.as_ref(), 3), String::new(), String::new()]);
        cells
    });
    let papers = experiments.papers.iter().map(paper_cells);
    let ours = sources(reproduction)
        .filter(|(_, source, _)| is_measured(source))
        .map(|(row, source, twin)| our_cells(row, source, twin));
    let header = [
        "row",
        "paper: FID, accuracy",
        "FID",
        "accuracy",
        "diversity",
        "multimodality",
        "MMS",
        "n-APD %",
        "FID to held-out clips",
    ];
    table(&header, papers.chain(real).chain(ours))
}

fn paper_cells(paper: &PaperFigures) -> Vec<String> {
    let figure = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "–".into(), |value| format!("{value:.digits$}"))
    };
    vec![
        paper.name.clone(),
        "its own".into(),
        figure(paper.fid, 3),
        figure(paper.accuracy, 3),
        figure(paper.diversity, 2),
        figure(paper.multimodality, 2),
        figure(paper.mms, 3),
        figure(paper.apd_normalized, 1),
        "–".into(),
    ]
}

fn our_cells(row: &RowRecord, source: &SourceRecord, twin: Option<&SourceRecord>) -> Vec<String> {
    let beside = row.beside.as_ref().map_or_else(String::new, |paper| {
        let figure = |value: Option<f64>| value.map_or("–".into(), |value| format!("{value:.3}"));
        format!("{}, {}", figure(paper.fid), figure(paper.accuracy))
    });
    let evaluation = source.evaluation.as_ref();
    let held_out = twin.and_then(|twin| twin.evaluation.as_ref()?.fid_held_out.as_ref());
    let mut cells = vec![format!("**{}**, {}", row.name, source.source), beside];
    let figures = [
        evaluation.map(|found| &found.fid),
        evaluation.map(|found| &found.accuracy),
        evaluation.map(|found| &found.diversity),
        evaluation.map(|found| &found.multimodality),
        evaluation.and_then(|found| found.mms.as_ref()),
    ];
    cells.extend(figures.map(|figure| with_interval(figure, 3)));
    cells.push(with_interval(evaluation.and_then(|found| found.apd_normalized.as_ref()), 1));
    cells.push(with_interval(held_out, 3));
    cells
}

fn with_interval(figure: Option<&Figure>, digits: usize) -> String {
    figure.map_or_else(
        || "–".into(),
        |figure| match figure.ci95 > 0.0 {
            true => format!("{:.digits$} ± {:.digits$}", figure.mean, figure.ci95),
            false => format!("{:.digits$}", figure.mean),
        },
    )
}

/// How well training clips come back, and bytes and work of every source of poses.
pub fn costs(reproduction: &Reproduction) -> String {
    let header = [
        "row",
        "joints mm",
        "root mm",
        "joints from the root mm",
        "RMS of channels",
        "multiply-accumulates a pose",
        "blob bytes",
        "sampler",
    ];
    let rows = sources(reproduction).map(|(row, source, _)| {
        let found = &source.reconstruction;
        let mm = |value: Option<f64>| value.map_or_else(|| "–".into(), |mm| format!("{mm:.1}"));
        let kinds = found.kinds.iter().map(|(of, rms, unit)| format!("{of} {rms:.3} {unit}"));
        let blob = source.blob.as_ref();
        vec![
            format!("**{}**, {}", row.name, source.source),
            mm(found.joint_mm),
            mm(found.root_mm),
            mm(found.local_mm),
            kinds.collect::<Vec<_>>().join(", "),
            thousands(found.macs_per_pose),
            blob.map_or_else(|| "–".into(), |blob| thousands(blob.bytes as u64)),
            blob.map_or_else(|| "mixture".into(), |blob| blob.sampler.clone()),
        ]
    });
    table(&header, rows)
}

/// Bytes of every blob by part.
pub fn parts(reproduction: &Reproduction) -> String {
    let rows = sources(reproduction).filter_map(|(row, source, _)| {
        let blob = source.blob.as_ref()?;
        let parts = blob.parts.iter().map(|(part, bytes)| format!("{part} {}", thousands(*bytes)));
        Some(vec![
            format!("**{}**, {}", row.name, source.source),
            parts.collect::<Vec<_>>().join(", "),
            thousands(blob.bytes as u64),
        ])
    });
    table(&["blob", "parts", "all"], rows)
}

/// How every row was trained.
pub fn trainings(reproduction: &Reproduction) -> String {
    let header = [
        "row",
        "clips",
        "held out",
        "steps",
        "of its preset's",
        "passes",
        "wall time",
        "parameters",
        "configuration",
    ];
    let rows = jobs(reproduction).map(|(name, job)| {
        let training = &job.training;
        let share = 100.0 * training.steps as f64 / training.preset_steps.max(1) as f64;
        vec![
            format!("**{name}**"),
            thousands(training.clip_count as u64),
            thousands(training.held_out_count as u64),
            thousands(training.steps),
            format!("{share:.1} %"),
            format!("{:.0}", training.passes),
            wall_time(training.seconds),
            thousands(training.parameter_count as u64),
            format!("`{}`, seed {}", &training.config_hash[..12], training.seed),
        ]
    });
    table(&header, rows)
}

fn wall_time(seconds: f64) -> String {
    if seconds < 120.0 { format!("{seconds:.0} s") } else { format!("{:.0} min", seconds / 60.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_without_rows_is_no_text() {
        assert_eq!(table(&["a", "b"], []), "");
        assert_eq!(table(&["a"], [vec!["1".to_owned()]]), "| a |\n|---|\n| 1 |\n");
    }

    #[test]
    fn figure_without_an_interval_claims_none() {
        let figure = |ci95| with_interval(Some(&Figure { mean: 0.25, ci95 }), 3);
        assert_eq!([figure(0.0), figure(0.0125)], ["0.250", "0.250 ± 0.013"]);
        assert_eq!(with_interval(None, 3), "–");
    }
}
