//! Clip files that are not what they should be, through the command line: one line of error that says which file, which
//! place in it, what stands there, what should, and what to do; and not a byte written.

use std::fs;

use tests::{assert_refused, sandbox};

/// Exit codes of `host-trainer`.
const BAD_INPUT: i32 = 3;
const INPUT_OUTPUT: i32 = 4;

/// A folder with these files.
fn folder_of(files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let folder = sandbox();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a writable folder");
        fs::write(path, bytes).expect("a writable folder");
    }
    folder
}

/// A NumPy array as `numpy.save` writes it.
fn npy(dtype: &str, shape: &str, values: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}");
    let end = (10 + header.len() + 1).next_multiple_of(64);
    header += &" ".repeat(end - 10 - header.len() - 1);
    header.push('\n');
    let len = u16::try_from(header.len()).expect("a short header").to_le_bytes();
    [b"\x93NUMPY\x01\0", &len[..], header.as_bytes(), values].concat()
}

fn floats(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// Three frames of two joints.
fn good_npy() -> Vec<u8> {
    npy("<f4", "(3, 2, 3)", &floats((0..18).map(|value| value as f32)))
}

/// A folder of one good and one bad array.
fn with_bad_npy(bad: &[u8]) -> tempfile::TempDir {
    let labels = b"clip,action\ngood,walk\nbad,walk\n";
    folder_of(&[
        ("clips/good.npy", &good_npy()),
        ("clips/bad.npy", bad),
        ("clips/labels.csv", labels),
    ])
}

const TRAIN: &str = "train clips --out run --preset tiny --steps 3";
const TRAIN_NPY: &str = "train clips --fps 20 --out run --preset tiny --steps 3";

#[test]
fn npy_that_is_cut_or_empty_is_refused() {
    let whole = good_npy();
    for len in [0, 4, 9, 40, whole.len() - 72, whole.len() - 71, whole.len() - 1] {
        let folder = with_bad_npy(&whole[..len]);
        assert_refused(
            folder.path(),
            TRAIN_NPY,
            BAD_INPUT,
            &["clips/bad.npy", "expected", "export the clip again"],
        );
    }
}

#[test]
fn npy_of_the_wrong_type_or_shape_is_refused() {
    let integers = npy("<i4", "(3, 2, 3)", &[0; 72]);
    let says = ["clips/bad.npy", "dtype", "<i4", "f4 or f8", "astype"];
    assert_refused(with_bad_npy(&integers).path(), TRAIN_NPY, BAD_INPUT, &says);
    let more_joints = npy("<f4", "(3, 3, 3)", &floats((0..27).map(|value| value as f32)));
    let says =
        ["clips/bad.npy", "shape", "(3, 2, 3)", "(frames, 3, 3) as in clips/bad.npy", "separately"];
    assert_refused(with_bad_npy(&more_joints).path(), TRAIN_NPY, BAD_INPUT, &says[1..]);
    let flat = npy("<f4", "(18,)", &[0; 72]);
    assert_refused(
        with_bad_npy(&flat).path(),
        TRAIN_NPY,
        BAD_INPUT,
        &["clips/bad.npy", "shape", "(18)", "reshape"],
    );
}

#[test]
fn values_that_are_no_numbers_are_refused_by_frame_and_joint() {
    for (value, name) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf")] {
        let mut values = [0.0; 18];
        values[10] = value;
        let folder = with_bad_npy(&npy("<f4", "(3, 2, 3)", &floats(values)));
        let says =
            ["clips/bad.npy", "frame 1, joint01_y_m", name, "a finite number", "repair or remove"];
        assert_refused(folder.path(), TRAIN_NPY, BAD_INPUT, &says);
    }
}

#[test]
fn clip_of_one_frame_is_refused() {
    let folder = with_bad_npy(&npy("<f4", "(1, 2, 3)", &[0; 24]));
    let says = ["clips/bad.npy", "length", "1 frame", "at least 2 frames", "remove the file"];
    assert_refused(folder.path(), TRAIN_NPY, BAD_INPUT, &says);
}

#[test]
fn arrays_without_a_rate_are_refused() {
    let folder =
        folder_of(&[("clips/a.npy", &good_npy()), ("clips/labels.csv", b"clip,action\na,walk\n")]);
    assert_refused(
        folder.path(),
        TRAIN,
        BAD_INPUT,
        &["clips/a.npy", "rate", "unknown", "--fps RATE"],
    );
}

#[test]
fn clip_without_a_label_is_refused() {
    let files = [("clips/a.npy", good_npy()), ("clips/b.npy", good_npy())];
    let labels = b"clip,action\na,walk\n";
    let folder = folder_of(&[
        (files[0].0, &files[0].1),
        (files[1].0, &files[1].1),
        ("clips/labels.csv", labels),
    ]);
    let says = ["clips/b.npy", "label", "missing", "a row in labels.csv", "add the row"];
    assert_refused(folder.path(), TRAIN_NPY, BAD_INPUT, &says);
}

#[test]
fn broken_json_bvh_and_csv_are_refused_by_line() {
    let cases: [(&str, &[u8], &[&str]); 8] = [
        (
            "clips/nod/a.json",
            b"{\"time\":",
            &["content", "EOF", "set_target_data", "record or download"],
        ),
        (
            "clips/nod/a.json",
            b"{\"time\":[0, 1]}",
            &["content", "missing field `set_target_data`", "line 1"],
        ),
        (
            "clips/nod/a.bvh",
            b"HIERARCHY\nROOT hips\n{\n",
            &["line 3", "hips", "a closing brace", "export"],
        ),
        ("clips/nod/a.bvh", b"", &["expected", "HIERARCHY"]),
        (
            "clips/nod/a.csv",
            b"time_s,jaw_deg\n0,1\n0.1,2,3\n",
            &["table", "line: 3", "correct the line"],
        ),
        (
            "clips/nod/a.csv",
            b"time_s,jaw\n0,1\n0.1,2\n",
            &["header, column 2", "jaw", "<name>_<unit>", "rename"],
        ),
        (
            "clips/nod/a.csv",
            b"time_s,jaw_deg\n0,1\n0.1,x\n",
            &["line 3, column jaw_deg", "x", "a finite number"],
        ),
        ("clips/nod/a.csv", b"", &["header", "at least one <name>_<unit>", "add the header line"]),
    ];
    for (file, bytes, says) in cases {
        let folder = folder_of(&[(file, bytes)]);
        let line = format!("{TRAIN} --label-folder");
        assert_refused(folder.path(), &line, BAD_INPUT, &[&[file], says].concat());
    }
}

#[test]
fn folder_without_clips_and_path_without_anything_are_refused() {
    let folder = folder_of(&[("clips/notes.txt", b"none yet")]);
    assert_refused(
        folder.path(),
        TRAIN,
        BAD_INPUT,
        &["clips", "clip files (.npy, .bvh, .json, .csv)", "name the folder"],
    );
    assert_refused(folder.path(), "inspect nowhere", INPUT_OUTPUT, &["nowhere", "read"]);
}
