//! The whole path by the commands that a user types: data on standard output, everything else on standard error, the
//! same seed the same bytes, and nothing lost to an interruption.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use karakuri::Model;
use tests::{FORMATS, Outcome, Program, firmware_sim, host_trainer, sandbox, trained, workplace};

/// Exit code after Ctrl-C.
const INTERRUPTED: i32 = 130;
const CHECKPOINT: &str = "checkpoint.safetensors";

#[test]
fn demo_tells_the_whole_story_in_one_table() {
    let folder = sandbox();
    let demo = host_trainer(folder.path(), "demo --preset tiny --steps 40 --clips-per-action 4")
        .succeeded();
    for part in [
        "clips",
        "training",
        "w8a16",
        "w8a8",
        "w4a8",
        "f16",
        "weights",
        "RAM bytes",
        "multiply-accumulates",
    ] {
        assert!(demo.stdout.contains(part), "no {part:?}: {demo}");
    }
    for made in [
        "clips",
        "run",
        "motions",
        "calibration.toml",
        "chako-tiny-w8a16.kara",
        "chako-tiny-w8a8.kara",
        "chako-tiny-w4a8.kara",
        "chako-tiny-f16.kara",
    ] {
        assert!(folder.path().join("demo").join(made).exists(), "no {made}: {demo}");
    }
    let report = host_trainer(folder.path(), "inspect demo/chako-tiny-w8a8.kara --json");
    assert_eq!(report.succeeded().json()["servo_count"], 11);
    let motions = fs::read_dir(folder.path().join("demo/motions")).expect("motions").count();
    assert_eq!(motions, 10 * (3 + 1), "three motions and a picture of each of ten actions");
}

#[test]
fn character_writes_the_clips_that_inspect_counts() {
    let Outcome { stdout, .. } = host_trainer(&trained().folder, "inspect clips").succeeded();
    assert!(stdout.contains("40") && stdout.contains("nod"), "{stdout}");
    let report = host_trainer(&trained().folder, "inspect clips --json").succeeded().json();
    assert_eq!((&report["clip_count"], &report["channel_count"]), (&40.into(), &11.into()));
    assert_eq!(report["actions"].as_array().map(Vec::len), Some(10));
    assert_eq!((&report["non_finite"]["count"], &report["rate_hz"]), (&0.into(), &50.0.into()));
}

#[test]
fn training_prints_its_result_and_leaves_metrics_and_a_picture() {
    let folder = workplace();
    let outcome =
        host_trainer(folder.path(), "train clips --out run --preset tiny --steps 20").succeeded();
    assert!(outcome.stdout.starts_with("20 steps, in run\n"), "{outcome}");
    assert!(outcome.stdout.contains("RMS"), "{outcome}");
    let run = folder.path().join("run");
    let config = fs::read_to_string(run.join("config.toml")).expect("the configuration");
    assert!(config.contains("steps = 20"), "{config}");
    let metrics = fs::read_to_string(run.join("metrics.jsonl")).expect("metrics");
    assert!(metrics.lines().count() >= 1);
    for line in metrics.lines() {
        let line: serde_json::Value = serde_json::from_str(line).expect("JSON in every line");
        assert!(line["loss"].as_f64().is_some_and(f64::is_finite), "{line}");
    }
    assert!(fs::read_to_string(run.join("loss.svg")).expect("a picture").contains("<svg"));
}

#[test]
fn reconstruct_measures_the_float_model_and_every_blob() {
    let blobs = FORMATS.map(|format| format!("--blob {format}.kara")).join(" ");
    let line = format!("reconstruct creature clips --stride 8 {blobs}");
    let table = host_trainer(&trained().folder, &line).succeeded();
    let rows = host_trainer(&trained().folder, &format!("{line} --json")).succeeded().json();
    let rows = rows.as_array().expect("a list of decoders");
    assert_eq!(rows.len(), 1 + FORMATS.len());
    for (row, decoder) in rows.iter().zip(["float"].iter().chain(&FORMATS)) {
        assert!(row["decoder"].as_str().is_some_and(|name| name.contains(decoder)), "{row}");
        assert!(table.stdout.contains(decoder), "{table}");
    }
}

#[test]
fn blob_explains_itself_to_people_and_programs() {
    for format in FORMATS {
        let file = format!("{format}.kara");
        let people = host_trainer(&trained().folder, &format!("inspect {file}")).succeeded();
        assert!(people.stdout.contains(format) && people.stdout.contains("weights"), "{people}");
        let report =
            host_trainer(&trained().folder, &format!("inspect {file} --json")).succeeded().json();
        let bytes = fs::metadata(trained().blob(format)).expect("a blob").len();
        assert_eq!((&report["format"], &report["bytes"]), (&format.into(), &bytes.into()));
        let parts = report["parts"].as_array().expect("parts").iter();
        assert_eq!(parts.filter_map(|part| part["bytes"].as_u64()).sum::<u64>(), bytes);
    }
}

#[test]
fn generate_writes_every_file_format_from_run_and_blob() {
    let folder = workplace();
    for source in ["creature", "w8a16.kara"] {
        for extension in ["csv", "npy", "json"] {
            let line = format!(
                "generate {source} --action nod --seconds 2.0 --seed 7 --count 3 --out {extension} --as {extension} \
                 --plot --force"
            );
            let outcome = host_trainer(folder.path(), &line).succeeded();
            let files: Vec<&str> = outcome.stdout.lines().collect();
            assert_eq!(files.len(), 3 + 1, "three motions and a picture: {outcome}");
            for file in files {
                assert!(
                    fs::metadata(folder.path().join(file)).is_ok_and(|file| file.len() > 0),
                    "{outcome}"
                );
            }
        }
    }
}

#[test]
fn same_seed_gives_the_same_motion_and_another_seed_another() {
    let folder = workplace();
    for source in ["creature", "w8a8.kara"] {
        let motion = |seed: u64, out: &str| {
            let line = format!(
                "generate {source} --action shake --seconds 2.4 --seed {seed} --out {out} --force"
            );
            let outcome = host_trainer(folder.path(), &line).succeeded();
            let text =
                fs::read_to_string(folder.path().join(outcome.stdout.trim())).expect("a motion");
            text.lines()
                .filter(|line| !line.starts_with('#'))
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        assert_eq!(motion(7, "a"), motion(7, "b"));
        assert_ne!(motion(7, "a"), motion(8, "a"));
    }
}

#[test]
fn generated_tracks_are_clips_again() {
    let folder = workplace();
    for action in ["nod", "shake"] {
        let line = format!(
            "generate w8a16.kara --action {action} --seconds 2.2 --count 4 --out new/{action}"
        );
        host_trainer(folder.path(), &line).succeeded();
    }
    let report = host_trainer(folder.path(), "inspect new --json").succeeded().json();
    assert_eq!((&report["clip_count"], &report["frame_count"]), (&8.into(), &(8 * 110).into()));
    assert_eq!(report["actions"].as_array().map(Vec::len), Some(2));
    assert_eq!((&report["channel_count"], &report["rate_hz"]), (&11.into(), &50.0.into()));
    host_trainer(folder.path(), "train new --out again --preset tiny --steps 5").succeeded();
}

#[test]
fn comparison_is_printed_for_people_and_programs() {
    for format in FORMATS {
        let line = format!("compare creature {format}.kara --frames-per-clip 2 --draw-poses 50");
        let table = firmware_sim(&trained().folder, &line).succeeded();
        assert!(table.stdout.contains("RMS") && table.stdout.contains("SNR dB"), "{table}");
        let report = firmware_sim(&trained().folder, &format!("{line} --json")).succeeded().json();
        assert_eq!(
            (&report["number_format"], &report["training_clips"]["motion_count"]),
            (&format.into(), &40.into())
        );
    }
}

#[test]
fn verbs_explain_themselves_with_an_example() {
    let verbs = [
        (Program::HostTrainer, "demo character inspect train reconstruct quantize generate bench"),
        (Program::FirmwareSim, "run compare trace"),
    ];
    for (program, verbs) in verbs {
        for verb in verbs.split(' ') {
            let help = program.run(&trained().folder, [verb, "--help"]).succeeded();
            assert!(help.stdout.contains("Example"), "{verb}: {help}");
        }
    }
}

/// The run and the blobs of one training; training is repeated with another number of threads.
#[test]
fn same_seed_gives_the_same_checkpoint_and_the_same_blobs() {
    let folder = workplace();
    // A run's name goes into its blobs, so the second run has it too.
    let train =
        "train clips --out again/creature --preset tiny --config quick.toml --seed 7 --threads 2";
    host_trainer(folder.path(), train).succeeded();
    assert_same(
        &trained().run.join(CHECKPOINT),
        &folder.path().join("again/creature").join(CHECKPOINT),
    );
    for format in FORMATS {
        let line = format!("quantize again/creature --format {format} --out again/{format}.kara");
        host_trainer(folder.path(), &line).succeeded();
        assert_same(&trained().blob(format), &folder.path().join(format!("again/{format}.kara")));
    }
}

#[track_caller]
fn assert_same(left: &Path, right: &Path) {
    let [left_bytes, right_bytes] = [left, right].map(|file| fs::read(file).expect("a file"));
    assert!(left_bytes == right_bytes, "{} and {} differ", left.display(), right.display());
}

/// `host-trainer` in the background.
fn start(folder: &Path, line: &str) -> Child {
    let mut command = Command::new(Program::HostTrainer.path());
    let command = command.args(line.split_whitespace()).current_dir(folder);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

/// Waits until a file exists, as a sign that the work behind it has begun.
fn wait_for(file: &Path, child: &mut Child) {
    while !file.exists() {
        assert!(child.try_wait().expect("a child").is_none(), "ended without {}", file.display());
        sleep(Duration::from_millis(1));
    }
}

/// Ctrl-C, then `kill -9`, then to the end: the bytes are those of the run that nobody disturbed.
#[test]
fn run_that_was_interrupted_and_killed_ends_in_the_same_bytes() {
    let folder = workplace();
    let path = folder.path();
    let train = |out: &str| {
        format!("train clips --out {out} --preset tiny --config quick.toml --steps 2500")
    };
    host_trainer(path, &train("whole")).succeeded();

    let checkpoint = path.join("cut").join(CHECKPOINT);
    let mut child = start(path, &train("cut"));
    wait_for(&checkpoint, &mut child);
    sleep(Duration::from_millis(50));
    let signal = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(signal.expect("kill exists").success());
    let status = child.wait().expect("a child");
    assert_eq!(status.code(), Some(INTERRUPTED), "the run ended before Ctrl-C reached it");
    let saved = fs::read(&checkpoint).expect("the interrupted run was saved");

    let mut child = start(path, &format!("{} --resume", train("cut")));
    sleep(Duration::from_millis(150));
    child.kill().expect("a child to kill");
    assert_eq!(child.wait().expect("a child").code(), None, "the run ended before it was killed");
    assert!(
        fs::read(&checkpoint).expect("a checkpoint") == saved,
        "a kill between two saves changed the checkpoint"
    );

    host_trainer(path, &format!("{} --resume", train("cut"))).succeeded();
    assert_same(&path.join("whole").join(CHECKPOINT), &checkpoint);
}

/// Killed at twelve moments from the first to the last millisecond; each leaves no blob or a whole one, and the next
/// attempt works.
#[test]
fn quantising_that_is_killed_leaves_no_blob_or_a_whole_one() {
    const MOMENTS: u32 = 12;
    let folder = sandbox();
    let path = folder.path();
    fs::create_dir(path.join("run")).expect("a writable folder");
    // Without the cache of the mixtures, so that fitting and storing them is interrupted, too.
    for file in [CHECKPOINT, "config.toml"] {
        fs::copy(trained().run.join(file), path.join("run").join(file)).expect("a copy");
    }
    let line = "quantize run --format w8a16 --out model.kara";
    let begin = std::time::Instant::now();
    host_trainer(path, line).succeeded();
    let duration = begin.elapsed();
    let whole = fs::read(path.join("model.kara")).expect("a blob");
    for moment in 0..=MOMENTS {
        let _ = fs::remove_file(path.join("model.kara"));
        let _ = fs::remove_file(path.join("run/mixture.safetensors"));
        let mut child = start(path, line);
        sleep(duration * moment / MOMENTS);
        // Fails only for a child that has ended.
        let _ = child.kill();
        child.wait().expect("a child");
        if let Ok(blob) = fs::read(path.join("model.kara")) {
            assert!(blob == whole, "killed at {moment}/{MOMENTS}: half a blob");
            assert!(Model::from_bytes(&blob).is_ok());
        }
    }
    host_trainer(path, &format!("{line} --force")).succeeded();
    assert!(fs::read(path.join("model.kara")).expect("a blob") == whole);
}
