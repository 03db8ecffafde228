//! Committed files: texts to compare with, blobs, and the motions that every engine decodes.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use firmware_sim::case::Case;
use karakuri::Model;
use serde::Deserialize;

/// A file of `tests/golden`.
pub fn golden_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden").join(name)
}

/// Compares with a committed text, or replaces it where `UPDATE_GOLDEN` is set.
#[track_caller]
pub fn assert_golden(name: &str, actual: &str) {
    let path = golden_path(name);
    if env::var_os("UPDATE_GOLDEN").is_some() {
        return fs::write(&path, actual).expect("a writable golden");
    }
    let expected = fs::read_to_string(&path).unwrap_or_default();
    if expected == actual {
        return;
    }
    let pairs = expected.lines().map(Some).chain(std::iter::repeat(None)).zip(actual.lines());
    let line = pairs.clone().position(|(expected, actual)| expected != Some(actual));
    let place = line.unwrap_or(actual.lines().count());
    panic!(
        "{name} is different from line {} on:\n golden: {}\n    now: {}\n\
         if the change is meant: UPDATE_GOLDEN=1 cargo test -p tests, and review the diff",
        place + 1,
        expected.lines().nth(place).unwrap_or("(its end)"),
        actual.lines().nth(place).unwrap_or("(its end)"),
    );
}

/// The committed blobs: one small model of the built-in character in every number format, in the order of `FORMATS`.
pub const GOLDEN_BLOBS: [(&str, &str); 4] = [
    ("w8a16", "creature-tiny-w8a16.kara"),
    ("w8a8", "creature-tiny-w8a8.kara"),
    ("w4a8", "creature-tiny-w4a8.kara"),
    ("f16", "creature-tiny-f16.kara"),
];

/// Bytes of the committed blob in a number format.
pub fn golden_blob(format: &str) -> Vec<u8> {
    let (_, name) =
        GOLDEN_BLOBS.iter().find(|(known, _)| *known == format).expect("a known format");
    fs::read(golden_path(name)).expect("a committed blob")
}

/// One motion of `tests/cases/poses.toml`, and the positions at which it is looked at; whole numbers only.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// Name of the action.
    pub action: String,
    /// Length in frames.
    pub frames: u32,
    /// Seed of the code.
    pub seed: u64,
    /// First position, Q16.16 frames.
    pub first_q16: u32,
    /// Distance of positions, Q16.16 frames.
    pub step_q16: u32,
    /// Number of positions.
    pub pose_count: u16,
}

impl Motion {
    /// The case as simulator and firmware take it.
    pub fn case(&self, model: &Model<'_>) -> Case {
        let action =
            model.action_by_name(&self.action).expect("cases name actions of the committed blobs");
        Case {
            action: action.0,
            pose_count: self.pose_count,
            frames: self.frames,
            seed: self.seed,
            first_bits: self.first_q16,
            step_bits: self.step_q16,
        }
    }
}

/// The case list that every engine decodes.
pub fn motions() -> Vec<Motion> {
    #[derive(Deserialize)]
    struct File {
        motion: Vec<Motion>,
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("cases").join("poses.toml");
    let text = fs::read_to_string(path).expect("the case list");
    toml::from_str::<File>(&text).expect("a case list of whole numbers").motion
}
