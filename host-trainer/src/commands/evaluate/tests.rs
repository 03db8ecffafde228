//! `evaluate` from flags to figures, on swings and with a classifier that has learned nothing.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use clap::Parser;
use karakuri::NumberFormat;

use super::*;
use crate::commands::clips::read_clip_data;
use crate::commands::quantize::quantize_checkpoint;
use crate::config::TrainConfig;
use crate::dataset::{self, DatasetOptions};
use crate::evaluate::specimen::{clip_set, write_classifier, write_clips};
use crate::quantize::QuantizeOptions;
use crate::represent::Representation;
use crate::train::{Start as TrainStart, TrainOptions, synthetic, train};

#[derive(Debug, Parser)]
struct Command {
    #[command(flatten)]
    evaluate: EvaluateArgs,
}

/// A run that holds a quarter of its clips out, a blob of it, its clips and a classifier.
struct Specimen {
    folder: tempfile::TempDir,
}

fn specimen() -> &'static Specimen {
    static SPECIMEN: OnceLock<Specimen> = OnceLock::new();
    SPECIMEN.get_or_init(|| {
        let specimen = Specimen { folder: tempfile::tempdir().unwrap() };
        let clips = clip_set(&[("bow", 24), ("nod", 36)], 20);
        write_clips(&specimen.path("clips"), &clips, &[("bow", "1"), ("nod", "0")]);
        write_clips(&specimen.path("others"), &clip_set(&[("bow", 24), ("nod", 35)], 21), &[]);
        write_clips(&specimen.path("few"), &clip_set(&[("bow", 2), ("nod", 3)], 20), &[]);
        write_classifier(&specimen.path("classifier"), 9, 2, Some(&["nod", "bow"]));
        write_classifier(&specimen.path("nameless"), 9, 2, None);
        specimen.train("run", 0.25);
        specimen.train("all", 0.0);
        specimen
    })
}

impl Specimen {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn train(&self, name: &str, hold_out: f64) {
        let config = synthetic::config("[budget]\nsteps = 60\n[batch]\nclips = 15");
        let config = TrainConfig { representation: Representation::Positions, hold_out, ..config };
        let import = self.args("run", "").import;
        let data = read_clip_data(&self.path("clips"), &import, &config).unwrap();
        let options = TrainOptions {
            start: TrainStart::New,
            thread_count: Some(1),
            stop: &AtomicBool::new(false),
            resume_command: "",
            progress: Progress::Hidden,
        };
        let run = self.path(name);
        let checkpoint = train(&data.training.dataset, &config, &run, &options).unwrap();
        let mixtures = mixture::file::of_checkpoint(&run, &checkpoint).unwrap();
        let options = QuantizeOptions::new(NumberFormat::W8A8);
        let quantized = quantize_checkpoint(name, &checkpoint, &mixtures, &options).unwrap();
        fs::write(self.path(&format!("{name}.kara")), quantized.blob).unwrap();
    }

    /// `source` on the specimen's clips, unless `flags` say otherwise; `@` stands for the folder.
    fn args(&self, source: &str, flags: &str) -> EvaluateArgs {
        let folder = self.folder.path().display().to_string();
        let mut line = format!("evaluate @/{source} --fps 20 {flags}").replace('@', &folder);
        for (flag, value) in
            [("--data", "clips"), ("--classifier", "classifier"), ("--repetitions", "")]
        {
            if !flags.contains(flag) {
                let value =
                    if value.is_empty() { "2".to_owned() } else { format!("{folder}/{value}") };
                line += &format!(" {flag} {value}");
            }
        }
        Command::try_parse_from(line.split_whitespace()).unwrap().evaluate
    }

    fn measure(&self, source: &str, flags: &str) -> Result<Evaluation> {
        measure(&self.args(source, flags))
    }

    fn refusal(&self, source: &str, flags: &str) -> String {
        self.measure(source, flags).expect_err("a refusal").to_string()
    }
}

fn is_finite(evaluation: &Evaluation) -> bool {
    [&evaluation.generated, &evaluation.real].iter().all(|figures| {
        let estimates = [
            figures.fid,
            figures.accuracy,
            figures.diversity,
            figures.multimodality,
            figures.mms,
            figures.apd,
            figures.apd_normalized,
        ];
        estimates.iter().all(|estimate| estimate.mean.is_finite() && estimate.ci95.is_finite())
    })
}

#[test]
fn data_that_is_not_the_runs_is_refused() {
    let message = specimen().refusal("run", "--data @/others");
    assert!(message.contains("the dataset is another one than the run's"), "{message}");
    let message = specimen().refusal("all.kara", "--data @/others");
    assert!(message.contains("lengths of the clips that the blob was made of"), "{message}");
}

#[test]
fn too_few_clips_for_fid_are_refused() {
    let message = specimen().refusal("all.kara", "--data @/few");
    assert!(
        message.contains("training clips: number of motions is 5, expected more than 5"),
        "{message}"
    );
}

#[test]
fn too_few_motions_for_fid_are_refused() {
    let message = specimen().refusal("all", "--actions uniform --motions-per-action 2");
    assert!(message.contains("number of motions is 4, expected more than 5"), "{message}");
}

#[test]
fn classifier_without_names_needs_the_column_of_their_numbers() {
    let message = specimen().refusal("all", "--classifier @/nameless");
    assert!(message.contains("--action-order-column"), "{message}");
    let by_number = "--classifier @/nameless --action-order-column number";
    let by_name = specimen().measure("all", "").unwrap();
    // The same weights; `number` orders the actions as the other file's names do.
    assert_eq!(specimen().measure("all", by_number).unwrap().generated, by_name.generated);
    let message = specimen().refusal("all", "--classifier @/nameless --action-order-column action");
    assert!(message.contains("column action is bow, expected a number from 0"), "{message}");
}

#[test]
fn run_of_another_configuration_than_the_blobs_is_refused() {
    let message = specimen().refusal("all.kara", "--run @/run");
    assert!(message.contains("give the run that the blob was made of"), "{message}");
}

#[test]
fn file_that_is_there_is_not_replaced() {
    let out = specimen().path("taken");
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("evaluation.svg"), "old").unwrap();
    let args = specimen().args("all", "--out @/taken");
    assert!(run(&args).unwrap_err().to_string().contains("there already"));
    assert_eq!(fs::read_to_string(out.join("evaluation.svg")).unwrap(), "old");
}

#[test]
fn float_run_is_measured_on_both_sides_of_its_split() {
    let evaluation = specimen().measure("run", "").unwrap();
    assert!(is_finite(&evaluation));
    assert_eq!(
        (evaluation.data.training_clip_count, evaluation.data.held_out_clip_count),
        (45, 15)
    );
    assert!(evaluation.generated.fid_held_out.is_some() && evaluation.real.fid_held_out.is_some());
    assert!(evaluation.real.fid.mean < evaluation.generated.fid.mean);
    assert!(evaluation.nearest_training_clip_mm.held_out.is_some());
    assert!(evaluation.papers.is_empty());
    assert!(evaluation.remarks.iter().any(|remark| remark.contains("no papers' rows")));
    let counts = evaluation.generated.accuracy_by_action.iter().map(|action| action.motion_count);
    assert!(counts.eq([18, 27]));
}

#[test]
fn run_that_held_nothing_out_has_no_held_out_figure_and_says_why() {
    let evaluation = specimen().measure("all", "").unwrap();
    assert_eq!((evaluation.generated.fid_held_out, evaluation.real.fid_held_out), (None, None));
    assert!(evaluation.remarks[0].contains("no clip was held out"));
}

#[test]
fn blob_is_measured_in_its_own_arithmetic_with_its_runs_split() {
    let evaluation = specimen().measure("run.kara", "--run @/run").unwrap();
    assert!(is_finite(&evaluation) && evaluation.generated.fid_held_out.is_some());
    assert_eq!(evaluation.source.format, "w8a8");
    let blob = fs::read(specimen().path("run.kara")).unwrap();
    assert_eq!(evaluation.source.bytes, Some(blob.len()));
    // The real row does not depend on what is measured beside it.
    assert_eq!(evaluation.real, specimen().measure("run", "").unwrap().real);
}

#[test]
fn replayed_codes_are_no_farther_from_their_clips_than_new_ones() {
    let median = |flags| {
        let evaluation = specimen().measure("all", flags).unwrap();
        evaluation.nearest_training_clip_mm.generated.unwrap().median
    };
    assert!(median("--replay") <= 1.1 * median(""));
    assert!(specimen().refusal("all.kara", "--replay").contains("--replay is of a blob"));
}

#[test]
fn uniform_actions_are_equally_many_with_any_start() {
    let flags = "--actions uniform --motions-per-action 20 --start gaussian --frames 30";
    let evaluation = specimen().measure("run", flags).unwrap();
    assert!(is_finite(&evaluation));
    for figures in [&evaluation.generated, &evaluation.real] {
        assert!(figures.accuracy_by_action.iter().all(|action| action.motion_count == 20));
    }
}

#[test]
fn figures_do_not_depend_on_the_number_of_threads() {
    for source in ["run", "run.kara"] {
        let flags = "--run @/run --start gaussian";
        let [one, two] = [1, 2].map(|thread_count| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build().unwrap();
            pool.install(|| specimen().measure(source, flags)).unwrap()
        });
        assert_eq!(one, two, "{source}");
        let other_seed =
            specimen().measure(source, "--run @/run --start gaussian --seed 2").unwrap();
        assert_ne!(one.generated, other_seed.generated, "{source}");
    }
}

#[test]
fn every_repetition_draws_anew() {
    let evaluation = specimen().measure("all", "").unwrap();
    assert!(evaluation.generated.fid.ci95 > 0.0 && evaluation.generated.apd.ci95 > 0.0);
}

#[test]
fn report_is_written_as_json_picture_and_text() {
    let args = specimen().args("run", "--out @/report --repetitions 1");
    run(&args).unwrap();
    let json = fs::read(specimen().path("report").join("evaluation.json")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let names = [
        "fid",
        "fid_held_out",
        "accuracy",
        "diversity",
        "multimodality",
        "mms",
        "apd",
        "apd_normalized",
    ];
    for side in [&json, &json["real"]] {
        for name in names {
            assert!(side[name]["mean"].is_f64() && side[name]["ci95"].is_f64(), "{name}");
        }
    }
    assert_eq!(json["classifier"]["sha256"].as_str().unwrap().len(), 64);
    let picture = fs::read_to_string(specimen().path("report").join("evaluation.svg")).unwrap();
    assert!(picture.contains("held-out FID") && !picture.contains("NaN"));
    let text = measure(&args).unwrap().to_string();
    assert!(text.contains("mm to the nearest training clip") && text.contains("→ real"), "{text}");
    assert!(Path::new(&json["source"]["name"].as_str().unwrap()).ends_with("run"));
}

#[test]
fn servos_are_measured_on_their_channels() {
    let clips = crate::character::clip_set(1, 3);
    let real = RealMotions::new(&clips, None).unwrap();
    let names: Vec<&str> = real.actions.iter().map(String::as_str).collect();
    let file = specimen().path("servos");
    write_classifier(&file, real.channel_count(), names.len(), Some(&names));
    let classifier = Classifier::load(&file).unwrap();
    let description = ClassifierDescription { file: String::new(), sha256: String::new() };
    let judge = Judge::new(&classifier, description, &real, None).unwrap();
    let dataset = dataset::build(&clips, &DatasetOptions::default()).unwrap();
    let checkpoint = Checkpoint::start(&dataset, &synthetic::config(""));
    let codes = ClipCodes(&checkpoint);
    let source = FloatSource::new(&checkpoint, &codes, "servos", "").unwrap();
    let protocol = Protocol { repetitions: 2, ..Protocol::default() };
    let evaluation = evaluate(&source, &real, &judge, &protocol, Progress::Hidden).unwrap();
    assert!(is_finite(&evaluation));
    assert!(evaluation.nearest_training_clip_mm.generated.is_none());
    assert!(evaluation.to_string().contains("only of bodies"));
}
