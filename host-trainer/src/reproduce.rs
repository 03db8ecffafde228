//! The papers' experiments as one command: rows of settings become trainings, blobs, figures and one report.
//!
//! In:  [`Experiments`](experiments::Experiments), clips, a budget.
//! Out: a folder of stages' results, `report.md` with pictures, and [`Reproduction`] for `--json`.
//!
//! Why here: a row that fails is reported with its error, and the others go on; whatever is done stays done. The
//! report is written anew after every row, so that an interrupted reproduction has one too.

pub mod experiments;
pub mod plan;
pub mod cache;
pub mod clips;
pub mod record;
pub mod measure;
pub mod stages;
pub mod estimate;
pub mod report;

use serde::Serialize;

use crate::error::{Error, Result};
use crate::reproduce::clips::Clips;
use crate::reproduce::experiments::Experiments;
use crate::reproduce::measure::Measure;
use crate::reproduce::plan::{Job, PlannedRow};
use crate::reproduce::record::{Outcome, RowRecord};
use crate::reproduce::stages::{Work, Workshop};

/// Everything that the report says.
#[derive(Clone, Debug, Serialize)]
pub struct Reproduction {
    /// Heading of the experiments.
    pub title: String,
    /// Length of every training, in words.
    pub budget: String,
    /// Repetitions of every measurement; `None` without a classifier.
    pub repetitions: Option<usize>,
    /// The rows done so far, in the order of the experiments.
    pub rows: Vec<RowRecord>,
}

impl Reproduction {
    /// Names of the rows that failed.
    pub fn failed(&self) -> Vec<&str> {
        let is_failed = |outcome: &Outcome| matches!(outcome, Outcome::Failed(_));
        let failed = self
            .rows
            .iter()
            .filter(|row| is_failed(&row.result) || row.held_out.as_ref().is_some_and(is_failed));
        failed.map(|row| row.name.as_str()).collect()
    }
}

/// Does all rows, and writes the report after each.
///
/// # Errors
/// `Interrupted` when the user asked to stop; `Io` when the report cannot be written. The errors of a row are in its
/// record.
pub fn reproduce(
    experiments: &Experiments,
    rows: &[PlannedRow],
    clips: &mut Clips,
    workshop: Workshop<'_>,
) -> Result<Reproduction> {
    let mut reproduction = Reproduction {
        title: experiments.title.clone(),
        budget: workshop.budget.in_words(),
        repetitions: workshop.measure.map(Measure::repetitions),
        rows: Vec::new(),
    };
    for row in rows {
        let mut outcome = |job: &Job| match Work::new(workshop, job, clips).finish() {
            Ok(record) => Ok(Outcome::Done(record)),
            Err(interrupted @ Error::Interrupted { .. }) => Err(interrupted),
            Err(error) => Ok(Outcome::Failed(error.to_string())),
        };
        let result = outcome(&row.job)?;
        let held_out = row.held_out.as_ref().map(outcome).transpose()?;
        reproduction.rows.push(RowRecord {
            name: row.experiment.name.clone(),
            about: row.experiment.about.clone(),
            beside: row.experiment.beside.clone(),
            result,
            held_out,
        });
        report::write(experiments, &reproduction, workshop.out)?;
    }
    Ok(reproduction)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};
    use std::sync::atomic::AtomicBool;
    use std::time::SystemTime;

    use super::*;
    use crate::character;
    use crate::checkpoint::Checkpoint;
    use crate::commands::character::write_folder;
    use crate::reproduce::plan::{Budget, plan};
    use crate::reproduce::stages::training_key;
    use crate::train::{Progress, Start, TrainOptions, train};

    const SMALL: &str = "config = { decoder = { hidden_widths = [12] }, codes = { sequence_dimensions = 4, \
                         action_dimensions = 4 }, mixture = { components_max = 2 } }\n";
    const TWO_ROWS: &str = "hold_out = 0.34\nformats = ['float', 'w8a16']\n[[row]]\nname = 'b'\nabout = 'second'\n\
                            preset = 'tiny'\n";

    fn experiments(keys_of_row: &str) -> Experiments {
        let text = format!(
            "title = 'Chako'\nactions = 'frequencies'\nstart = 'zeros'\nframes = 60\n\
             differences = ['not a body']\n[import]\n[[row]]\nname = 'a'\nabout = 'first'\n\
             preset = 'tiny'\n{keys_of_row}{SMALL}"
        );
        Experiments::parse(&text, Path::new("own.toml")).unwrap()
    }

    /// A folder with three clips an action, and `out` beside them.
    struct Place {
        folder: tempfile::TempDir,
    }

    impl Place {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            write_folder(&folder.path().join("clips"), &character::clip_set(3, 3), 3).unwrap();
            Self { folder }
        }

        fn out(&self) -> PathBuf {
            self.folder.path().join("out")
        }

        fn clips(&self) -> Clips {
            Clips::open(&self.folder.path().join("clips"), Default::default()).unwrap()
        }

        fn reproduce(&self, experiments: &Experiments, stop: bool) -> Result<Reproduction> {
            let stop = AtomicBool::new(stop);
            let (out, budget) = (self.out(), Budget::Steps(6));
            let rows = plan(experiments, &[], budget, Path::new("own.toml"))?;
            let workshop = workshop(&out, budget, &stop);
            reproduce(experiments, &rows, &mut self.clips(), workshop)
        }

        fn times(&self) -> Vec<(PathBuf, SystemTime)> {
            let mut found = Vec::new();
            let mut folders = vec![self.out()];
            while let Some(folder) = folders.pop() {
                for entry in fs::read_dir(folder).unwrap() {
                    let path = entry.unwrap().path();
                    match path.is_dir() {
                        true => folders.push(path),
                        false => {
                            found.push((path.clone(), path.metadata().unwrap().modified().unwrap()))
                        }
                    }
                }
            }
            found.retain(|(path, _)| {
                path.extension().is_none_or(|name| name != "md" && name != "svg")
            });
            found.sort();
            found
        }
    }

    fn workshop<'a>(out: &'a Path, budget: Budget, stop: &'a AtomicBool) -> Workshop<'a> {
        Workshop {
            out,
            budget,
            thread_count: Some(1),
            stop,
            resume_command: "the same",
            progress: Progress::Hidden,
            measure: None,
        }
    }

    #[test]
    fn row_that_fails_is_reported_and_the_others_go_on() {
        let place = Place::new();
        let mut experiments = experiments(TWO_ROWS);
        experiments.rows[0].config.insert("representation".into(), "rotations".into());
        let reproduction = place.reproduce(&experiments, false).unwrap();
        assert_eq!(reproduction.failed(), ["a"]);
        assert!(reproduction.rows[1].result.done().is_some());
        let report = fs::read_to_string(place.out().join(report::FILE_NAME)).unwrap();
        assert!(report.contains("## Rows that failed\n\n* `a`:"), "{report}");
    }

    #[test]
    fn two_rows_end_in_a_report_and_are_not_done_again() {
        let place = Place::new();
        let experiments = experiments(TWO_ROWS);
        let first = place.reproduce(&experiments, false).unwrap();
        assert!(first.failed().is_empty(), "{:?}", first.rows);
        let report = fs::read_to_string(place.out().join(report::FILE_NAME)).unwrap();
        for expected in [
            "**a**, w8a16",
            "**a-held-out**",
            "**b**, float",
            "not a body",
            "Trainings are shortened",
        ] {
            assert!(report.contains(expected), "{expected} is missing in {report}");
        }
        let times = place.times();
        let second = place.reproduce(&experiments, false).unwrap();
        assert_eq!(place.times(), times);
        let json = |reproduction: &Reproduction| serde_json::to_string(reproduction).unwrap();
        assert_eq!(json(&second), json(&first));
        assert_eq!(fs::read_to_string(place.out().join(report::FILE_NAME)).unwrap(), report);
    }

    #[test]
    fn interrupted_training_goes_on_and_ends_in_the_same_bytes() {
        let (place, whole) = (Place::new(), Place::new());
        let experiments = experiments("");
        whole.reproduce(&experiments, false).unwrap();
        let error = place.reproduce(&experiments, true).unwrap_err();
        assert!(matches!(error, Error::Interrupted { .. }), "{error}");
        // As Ctrl-C in the middle leaves it: a run that has begun.
        let (stop, out) = (AtomicBool::new(true), place.out());
        let rows = plan(&experiments, &[], Budget::Steps(6), Path::new("own.toml")).unwrap();
        let (mut clips, job) = (place.clips(), &rows[0].job);
        let key = training_key(&workshop(&out, Budget::Steps(6), &stop), job, &clips);
        let run = |place: &Place| place.out().join("trainings").join(key.digits());
        let options = TrainOptions {
            start: Start::New,
            thread_count: Some(1),
            stop: &stop,
            resume_command: "",
            progress: Progress::Hidden,
        };
        fs::create_dir_all(out.join("trainings")).unwrap();
        let split = clips.of(&job.training).unwrap();
        train(&split.training.dataset, &job.training, &run(&place), &options).unwrap_err();
        assert!(!Checkpoint::load(&run(&place)).unwrap().state.finished);
        place.reproduce(&experiments, false).unwrap();
        let bytes = |place| fs::read(run(place).join(Checkpoint::FILE_NAME)).unwrap();
        assert!(bytes(&place) == bytes(&whole));
    }

    #[test]
    fn other_budget_is_another_training() {
        let place = Place::new();
        let experiments = experiments("");
        let rows = plan(&experiments, &[], Budget::Preset, Path::new("own.toml")).unwrap();
        let stop = AtomicBool::new(false);
        let out = place.out();
        let key = |budget| {
            training_key(&workshop(&out, budget, &stop), &rows[0].job, &place.clips()).digits()
        };
        assert_ne!(key(Budget::Passes(5)), key(Budget::Passes(6)));
    }
}
