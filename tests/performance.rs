//! An hour of a character without a body: `firmware-sim perform` on a trained and calibrated blob.
//!
//! Why here: limits, rest and repeats are promises of the whole path, from clips to pulses; so is that a chip performs
//! what the host performs, command by command.

use std::fs;
use std::path::Path;

use karakuri::Model;
use tempfile::TempDir;
use tests::{
    FLOAT_FORMAT, GOLDEN_BLOBS, Program, assert_golden, firmware_sim, golden_path, host_trainer,
    repository, seal, skip, workplace,
};

/// `firmware-sim`'s exit code where QEMU or a cross-compiler is missing.
const MISSING_TOOL: i32 = 6;

/// A folder with `chako.kara`, calibrated as the demo is.
fn stage() -> TempDir {
    let folder = workplace();
    let calibration = repository().join("host-trainer/calibrations/chako.toml");
    let line =
        format!("calibrate w8a16.kara --calibration {} --out chako.kara", calibration.display());
    host_trainer(folder.path(), &line).succeeded();
    folder
}

fn performed(folder: &Path, line: &str) -> serde_json::Value {
    firmware_sim(folder, &format!("perform chako.kara {line} --json")).succeeded().json()
}

#[test]
fn blob_without_servos_and_scripts_that_cannot_be_performed_are_refused() {
    let folder = stage();
    let at = folder.path();
    firmware_sim(at, "perform w8a16.kara")
        .refused(3, &["w8a16.kara", "number of servos is 0", "host-trainer calibrate"]);
    for (text, says) in [
        ("0 wake\n1 play sing 2\n", "line 2 (`1 play sing 2`) is sing, expected an action: "),
        ("0 wake\n1 play nod 600\n", "expected a trained length"),
        ("1 wake\n0 hold\n", "line 2"),
    ] {
        fs::write(at.join("script.txt"), text).expect("a writable folder");
        firmware_sim(at, "perform chako.kara --script script.txt")
            .refused(3, &[says, "perform --help"]);
    }
    fs::create_dir(at.join("hour")).expect("a writable folder");
    fs::write(at.join("hour/trace.csv"), "mine").expect("a writable folder");
    firmware_sim(at, "perform chako.kara --minutes 0.1 --out hour")
        .refused(3, &["trace.csv", "--force"]);
    assert_eq!(fs::read_to_string(at.join("hour/trace.csv")).expect("a file"), "mine");
}

#[test]
fn half_an_hour_with_faults_keeps_every_limit_and_rests() {
    let folder = stage();
    let summary = performed(folder.path(), "--minutes 30 --seed 3 --out hour");
    let number = |key: &str| summary[key].as_f64().unwrap_or(f64::NAN);
    assert_eq!((number("violations"), number("ticks")), (0.0, 90_000.0), "{summary}");
    assert!((0.05..0.8).contains(&number("active_fraction")), "{summary}");
    assert!(number("interventions_per_minute") < 600.0, "{summary}");
    assert!(summary["nearest_repeat"]["distance"].as_f64() > Some(0.0), "{summary}");
    for name in ["trace.csv", "summary.json", "performance.svg"] {
        assert!(
            fs::metadata(folder.path().join("hour").join(name)).is_ok_and(|file| file.len() > 300)
        );
    }
    let again = performed(folder.path(), "--minutes 30 --seed 3");
    assert_eq!(summary, again, "the same seed, the same hour");
}

/// Ten minutes of the committed blobs in every integer format, at the tick rates that loops have.
#[test]
fn ten_minutes_of_the_committed_blobs_are_the_known_ones() {
    let folder = tests::sandbox();
    let calibration = repository().join("host-trainer/calibrations/chako.toml");
    let mut table =
        "format  tick Hz  frames a key  violations  interventions/min  active %  in motion %  \
        nearest repeat, deg  of the clips\n"
            .to_owned();
    for (format, blob) in GOLDEN_BLOBS.into_iter().filter(|(format, _)| *format != FLOAT_FORMAT) {
        let blob = golden_path(blob);
        let line = format!(
            "calibrate {} --calibration {} --out chako.kara --force",
            blob.display(),
            calibration.display()
        );
        host_trainer(folder.path(), &line).succeeded();
        for (tick_hz, frames_per_key) in [(50, 1), (60, 2), (200, 4)] {
            let line = format!(
                "--minutes 10 --seed 1 --tick-hz {tick_hz} --frames-per-key {frames_per_key}"
            );
            let summary = performed(folder.path(), &line);
            let number = |key: &str| {
                summary.pointer(key).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN)
            };
            table += &format!(
                "{format:<6}  {tick_hz:>7}  {frames_per_key:>12}  {:>10}  {:>17.1}  {:>8.1}  {:>11.1}  {:>19.2}  \
                 {:>12.2}\n",
                number("/violations"),
                number("/interventions_per_minute"),
                100.0 * number("/active_fraction"),
                100.0 * number("/in_motion_fraction"),
                number("/nearest_repeat/distance"),
                number("/nearest_among_clips/distance"),
            );
        }
    }
    assert_golden("performance.txt", &table);
}

#[test]
fn idle_character_rests_as_told_and_does_not_repeat_itself() {
    let folder = stage();
    fs::write(folder.path().join("idle.txt"), "0 wake\n1 idle all\n1 dial stillness 0.5\n")
        .expect("a writable folder");
    let summary = performed(folder.path(), "--minutes 60 --script idle.txt");
    let moving = summary["in_motion_fraction"].as_f64().unwrap_or_default();
    assert!((0.42..0.58).contains(&moving), "{summary}");
    // A model of a few seconds of training; without moods the demo's own came as near as 0.2 degrees.
    assert!(summary["nearest_repeat"]["distance"].as_f64() > Some(0.2), "{summary}");
}

/// Weights that changed in flash after they were checked: motion may be nonsense, commands may not.
#[test]
fn flipped_bits_behind_a_fitting_checksum_never_break_a_limit() {
    let folder = stage();
    let whole = fs::read(folder.path().join("chako.kara")).expect("a blob");
    let mut performances = 0;
    for place in (0..whole.len() * 8).step_by(whole.len() * 8 / 24) {
        let mut blob = whole.clone();
        blob[place / 8] ^= 1 << (place % 8);
        seal(&mut blob);
        if Model::from_bytes(&blob).is_err() {
            continue;
        }
        fs::write(folder.path().join("flipped.kara"), &blob).expect("a writable folder");
        let outcome = firmware_sim(folder.path(), "perform flipped.kara --minutes 1 --json");
        if outcome.code == Some(3) {
            continue; // The calibration itself was hit: refused by name.
        }
        let summary = outcome.succeeded().json();
        assert_eq!(summary["violations"], 0, "bit {place}: {summary}");
        performances += 1;
    }
    assert!(performances > 15, "{performances}");
}

#[test]
fn a_cortex_m4_performs_what_the_host_performs() {
    let folder = stage();
    let line = "perform chako.kara --minutes 3 --seed 2 --target cortex-m4 --json";
    let outcome = Program::FirmwareSim.run(folder.path(), line.split(' '));
    if outcome.code == Some(MISSING_TOOL) {
        skip(outcome.stderr.trim());
        return;
    }
    let summary = outcome.succeeded().json();
    let chip = &summary["chips"][0];
    assert_eq!(chip["ticks"], 9000, "{summary}");
    assert_eq!(chip["differences"]["bits_differing"], 0, "{summary}");
}

#[test]
fn ticks_are_counted_and_those_without_a_pose_are_the_cheap_ones() {
    let folder = stage();
    let script = "0 wake\n0.2 idle all\n0.2 dial stillness 0.2\n1 play nod 2 seed 7\n";
    fs::write(folder.path().join("script.txt"), script).expect("a writable folder");
    let line = "perform chako.kara --script script.txt --minutes 0.1 --tick-hz 100 --json";
    let counted = format!("{line} --target cortex-m4 --count");
    let outcome = Program::FirmwareSim.run(folder.path(), counted.split(' '));
    if outcome.code == Some(MISSING_TOOL) {
        skip(outcome.stderr.trim());
        return;
    }
    let summary = outcome.succeeded().json();
    let count = |name: &str| summary["chips"][0]["instructions_per_tick"][name].as_u64();
    let names = ["without_pose", "with_pose", "start_max"];
    let counts = names.map(|name| count(name).unwrap_or_else(|| panic!("{name}: {summary}")));
    assert!(counts.is_sorted() && counts[0] > 1000, "{counts:?}");
    assert!(count("resting") < count("mean") && count("mean") < count("with_pose"), "{summary}");
    assert!(count("without_pose") <= count("without_pose_max"), "{summary}");
    assert_eq!(summary["chips"][0]["differences"]["bits_differing"], 0, "{summary}");
    // Wrong requests are refused before anything is built.
    firmware_sim(folder.path(), "perform chako.kara --count").refused(2, &["--target"]);
    firmware_sim(folder.path(), "perform chako.kara --minutes 2 --target cortex-m4 --count")
        .refused(3, &["number of ticks is 6000", "3000"]);
}
