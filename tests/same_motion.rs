//! Choices of `quantize` that change where numbers lie, not what a motion is: order of weights, time table. And two
//! poses a pass are the poses of two passes.
//!
//! Why here: `core` has unit tests on a model of a few rows; this is a trained run, by the commands that a user types.

use std::fs;
use std::path::Path;

use firmware_sim::case::Case;
use firmware_sim::host::decode_cases;
use karakuri::manifest::{Packing, TIME_LAYER};
use karakuri::{
    ActionId, BlobError, FramePosition, Model, PairDecoder, PairWorkspace, Pcg32, Pose,
};
use tests::{FLOAT_FORMAT, FORMATS, golden_blob, host_trainer, workplace};

/// Frames of the time tables below; every action is longer.
const TABLE_FRAMES: u16 = 60;

/// Largest difference in degrees that a time table may make, by format: double of what was measured (0.011, 0.386,
/// 0.386), because training differs from machine to machine. With 8-bit activations a product that is rounded
/// otherwise can move one of them to the next of 255 steps.
const TABLE_ERRORS_MAX_DEG: [(&str, f64); 3] = [("w8a16", 0.03), ("w8a8", 0.8), ("w4a8", 0.8)];

/// The blob that `quantize` writes with these flags.
fn quantized(folder: &Path, flags: &str) -> Vec<u8> {
    let line = format!("quantize creature {flags} --out quantized.kara --force");
    host_trainer(folder, &line).succeeded();
    fs::read(folder.join("quantized.kara")).expect("a blob")
}

/// Poses of every action, at positions `step_q16` apart.
fn poses(blob: &[u8], first_q16: u32, step_q16: u32, pose_count: u16) -> Vec<Vec<i32>> {
    let model = Model::from_bytes(blob).expect("a blob of quantize loads");
    let case = |action| Case {
        action,
        pose_count,
        frames: *model.trained_frames(ActionId(action)).start(),
        seed: 7 + u64::from(action),
        first_bits: first_q16,
        step_bits: step_q16,
    };
    let cases: Vec<Case> = (0..model.manifest().action_count).map(case).collect();
    decode_cases(&model, &cases).expect("trained lengths")
}

#[test]
fn rows_and_tiles_are_the_same_motion() {
    let folder = workplace();
    for format in FORMATS {
        let blobs = ["tiles", "rows"].map(|packing| {
            quantized(folder.path(), &format!("--format {format} --packing {packing}"))
        });
        let packings = blobs.each_ref().map(|blob| {
            Model::from_bytes(blob).expect("a blob of quantize loads").manifest().packing
        });
        assert_eq!(packings, [Packing::Tiles, Packing::Rows], "{format}");
        let [tiles, rows] = blobs.map(|blob| poses(&blob, 0, 0x2_3456, 40));
        assert!(tiles == rows, "{format}");
    }
}

#[test]
fn time_table_of_no_frames_is_none() {
    let folder = workplace();
    for format in FORMATS {
        let [without, none] = ["", "--time-table 0"]
            .map(|flag| quantized(folder.path(), &format!("--format {format} {flag}")));
        assert!(without == none, "{format}");
    }
}

#[test]
fn time_table_changes_whole_frames_by_its_rounding_and_nothing_else() {
    let folder = workplace();
    let mut table = "format  poses  RMS deg  max deg\n".to_owned();
    for (format, error_max_deg) in TABLE_ERRORS_MAX_DEG {
        let flags = format!("--format {format}");
        let without = quantized(folder.path(), &flags);
        let with = quantized(folder.path(), &format!("{flags} --time-table {TABLE_FRAMES}"));
        assert_eq!(with.len(), without.len() + table_bytes(&with), "{format}");

        let [computed, looked_up] =
            [&without, &with].map(|blob| poses(blob, 0, 1 << 16, TABLE_FRAMES));
        let values = computed.iter().flatten().zip(looked_up.iter().flatten());
        let errors: Vec<f64> = values.map(|(a, b)| f64::from(a.abs_diff(*b)) / 65_536.0).collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let max = errors.iter().copied().fold(0.0, f64::max);
        table += &format!("{format:<6} {:>6} {rms:>8.5} {max:>8.5}\n", computed.len());
        assert!(max > 0.0, "{format}: the table is not used");
        assert!(max <= error_max_deg, "{format}: at most {error_max_deg}\n{table}");

        let between = [&without, &with].map(|blob| poses(blob, 0x8000, 1 << 16, TABLE_FRAMES));
        assert!(between[0] == between[1], "{format}: between whole frames");
        let first_behind = u32::from(TABLE_FRAMES) << 16;
        let behind = [&without, &with].map(|blob| poses(blob, first_behind, 1 << 16, 4));
        assert!(behind[0] == behind[1], "{format}: behind the table");
    }
    println!("{table}");
}

/// Bytes of the time table as stored.
fn table_bytes(blob: &[u8]) -> usize {
    let model = Model::from_bytes(blob).expect("a blob of quantize loads");
    let manifest = model.manifest();
    assert_eq!(manifest.time_table_frames, TABLE_FRAMES);
    let bytes = 2 * usize::from(TABLE_FRAMES) * manifest.layers[TIME_LAYER].rows_filled();
    bytes.next_multiple_of(karakuri::blob::ALIGNMENT)
}

#[test]
fn pair_of_a_format_without_pair_kernels_is_refused() {
    for format in ["w4a8", FLOAT_FORMAT] {
        let blob = golden_blob(format);
        let model = Model::from_bytes(&blob).expect("a committed blob loads");
        let mut workspace = Box::<PairWorkspace<256>>::default();
        let error = PairDecoder::new(&model, &mut workspace).err();
        assert_eq!(error, Some(BlobError::NoPairKernel(model.number_format())));
    }
}

#[test]
fn pair_of_poses_is_the_bits_of_two_poses() {
    for format in ["w8a16", "w8a8"] {
        let blob = golden_blob(format);
        let singles = poses(&blob, 0, 0x2_3456, 40);
        let model = Model::from_bytes(&blob).expect("a committed blob loads");
        let mut workspace = Box::<PairWorkspace<256>>::default();
        let mut decoder = PairDecoder::new(&model, &mut workspace).expect("tiles of 8-bit weights");
        let mut pairs = Vec::new();
        for action in (0..model.manifest().action_count).map(ActionId) {
            let mut rng = Pcg32::new(7 + u64::from(action.0));
            let frames = *model.trained_frames(action).start();
            let code = model.sample(action, frames, &mut || rng.next_u32());
            decoder.start(&code.expect("a trained length"));
            for index in (0..40).step_by(2) {
                let at = |index: u32| FramePosition::from_bits(index * 0x2_3456);
                let mut both = [Pose::new(), Pose::new()];
                decoder.decode([at(index), at(index + 1)], &mut both);
                pairs.extend(both.map(|pose| pose.channels().to_vec()));
            }
        }
        assert!(pairs == singles, "{format}");
    }
}
