//! The report as aligned text, warnings last, where the eye stays.

use std::fmt::{self, Display, Formatter};

use super::{CLIPS_PER_ACTION_MIN, ClipReport, JUMP_FACTOR, Lengths, PLACES_MAX, Places};
use crate::table::Table;

impl Display for ClipReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let seconds = self.frame_count as f64 / self.rate_hz;
        writeln!(
            f,
            "{} clips, {} actions, {} frames, {seconds:.1} s at {} Hz, {} channels\n",
            self.clip_count,
            self.actions.len(),
            self.frame_count,
            self.rate_hz,
            self.channel_count,
        )?;
        writeln!(f, "{}", self.action_table())?;
        writeln!(f, "{}", self.row_table())?;
        let warnings = self.warnings();
        if warnings.is_empty() {
            return writeln!(f, "no warnings");
        }
        writeln!(f, "warnings")?;
        warnings.iter().try_for_each(|warning| writeln!(f, "  {warning}"))
    }
}

impl ClipReport {
    fn action_table(&self) -> Table {
        let header = ["action", "clips", "frames min", "median", "max", "s min", "median", "max"];
        let mut table = Table::new(header);
        let mut row = |name: &str, clip_count: usize, lengths: Lengths| {
            let lengths = [lengths.min, lengths.median, lengths.max];
            let [min, median, max] = lengths.map(|length| length.to_string());
            let seconds = lengths.map(|length| format!("{:.2}", length as f64 / self.rate_hz));
            let [min_s, median_s, max_s] = seconds;
            let (name, clip_count) = (name.to_string(), clip_count.to_string());
            table.push([name, clip_count, min, median, max, min_s, median_s, max_s]);
        };
        for action in &self.actions {
            let name = if action.name.is_empty() { "(no label)" } else { &action.name };
            row(name, action.clip_count, action.frame_counts);
        }
        row("all", self.clip_count, self.frame_counts);
        table
    }

    fn row_table(&self) -> Table {
        let header = ["channel", "unit", "min", "max", "max speed /s", "jumps", "non-finite"];
        let mut table = Table::new(header);
        for row in &self.rows {
            let [min, max, speed] = [row.min, row.max, row.speed_max].map(|v| format!("{v:.3}"));
            let [jumps, non_finite] = [row.jump_count, row.non_finite_count].map(|n| n.to_string());
            table.push([row.name.clone(), row.unit.clone(), min, max, speed, jumps, non_finite]);
        }
        table
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.action_warnings();
        if !self.constant_channels.is_empty() {
            warnings.push(format!("constant: {}", self.constant_channels.join(", ")));
        }
        let jump_text = format!("frames jump by over {JUMP_FACTOR} times the usual fastest change");
        warnings.extend(places("values are not finite", &self.non_finite));
        warnings.extend(places(&jump_text, &self.jumps));
        let same: Vec<String> = self.duplicates.iter().map(|names| names.join(" = ")).collect();
        if !same.is_empty() {
            let text = format!("{} times the same poses: {}", same.len(), first_few(&same));
            warnings.push(text);
        }
        warnings.extend(self.remarks.iter().cloned());
        warnings
    }

    fn action_warnings(&self) -> Vec<String> {
        let (unlabelled, labelled): (Vec<_>, Vec<_>) =
            self.actions.iter().partition(|action| action.name.is_empty());
        let mut warnings: Vec<String> = unlabelled
            .iter()
            .map(|action| format!("{} clips have no label", action.clip_count))
            .collect();
        let scarce: Vec<String> = labelled
            .iter()
            .filter(|action| action.is_scarce)
            .map(|action| format!("{} ({})", action.name, action.clip_count))
            .collect();
        if !scarce.is_empty() {
            let (count, few) = (scarce.len(), first_few(&scarce));
            let text = format!("{count} actions have fewer than {CLIPS_PER_ACTION_MIN} clips");
            warnings.push(format!("{text}; --label-groups can join them: {few}"));
        }
        warnings
    }
}

/// The first of a list, and how many more there are.
fn first_few(all: &[String]) -> String {
    let shown = all[..all.len().min(PLACES_MAX)].join(", ");
    match all.len().saturating_sub(PLACES_MAX) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

/// One line for the number, one for each place.
fn places(what: &str, places: &Places) -> Vec<String> {
    if places.count == 0 {
        return Vec::new();
    }
    let shown = match places.places.len() {
        shown if shown < places.count => format!(", {shown} of them"),
        _ => String::new(),
    };
    let lines = places.places.iter().map(|place| {
        format!("  {} frame {}, {}: {}", place.clip, place.frame, place.row, place.value)
    });
    std::iter::once(format!("{} {what}{shown}:", places.count)).chain(lines).collect()
}
