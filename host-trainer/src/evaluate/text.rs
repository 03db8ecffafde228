//! An evaluation for people: our row, the real row, and what has to be said about them.
//!
//! In:  [`Evaluation`].
//! Out: text, printed by the command.

use std::fmt;

use super::estimate::Estimate;
use super::report::{Evaluation, Figures};
use crate::table::Table;

impl fmt::Display for Evaluation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new([
            "",
            "FID",
            "held-out",
            "accuracy",
            "diversity",
            "multimod.",
            "MMS",
            "APD m",
            "n-APD %",
        ]);
        table.push(row("real", &self.real));
        table.push(row(&format!("{} ({})", self.source.name, self.source.format), &self.generated));
        write!(out, "{table}")?;
        self.remarks.iter().try_for_each(|remark| writeln!(out, "{remark}"))
    }
}

fn row(name: &str, figures: &Figures) -> [String; 9] {
    let cell = |estimate: Estimate, decimals: usize| {
        format!("{:.decimals$} ±{:.decimals$}", estimate.mean, estimate.ci95)
    };
    [
        name.to_owned(),
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
