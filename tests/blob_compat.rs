//! Blobs that were shipped keep their promise: they load, and their motions stay what they were. A blob of a version
//! that is no longer read is refused by that name, never decoded.
//!
//! Why here: a device in the field cannot ask for another blob. The committed blobs are made once (`golden/README.md`
//! has the commands) and never again, unless the format gets a new version; then one old blob stays to be refused.

use firmware_sim::host::decode_cases;
use firmware_sim::parity::F16_TOLERANCE;
use karakuri::blob::VERSION_OLDEST;
use karakuri::{BlobError, Model, NumberFormat};
use tests::{
    FORMATS, GOLDEN_BLOBS, Motion, assert_golden, golden_blob, golden_path, host_trainer, motions,
    repository,
};

/// `host-trainer`'s exit code for a blob that is refused.
const BAD_BLOB: i32 = 5;

/// Flash that the smallest supported parts spare for a model.
const BLOB_BYTES_MAX: usize = 100_000;

/// Its weights lie in an order that no kernel reads; the user needs the run and one command.
#[test]
fn blob_of_version_one_is_refused_by_its_version() {
    let file = golden_path("version-1-w8a16.kara");
    let blob = std::fs::read(&file).expect("a committed blob");
    let older = BlobError::OlderVersion { found: 1, oldest: VERSION_OLDEST };
    assert_eq!(Model::from_bytes(&blob).err(), Some(older));
    let line = format!("inspect {}", file.display());
    let says = ["version-1-w8a16.kara", "version 1 is older than 2", "quantise the run again"];
    host_trainer(&repository(), &line).refused(BAD_BLOB, &says);
}

#[test]
fn committed_blobs_are_one_of_every_format() {
    assert_eq!(FORMATS, NumberFormat::ALL.map(NumberFormat::name));
    assert_eq!(FORMATS, GOLDEN_BLOBS.map(|(format, _)| format));
}

#[test]
fn committed_blobs_still_load() {
    for ((format, file), known) in GOLDEN_BLOBS.into_iter().zip(NumberFormat::ALL) {
        let blob = golden_blob(format);
        let model = Model::from_bytes(&blob).unwrap_or_else(|error| panic!("{file}: {error}"));
        assert_eq!((model.number_format(), format), (known, known.name()));
        assert_eq!((model.manifest().name, model.provenance().seed), ("creature", 7), "{file}");
        assert_eq!((model.rate_millihz(), model.channel_count()), (50_000, 11), "{file}");
        assert!(blob.len() <= BLOB_BYTES_MAX, "{file}: {} bytes", blob.len());
    }
}

/// The case list decoded by `model`, one row a pose.
fn pose_table(file: &str, model: &Model<'_>, motions: &[Motion]) -> String {
    let cases: Vec<_> = motions.iter().map(|motion| motion.case(model)).collect();
    let poses = decode_cases(model, &cases).expect("cases of trained motions");
    let mut table = format!(
        "{file}, Q15.16 in channel units\n{:<9} {:>6} {:>4} {:>10}",
        "action", "frames", "seed", "position"
    );
    for group in model.groups() {
        table += &format!(" {:>11}", group.name);
    }
    let positions = motions
        .iter()
        .zip(&cases)
        .flat_map(|(motion, case)| case.positions().map(move |at| (motion, at)));
    for ((motion, position), pose) in positions.zip(poses) {
        let Motion { action, frames, seed, .. } = motion;
        table += &format!("\n{action:<9} {frames:>6} {seed:>4} {:>10}", position.to_bits());
        for channel in pose {
            table += &format!(" {channel:>11}");
        }
    }
    table + "\n"
}

fn table_of(format: &str) -> String {
    let (_, file) =
        GOLDEN_BLOBS.into_iter().find(|(known, _)| *known == format).expect("a known format");
    let blob = golden_blob(format);
    pose_table(file, &Model::from_bytes(&blob).expect("a committed blob loads"), &motions())
}

#[test]
fn integer_poses_are_the_same_bits_on_every_machine_and_for_ever() {
    assert_golden("poses-w8a16.txt", &table_of("w8a16"));
    assert_golden("poses-w8a8.txt", &table_of("w8a8"));
    assert_golden("poses-w4a8.txt", &table_of("w4a8"));
}

/// Channel values of a table. // (pose, channel)
fn values(table: &str) -> Vec<Vec<f64>> {
    let row = |line: &str| {
        line.split_whitespace().skip(4).map(|cell| cell.parse().expect("a number")).collect()
    };
    table.lines().skip(2).map(row).collect()
}

/// Half precision rests on the machine's f32 arithmetic; it promises a share of each channel's travel.
#[test]
fn half_precision_poses_stay_within_the_promised_tolerance() {
    let now = table_of("f16");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        return assert_golden("poses-f16.txt", &now);
    }
    let committed =
        std::fs::read_to_string(golden_path("poses-f16.txt")).expect("a committed table");
    let (now, committed) = (values(&now), values(&committed));
    assert_eq!(
        (now.len(), now[0].len()),
        (committed.len(), committed[0].len()),
        "the table has another shape"
    );
    for channel in 0..now[0].len() {
        let column =
            |rows: &[Vec<f64>]| -> Vec<f64> { rows.iter().map(|row| row[channel]).collect() };
        let (now, committed) = (column(&now), column(&committed));
        let (min, max) =
            committed.iter().fold((f64::MAX, f64::MIN), |(min, max), v| (v.min(min), v.max(max)));
        let difference = now.iter().zip(&committed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let allowed = F16_TOLERANCE * (max - min);
        assert!(
            difference <= allowed,
            "channel {channel}: {difference} beyond {allowed} of 2^-16 units"
        );
    }
}

/// The case list stays worth its name: every action, short and long, whole and fractional positions.
#[test]
fn case_list_covers_every_action_and_fractional_positions() {
    let blob = golden_blob(FORMATS[0]);
    let model = Model::from_bytes(&blob).expect("a committed blob loads");
    let motions = motions();
    for action in model.actions() {
        assert!(motions.iter().any(|motion| motion.action == action), "no motion of {action}");
    }
    let cases: Vec<_> = motions.iter().map(|motion| motion.case(&model)).collect();
    let positions: Vec<u32> =
        cases.iter().flat_map(|case| case.positions()).map(|at| at.to_bits()).collect();
    assert!(positions.iter().any(|bits| bits & 0xffff != 0));
    assert!(positions.iter().any(|bits| bits & 0xffff == 0));
}
