//! Bad input through the command lines: one line of error that says which file, which field, what stands there, what
//! should, and what to do; an exit code of its own; and not a byte changed on the disk.

use std::fs;
use std::path::Path;

use tests::{Program, contents, sandbox, trained, workplace};

/// Exit codes of both programs.
const WRONG_FLAGS: i32 = 2;
const BAD_INPUT: i32 = 3;
const INPUT_OUTPUT: i32 = 4;
const BAD_BLOB: i32 = 5;

const CHECKPOINT: &str = "creature/checkpoint.safetensors";

/// Runs `line` in `folder` ("sim …" is `firmware-sim`, everything else `host-trainer`): it must be refused with every
/// word of `says`, and the folder must stay as it was.
#[track_caller]
fn refused(folder: &Path, line: &str, code: i32, says: &[&str]) {
    let before = contents(folder);
    let (program, line) = match line.strip_prefix("sim ") {
        Some(line) => (Program::FirmwareSim, line),
        None => (Program::HostTrainer, line),
    };
    program.run(folder, line.split_whitespace()).refused(code, says);
    let after = contents(folder);
    let changed: Vec<_> =
        after.iter().filter(|(name, bytes)| before.get(*name) != Some(bytes)).collect();
    let names: Vec<_> = changed.iter().map(|(name, _)| name.display().to_string()).collect();
    assert!(names.is_empty(), "`{line}` was refused, but wrote {names:?}");
    assert_eq!(before.len(), after.len(), "`{line}` was refused, but removed files");
}

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
        refused(
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
    refused(with_bad_npy(&integers).path(), TRAIN_NPY, BAD_INPUT, &says);
    let more_joints = npy("<f4", "(3, 3, 3)", &floats((0..27).map(|value| value as f32)));
    let says =
        ["clips/bad.npy", "shape", "(3, 2, 3)", "(frames, 3, 3) as in clips/bad.npy", "separately"];
    refused(with_bad_npy(&more_joints).path(), TRAIN_NPY, BAD_INPUT, &says[1..]);
    let flat = npy("<f4", "(18,)", &[0; 72]);
    refused(
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
        refused(folder.path(), TRAIN_NPY, BAD_INPUT, &says);
    }
}

#[test]
fn clip_of_one_frame_is_refused() {
    let folder = with_bad_npy(&npy("<f4", "(1, 2, 3)", &[0; 24]));
    let says = ["clips/bad.npy", "length", "1 frame", "at least 2 frames", "remove the file"];
    refused(folder.path(), TRAIN_NPY, BAD_INPUT, &says);
}

#[test]
fn arrays_without_a_rate_are_refused() {
    let folder =
        folder_of(&[("clips/a.npy", &good_npy()), ("clips/labels.csv", b"clip,action\na,walk\n")]);
    refused(folder.path(), TRAIN, BAD_INPUT, &["clips/a.npy", "rate", "unknown", "--fps RATE"]);
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
    refused(folder.path(), TRAIN_NPY, BAD_INPUT, &says);
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
        refused(folder.path(), &line, BAD_INPUT, &[&[file], says].concat());
    }
}

#[test]
fn folder_without_clips_and_path_without_anything_are_refused() {
    let folder = folder_of(&[("clips/notes.txt", b"none yet")]);
    refused(
        folder.path(),
        TRAIN,
        BAD_INPUT,
        &["clips", "clip files (.npy, .bvh, .json, .csv)", "name the folder"],
    );
    refused(folder.path(), "inspect nowhere", INPUT_OUTPUT, &["nowhere", "read"]);
}

#[test]
fn configuration_with_an_unknown_key_or_value_is_refused() {
    let cases: [(&[u8], &[&str]); 4] = [
        (
            b"[decoder]\nhiden_widths = [3]\n",
            &["decoder.hiden_widths", "no known key", "hidden_widths", "spelling"],
        ),
        (
            b"[decoder]\nhidden_widths = \"3\"\n",
            &["decoder.hidden_widths", "\"3\"", "array", "correct the value"],
        ),
        (b"[adam]\nbeta1 = 1.5\n", &["adam.beta1", "1.5", "below 1", "correct"]),
        (b"decoder\n", &["line 1", "TOML", "correct the syntax"]),
    ];
    for (bytes, says) in cases {
        let folder = workplace();
        fs::write(folder.path().join("my.toml"), bytes).expect("a writable folder");
        let line = "train clips --out run --config my.toml";
        refused(folder.path(), line, BAD_INPUT, &[&["my.toml"], says].concat());
    }
}

#[test]
fn flags_that_no_run_can_have_are_refused() {
    let folder = workplace();
    let preset = ["--preset", "huge", "paper, published, small, tiny", "choose"];
    refused(folder.path(), "train clips --out run --preset huge", BAD_INPUT, &preset);
    refused(
        folder.path(),
        "train clips --out run --steps 0",
        BAD_INPUT,
        &["budget.steps", "0", "1 or more"],
    );
    refused(
        folder.path(),
        "train clips --out run --minutes=-1",
        BAD_INPUT,
        &["budget.minutes", "-1", "0 or more"],
    );
    let character = ["--clips-per-action", "0", "1 to 1000"];
    refused(folder.path(), "character --out new --clips-per-action 0", BAD_INPUT, &character);
    for line in [
        "train clips",
        "quantize creature --format w4 --out new.kara",
        "generate w8a16.kara --action nod --seconds 2 --count 0 --out new",
        "reconstruct creature clips --stride 0",
        "sim compare creature w8a16.kara --draw-poses 0",
    ] {
        refused(folder.path(), line, WRONG_FLAGS, &["--help"]);
    }
}

#[test]
fn unknown_action_is_refused_with_the_known_ones() {
    let folder = workplace();
    for source in ["creature", "w8a16.kara"] {
        let line = format!("generate {source} --action dance --seconds 2 --out new");
        let says = ["--action", "dance", "doze, greet, idle, laugh", "choose one of these"];
        refused(folder.path(), &line, BAD_INPUT, &says);
    }
    let trace = "sim trace w8a16.kara --action dance --seconds 2";
    refused(folder.path(), trace, BAD_INPUT, &["dance", "doze, greet, idle, laugh"]);
}

#[test]
fn duration_outside_training_is_refused_unless_clamped() {
    let folder = workplace();
    for source in ["creature", "w8a16.kara"] {
        for seconds in ["0.1", "20"] {
            let line = format!("generate {source} --action nod --seconds {seconds} --out new");
            let says = ["nod", seconds, "1.82 to 2.22 s", "--clamp"];
            refused(folder.path(), &line, BAD_INPUT, &says);
        }
        for nonsense in ["-1", "0", "NaN", "inf"] {
            let line = format!("generate {source} --action nod --seconds={nonsense} --out new");
            refused(folder.path(), &line, BAD_INPUT, &["--seconds", "a positive number"]);
        }
        let line =
            format!("generate {source} --action nod --seconds 20 --out {source}-clamped --clamp");
        let outcome = Program::HostTrainer.run(folder.path(), line.split(' ')).succeeded();
        assert!(outcome.stdout.contains("nod_2.22s"), "{outcome}");
    }
}

#[test]
fn results_are_replaced_only_with_force() {
    let folder = workplace();
    let path = folder.path();
    let run = |line: &str| Program::HostTrainer.run(path, line.split(' ')).succeeded();
    let cases = [
        ("quantize creature --format f16 --out f16.kara", "f16.kara"),
        ("character --clips-per-action 1 --out mine", "mine"),
        ("generate w8a8.kara --action nod --seconds 2 --count 2 --out motions --plot", "motions"),
    ];
    run(cases[1].0);
    run(cases[2].0);
    for (line, result) in cases {
        refused(path, line, BAD_INPUT, &[result, "there", "--force"]);
        run(&format!("{line} --force"));
    }
    refused(
        path,
        "train clips --out creature",
        BAD_INPUT,
        &["creature", "in use", "a new folder", "--resume"],
    );
    refused(path, "demo --out mine", BAD_INPUT, &["mine", "--out", "--force"]);
}

/// Whichever of several files is in the way, none is written.
#[test]
fn several_motions_are_written_all_or_none() {
    let line =
        "generate w8a8.kara --action nod --seconds 2 --seed 5 --count 3 --out motions --plot";
    for taken in ["nod_2.00s_seed5.csv", "nod_2.00s_seed7.csv", "nod_seed5.svg"] {
        let folder = workplace();
        fs::create_dir(folder.path().join("motions")).expect("a writable folder");
        fs::write(folder.path().join("motions").join(taken), "mine").expect("a writable folder");
        refused(folder.path(), line, BAD_INPUT, &[taken, "there already", "--force"]);
    }
}

/// A copy of the run in `broken`, with another checkpoint.
fn with_checkpoint(bytes: &[u8]) -> tempfile::TempDir {
    let folder = workplace();
    fs::create_dir(folder.path().join("broken")).expect("a writable folder");
    fs::write(folder.path().join("broken/checkpoint.safetensors"), bytes)
        .expect("a writable folder");
    folder
}

#[test]
fn damaged_checkpoint_is_refused_by_every_reader() {
    let whole = fs::read(trained().folder.join(CHECKPOINT)).expect("a checkpoint");
    for len in [0, 7, 1_000, whole.len() / 2, whole.len() - 1] {
        let folder = with_checkpoint(&whole[..len]);
        for line in [
            "quantize broken --format w8a16 --out new.kara",
            "generate broken --action nod --seconds 2 --out new",
            "reconstruct broken clips",
            "train clips --out broken --resume",
            "sim compare broken w8a16.kara",
        ] {
            let says = [
                "broken/checkpoint.safetensors",
                &format!("{len} bytes"),
                "expected",
                "train again",
            ];
            refused(folder.path(), line, BAD_INPUT, &says);
        }
    }
}

#[test]
fn damaged_blob_is_refused_by_every_reader() {
    let whole = fs::read(trained().blob("w8a16")).expect("a blob");
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 1;
    let mut newer = whole.clone();
    newer[4] += 1;
    let cases: [(&[u8], &str); 5] = [
        (b"", "0 bytes"),
        (b"no blob at all", "KRKR"),
        (&whole[..whole.len() - 1], "expected"),
        (&changed, "checksum"),
        (&newer, "version 2 is newer"),
    ];
    for (bytes, says) in cases {
        let folder = workplace();
        fs::write(folder.path().join("bad.kara"), bytes).expect("a writable folder");
        for line in [
            "inspect bad.kara",
            "generate bad.kara --action nod --seconds 2 --out new",
            "reconstruct creature clips --blob bad.kara",
            "sim run bad.kara",
            "sim compare creature bad.kara",
            "sim trace bad.kara --action nod --seconds 2",
        ] {
            refused(folder.path(), line, BAD_BLOB, &["bad.kara", says, "host-trainer quantize"]);
        }
    }
}

#[test]
fn things_that_do_not_belong_together_are_refused() {
    let folder = workplace();
    let run = |line: &str| Program::HostTrainer.run(folder.path(), line.split(' ')).succeeded();
    run("character --out others --seed 8 --clips-per-action 4");
    run("train others --out stranger --preset tiny --config quick.toml --steps 2");
    let dataset = ["others", "the dataset", "another one than the run's", "the same folder"];
    refused(folder.path(), "reconstruct creature others", BAD_INPUT, &dataset);
    let resume = "train others --out creature --resume";
    refused(
        folder.path(),
        resume,
        BAD_INPUT,
        &["creature", "dataset", "as when the run began", "restore the clips"],
    );
    let config = "train clips --out creature --preset tiny --config quick.toml --seed 8 --resume";
    refused(
        folder.path(),
        config,
        BAD_INPUT,
        &["creature", "seed = 8", "seed = 7", "repeat the flags"],
    );
    let says = ["w8a16.kara", "stranger", "the run that it was quantized from"];
    refused(folder.path(), "sim compare stranger w8a16.kara", BAD_INPUT, &says);
}
