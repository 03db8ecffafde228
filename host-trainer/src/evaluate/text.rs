//! An evaluation for people: our row between the papers', and what has to be said about them.
//!
//! In:  [`Evaluation`].
//! Out: text, printed by the command.

use std::fmt;

use super::estimate::Estimate;
use super::nearest_clip::Quantiles;
use super::papers::PaperRow;
use super::report::{Evaluation, Figures};
use crate::table::Table;

impl fmt::Display for Evaluation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}\n", self.headline())?;
        writeln!(out, "{}", self.rows())?;
        writeln!(out, "{}", self.accuracies())?;
        if self.nearest_training_clip_mm.generated.is_some() {
            writeln!(out, "{}", self.distances())?;
        }
        if let Some(table) = self.physical() {
            writeln!(out, "{table}")?;
        }
        for row in &self.papers {
            writeln!(out, "{}: {}", row.name, row.note)?;
        }
        self.remarks.iter().try_for_each(|remark| writeln!(out, "{remark}"))
    }
}

impl Evaluation {
    /// The name of our row.
    pub fn row_name(&self) -> String {
        format!("→ {} ({})", self.source.name, self.source.format)
    }

    fn headline(&self) -> String {
        format!(
            "{} repetitions of fresh draws, seed {}, {} training and {} held-out clips, {} frames",
            self.protocol.repetitions,
            self.protocol.seed,
            self.data.training_clip_count,
            self.data.held_out_clip_count,
            self.protocol.frames,
        )
    }

    /// Worst FID first, ours between the papers'.
    fn rows(&self) -> Table {
        let mut rows = vec![
            (self.generated.fid.mean, row(self.row_name(), &self.generated)),
            (self.real.fid.mean, row("→ real, cropped again".to_owned(), &self.real)),
        ];
        rows.extend(
            self.papers.iter().map(|paper| (paper.fid.unwrap_or(f64::INFINITY), paper_row(paper))),
        );
        rows.sort_by(|(one, _), (other, _)| other.total_cmp(one));
        let mut table = Table::new([
            "",
            "FID",
            "held-out",
            "accuracy",
            "diversity",
            "multimodality",
            "MMS",
            "APD",
            "n-APD %",
        ]);
        rows.into_iter().for_each(|(_, row)| table.push(row));
        table
    }

    fn accuracies(&self) -> Table {
        let mut table = Table::new(["action", "motions", "accuracy", "real"]);
        let pairs = self.generated.accuracy_by_action.iter().zip(&self.real.accuracy_by_action);
        for (one, real) in pairs {
            table.push([
                one.action.clone(),
                one.motion_count.to_string(),
                cell(one.accuracy, 3),
                cell(real.accuracy, 3),
            ]);
        }
        table
    }

    /// How bodies move, beside the real ones; the distance is that of the whole distribution.
    fn physical(&self) -> Option<Table> {
        let (generated, real) = (self.generated.physical.as_ref()?, self.real.physical.as_ref()?);
        let mut table =
            Table::new(["", "mean", "real", "median", "real", "95 %", "real", "distance", "real"]);
        for ((name, decimals, one), (_, _, real)) in generated.rows().into_iter().zip(real.rows()) {
            let (Some(one), Some(real)) = (one, real) else { continue };
            let cell = |estimate: Estimate| format!("{:.decimals$}", estimate.mean);
            table.push([
                name.to_owned(),
                cell(one.mean),
                cell(real.mean),
                cell(one.median),
                cell(real.median),
                cell(one.percentile_95),
                cell(real.percentile_95),
                cell(one.distance_to_real),
                cell(real.distance_to_real),
            ]);
        }
        Some(table)
    }

    fn distances(&self) -> Table {
        let mut table = Table::new([
            "mm to the nearest training clip",
            "least",
            "1 %",
            "5 %",
            "25 %",
            "median",
            "75 %",
            "95 %",
            "most",
        ]);
        let nearest = &self.nearest_training_clip_mm;
        for (name, quantiles) in [
            ("generated", nearest.generated),
            ("held-out clips", nearest.held_out),
            ("training clips, to another", nearest.training),
        ] {
            if let Some(quantiles) = quantiles {
                table.push(quantile_row(name, &quantiles));
            }
        }
        table
    }
}

fn cell(estimate: Estimate, decimals: usize) -> String {
    // Rounding of 0 below 0.
    let mean = if estimate.mean.abs() < 1e-9 { 0.0 } else { estimate.mean };
    format!("{mean:.decimals$} ±{:.decimals$}", estimate.ci95)
}

fn row(name: String, figures: &Figures) -> [String; 9] {
    [
        name,
        cell(figures.fid, 3),
        figures.fid_held_out.map_or("–".to_owned(), |fid| cell(fid, 3)),
        cell(figures.accuracy, 3),
        cell(figures.diversity, 3),
        cell(figures.multimodality, 3),
        cell(figures.mms, 3),
        cell(figures.apd, 2),
        cell(figures.apd_normalized, 1),
    ]
}

fn paper_row(paper: &PaperRow) -> [String; 9] {
    let cell = |figure: Option<f64>, decimals: usize| {
        figure.map_or("–".to_owned(), |figure| format!("{figure:.decimals$}"))
    };
    [
        paper.name.to_owned(),
        cell(paper.fid, 3),
        cell(None, 0),
        cell(paper.accuracy, 3),
        cell(paper.diversity, 3),
        cell(paper.multimodality, 3),
        cell(paper.mms, 3),
        cell(None, 0),
        cell(paper.apd_normalized, 1),
    ]
}

fn quantile_row(name: &str, quantiles: &Quantiles) -> [String; 9] {
    let Quantiles { min, p01, p05, p25, median, p75, p95, max, .. } = quantiles;
    let [a, b, c, d, e, f, g, h] =
        [min, p01, p05, p25, median, p75, p95, max].map(|value| format!("{value:.0}"));
    [name.to_owned(), a, b, c, d, e, f, g, h]
}
