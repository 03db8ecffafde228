//! From what a builder measured to a blob that carries it, by the commands that a builder types.

use std::fs;

use karakuri::{Model, ServoStage};
use tests::{Outcome, assert_refused, firmware_sim, host_trainer, repository, trained, workplace};

/// `host-trainer`'s exit codes.
const LIMITS_EXCEEDED: i32 = 1;
const BAD_INPUT: i32 = 3;

/// The built-in character's own file.
fn chako() -> String {
    let path = repository().join("host-trainer/calibrations/chako.toml");
    fs::read_to_string(path).expect("a committed calibration")
}

#[test]
fn unusable_calibration_is_refused_and_nothing_is_written() {
    let cases: [(&str, &str, &[&str]); 4] = [
        ("max_us = 2050", "max_us = 900", &["servo body_yaw", "950, 1500 and 900", "swap"]),
        ("channel = \"jaw\"", "channel = \"chin\"", &["channel is chin", "jaw"]),
        ("park_us = 1600", "park_us = 2500", &["servo arm_left, park_us is 2500", "1250 to 2450"]),
        (
            "acceleration_deg_per_s2 = 4000",
            "acceleration_deg_per_s2 = 100",
            &["servo body_yaw", "4500 us to stop", "1100 us"],
        ),
    ];
    for (good, bad, says) in cases {
        let folder = workplace();
        fs::write(folder.path().join("robot.toml"), chako().replacen(good, bad, 1))
            .expect("a writable folder");
        let says = [&["robot.toml"], says].concat();
        for line in [
            "calibrate w8a16.kara --calibration robot.toml --out new.kara",
            "quantize creature --calibration robot.toml --out new.kara",
            "check clips --calibration robot.toml",
        ] {
            assert_refused(folder.path(), line, BAD_INPUT, &says);
        }
    }
}

#[test]
fn template_becomes_part_of_the_blob_and_drives_the_trace() {
    let folder = workplace();
    for (model, out) in [("w8a16.kara", "robot.toml"), ("creature", "of_run.toml")] {
        host_trainer(folder.path(), &format!("calibrate {model} --template --out {out}"))
            .succeeded();
    }
    let texts = ["robot.toml", "of_run.toml"].map(|name| fs::read(folder.path().join(name)).ok());
    assert!(texts[0].is_some() && texts[0] == texts[1]);
    let line = "calibrate w8a16.kara --calibration robot.toml --out robot.kara";
    host_trainer(folder.path(), line).succeeded();
    let blob = fs::read(folder.path().join("robot.kara")).expect("a blob");
    let model = Model::from_bytes(&blob).expect("a calibrated blob");
    assert_eq!((model.servos().count(), model.groups().count()), (11, 11));
    assert!(ServoStage::from_maps(model.servos()).is_ok());
    let trace = "trace robot.kara --action nod --seconds 2 --clamp --json";
    let own = firmware_sim(folder.path(), trace).succeeded().json();
    assert_eq!(own["servos"][0]["pulses_us"], serde_json::json!([1000, 1500, 2000]));
    let stand_in = firmware_sim(folder.path(), &format!("{trace} --stand-in")).succeeded().json();
    assert_eq!(stand_in["servos"][0]["pulses_us"], serde_json::json!([500, 1500, 2500]));
}

#[test]
fn quantizing_with_a_calibration_is_calibrating_what_was_quantized() {
    let folder = workplace();
    fs::write(folder.path().join("robot.toml"), chako()).expect("a writable folder");
    for line in [
        "quantize creature --calibration robot.toml --out at_once.kara",
        "calibrate w8a16.kara --calibration robot.toml --out later.kara",
        "calibrate later.kara --calibration robot.toml --out again.kara",
    ] {
        host_trainer(folder.path(), line).succeeded();
    }
    let blobs = ["at_once.kara", "later.kara", "again.kara"]
        .map(|name| fs::read(folder.path().join(name)).expect("a blob"));
    assert!(blobs[0] == blobs[1] && blobs[1] == blobs[2]);
    let report = host_trainer(folder.path(), "inspect later.kara --json").succeeded().json();
    assert_eq!(report["servo_count"], 11);
}

#[test]
fn check_names_what_a_slower_robot_cannot_do_and_at_which_rate_it_could() {
    let folder = workplace();
    let robot = folder.path().join("robot.toml");
    fs::write(&robot, chako()).expect("a writable folder");
    let line = "check clips --calibration robot.toml";
    let fits = host_trainer(folder.path(), line).succeeded();
    assert!(fits.stdout.starts_with("0 of 40 clips exceed a limit"), "{fits}");
    let slow = chako().replace("speed_deg_per_s = 480", "speed_deg_per_s = 100");
    fs::write(&robot, slow).expect("a writable folder");
    let people = host_trainer(folder.path(), line);
    assert_eq!(people.code, Some(LIMITS_EXCEEDED), "{people}");
    assert!(people.stdout.contains("eyelid") && people.stdout.contains("us/s"), "{people}");
    let outcome: Outcome = host_trainer(folder.path(), &format!("{line} --json"));
    assert_eq!(outcome.code, Some(LIMITS_EXCEEDED), "{outcome}");
    let report = outcome.json();
    let slowest = report["rate_max"].as_f64().expect("a rate");
    assert!((0.2..1.0).contains(&slowest), "{slowest}");
    let excess = &report["clips"][0]["excesses"][0];
    assert!(excess["asked"].as_f64() > excess["allowed"].as_f64(), "{excess}");
    assert!(trained().folder.exists());
}
