//! `host-trainer inspect PATH` on clip files, and the flags by which every verb reads clips.

use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use crate::error::{Error, Result};
use crate::import;
use crate::import::labels::{LabelOptions, LabelSource};
use crate::import::{Format, ImportOptions};
use crate::inspect::ClipReport;
use crate::layout::Unit;

/// What clip files do not say themselves.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Reading clips")]
pub struct ImportArgs {
    /// Format of the clip files; otherwise by their extension
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// Poses per second: of files without time; files with time are resampled to it
    #[arg(long = "fps", value_name = "RATE")]
    pub rate_hz: Option<f64>,
    /// Unit of the values in files that do not name it
    #[arg(long, value_parser = parse_unit)]
    pub unit: Option<Unit>,
    /// Factor on every length (BVH) or every value (npy)
    #[arg(long, value_name = "FACTOR")]
    pub scale: Option<f64>,
    /// Names of the joints or channels of npy files, separated by commas
    #[arg(long, value_delimiter = ',', value_name = "NAME")]
    pub names: Vec<String>,
    /// Table of labels; otherwise labels.csv beside the clips or one folder up
    #[arg(long, value_name = "FILE", conflicts_with_all = ["label_pattern", "label_folder"])]
    pub labels: Option<PathBuf>,
    /// Column of the table that names the clip; otherwise the first
    #[arg(long, value_name = "COLUMN")]
    pub label_clip_column: Option<String>,
    /// Column of the table that names the action; otherwise `action`, `label` or the second of two
    #[arg(long, value_name = "COLUMN")]
    pub label_action_column: Option<String>,
    /// Action by the one capture group of this pattern on the clip's name, as in `^([a-z_]+?)\d+$`
    #[arg(long, value_name = "REGEX", conflicts_with = "label_folder")]
    pub label_pattern: Option<String>,
    /// Action by the name of the clip's folder
    #[arg(long)]
    pub label_folder: bool,
    /// TOML file of `action = ["label", ...]` that joins many labels into one action
    #[arg(long, value_name = "FILE")]
    pub label_groups: Option<PathBuf>,
    /// Joint tree: a built-in name (smpl24) or a TOML file
    #[arg(long, value_name = "NAME|FILE")]
    pub skeleton: Option<String>,
}

impl ImportArgs {
    /// The strict options of everything that trains; `inspect` tolerates more.
    ///
    /// # Errors
    /// [`Error::BadInput`] if the pattern is not usable.
    pub fn options(&self) -> Result<ImportOptions> {
        Ok(ImportOptions {
            format: self.format,
            labels: self.label_options()?,
            rate_hz: self.rate_hz,
            unit: self.unit,
            scale: self.scale,
            names: self.names.clone(),
            tolerate_non_finite: false,
            tolerate_missing_labels: false,
        })
    }

    fn label_options(&self) -> Result<LabelOptions> {
        let source = match (&self.labels, self.label_folder) {
            (Some(path), _) => LabelSource::File(path.clone()),
            (None, true) => LabelSource::Folder,
            (None, false) => LabelSource::Auto,
        };
        let options = LabelOptions {
            source,
            clip_column: self.label_clip_column.clone(),
            action_column: self.label_action_column.clone(),
            groups: self.label_groups.clone(),
        };
        match &self.label_pattern {
            Some(pattern) => options.with_pattern(pattern),
            None => Ok(options),
        }
    }
}

/// Reports what clip files hold.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  host-trainer inspect clips --fps 50\n  host-trainer inspect creature.kara"
)]
pub struct InspectClipsArgs {
    /// Clip file, folder of clip files, or blob (`.kara`)
    pub path: PathBuf,
    /// Print JSON instead of tables
    #[arg(long)]
    pub json: bool,
    /// What the files do not say themselves
    #[command(flatten)]
    pub import: ImportArgs,
}

/// Prints the report on stdout; warnings in it are no error.
///
/// # Errors
/// [`Error::BadInput`] and [`Error::Io`] of the import, except for what `inspect` is there to
/// report.
pub fn run(args: &InspectClipsArgs) -> Result<()> {
    let options = ImportOptions {
        tolerate_non_finite: true,
        tolerate_missing_labels: true,
        ..args.import.options()?
    };
    let report = ClipReport::new(&import::read(&args.path, &options)?);
    let text = match args.json {
        true => serde_json::to_string_pretty(&report).map_err(|error| Error::Io {
            path: "stdout".into(),
            action: "write",
            source: error.into(),
        })?,
        false => report.to_string(),
    };
    match writeln!(std::io::stdout(), "{}", text.trim_end()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()), // `| head` has seen enough.
        result => result.map_err(Error::io("write", "stdout")),
    }
}

fn parse_unit(text: &str) -> std::result::Result<Unit, String> {
    let known = import::UNITS.map(Unit::suffix).join(", ");
    import::unit_of_suffix(text).ok_or_else(|| format!("expected one of {known}"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, clap::Parser)]
    struct Command {
        #[command(flatten)]
        inspect: InspectClipsArgs,
    }

    fn parsed(line: &str) -> std::result::Result<ImportArgs, clap::Error> {
        let words = ["inspect", "clips"].into_iter().chain(line.split_whitespace());
        Command::try_parse_from(words).map(|command| command.inspect.import)
    }

    #[test]
    fn contradictory_and_unknown_values_are_refused() {
        for line in [
            "--labels a.csv --label-folder",
            "--label-pattern (a) --label-folder",
            "--labels a.csv --label-pattern (a)",
            "--unit furlong",
            "--format mp4",
            "--fps fast",
        ] {
            assert!(parsed(line).is_err(), "{line}");
        }
        assert!(parsed("--unit furlong").unwrap_err().to_string().contains("one, rad, deg"));
    }

    #[test]
    fn flags_become_options() {
        let line = "--format npy --fps 20 --unit cm --scale 0.05 --names jaw,neck \
                    --label-action-column coarse --label-groups groups.toml";
        let options = parsed(line).unwrap().options().unwrap();
        assert_eq!(options.format, Some(Format::Npy));
        assert_eq!((options.rate_hz, options.scale), (Some(20.0), Some(0.05)));
        assert_eq!((options.unit, options.names.len()), (Some(Unit::Centimetre), 2));
        assert_eq!(options.labels.action_column.as_deref(), Some("coarse"));
        assert!(matches!(options.labels.source, LabelSource::Auto));
        let pattern = parsed("--label-pattern ^([a-z]+)").unwrap().options().unwrap();
        assert!(matches!(pattern.labels.source, LabelSource::Pattern(_)));
    }
}
