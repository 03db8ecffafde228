//! Bad input through the command lines: one line of error that says which file, which field, what stands there, what
//! should, and what to do; an exit code of its own; and not a byte changed on the disk.

use std::fs;

use tests::{
    Program, assert_refused, golden_path, host_trainer, trained, workplace, workplace_with_phases,
};

/// Exit codes of both programs.
const WRONG_FLAGS: i32 = 2;
const BAD_INPUT: i32 = 3;
const BAD_BLOB: i32 = 5;

const CHECKPOINT: &str = "creature/checkpoint.safetensors";

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
        assert_refused(folder.path(), line, BAD_INPUT, &[&["my.toml"], says].concat());
    }
}

#[test]
fn flags_that_no_run_can_have_are_refused() {
    let folder = workplace();
    let preset = ["--preset", "huge", "paper, published, small, tiny", "choose"];
    assert_refused(folder.path(), "train clips --out run --preset huge", BAD_INPUT, &preset);
    assert_refused(
        folder.path(),
        "train clips --out run --steps 0",
        BAD_INPUT,
        &["budget.steps", "0", "1 or more"],
    );
    assert_refused(
        folder.path(),
        "train clips --out run --minutes=-1",
        BAD_INPUT,
        &["budget.minutes", "-1", "0 or more"],
    );
    let character = ["--clips-per-action", "0", "1 to 1000"];
    assert_refused(
        folder.path(),
        "character --out new --clips-per-action 0",
        BAD_INPUT,
        &character,
    );
    for line in [
        "train clips",
        "quantize creature --format w4 --out new.kara",
        "quantize creature --packing columns --out new.kara",
        "quantize creature --time-table=-1 --out new.kara",
        "quantize creature --time-table 65536 --out new.kara",
        "quantize creature --time-table 2s --out new.kara",
        "generate w8a16.kara --action nod --seconds 2 --count 0 --out new",
        "reconstruct creature clips --stride 0",
        "sim compare creature w8a16.kara --draw-poses 0",
    ] {
        assert_refused(folder.path(), line, WRONG_FLAGS, &["--help"]);
    }
}

/// Binary16 blobs compute every frame.
#[test]
fn time_table_of_a_run_with_phases_is_refused() {
    let folder = workplace_with_phases();
    let outcome = host_trainer(folder.path(), "quantize turned --time-table 60 --out new.kara");
    outcome.refused(3, &["--time-table", "gates-and-phases", "modulation = \"gates\""]);
}

#[test]
fn time_table_without_integers_is_refused() {
    let folder = workplace();
    let line = "quantize creature --format f16 --time-table 60 --out new.kara";
    let says = ["--time-table", "f16", "an integer format", "leave --time-table away"];
    assert_refused(folder.path(), line, BAD_INPUT, &says);
}

#[test]
fn unknown_action_is_refused_with_the_known_ones() {
    let folder = workplace();
    for source in ["creature", "w8a16.kara"] {
        let line = format!("generate {source} --action dance --seconds 2 --out new");
        let says = ["--action", "dance", "doze, greet, idle, laugh", "choose one of these"];
        assert_refused(folder.path(), &line, BAD_INPUT, &says);
    }
    let trace = "sim trace w8a16.kara --action dance --seconds 2";
    assert_refused(folder.path(), trace, BAD_INPUT, &["dance", "doze, greet, idle, laugh"]);
}

#[test]
fn duration_outside_training_is_refused_unless_clamped() {
    let folder = workplace();
    for source in ["creature", "w8a16.kara"] {
        for seconds in ["0.1", "20"] {
            let line = format!("generate {source} --action nod --seconds {seconds} --out new");
            let says = ["nod", seconds, "1.82 to 2.22 s", "--clamp"];
            assert_refused(folder.path(), &line, BAD_INPUT, &says);
        }
        for nonsense in ["-1", "0", "NaN", "inf"] {
            let line = format!("generate {source} --action nod --seconds={nonsense} --out new");
            assert_refused(folder.path(), &line, BAD_INPUT, &["--seconds", "a positive number"]);
        }
        let line =
            format!("generate {source} --action nod --seconds 20 --out {source}-clamped --clamp");
        let outcome = host_trainer(folder.path(), &line).succeeded();
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
        assert_refused(path, line, BAD_INPUT, &[result, "there", "--force"]);
        run(&format!("{line} --force"));
    }
    assert_refused(
        path,
        "train clips --out creature",
        BAD_INPUT,
        &["creature", "in use", "a new folder", "--resume"],
    );
    assert_refused(path, "demo --out mine", BAD_INPUT, &["mine", "--out", "--force"]);
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
        assert_refused(folder.path(), line, BAD_INPUT, &[taken, "there already", "--force"]);
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
            assert_refused(folder.path(), line, BAD_INPUT, &says);
        }
    }
}

#[test]
fn damaged_blob_is_refused_by_every_reader() {
    let whole = fs::read(trained().blob("w8a16")).expect("a blob");
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 1;
    let mut newer = whole.clone();
    newer[4] = 4;
    let older = fs::read(golden_path("version-1-w8a16.kara")).expect("a committed blob");
    let cases: [(&[u8], &str); 6] = [
        (b"", "0 bytes"),
        (b"no blob at all", "KRKR"),
        (&whole[..whole.len() - 1], "expected"),
        (&changed, "checksum"),
        (&newer, "version 4 is newer"),
        (
            &older,
            "version 1 is older than 2, the oldest that is understood: quantise the run again",
        ),
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
            assert_refused(
                folder.path(),
                line,
                BAD_BLOB,
                &["bad.kara", says, "host-trainer quantize"],
            );
        }
    }
}

#[test]
fn things_that_do_not_belong_together_are_refused() {
    let folder = workplace();
    let run = |line: &str| host_trainer(folder.path(), line).succeeded();
    run("character --out others --seed 8 --clips-per-action 4");
    run("train others --out stranger --preset tiny --config quick.toml --steps 2");
    let dataset = ["others", "the dataset", "another one than the run's", "the same folder"];
    assert_refused(folder.path(), "reconstruct creature others", BAD_INPUT, &dataset);
    let resume = "train others --out creature --resume";
    assert_refused(
        folder.path(),
        resume,
        BAD_INPUT,
        &["creature", "dataset", "as when the run began", "restore the clips"],
    );
    let config = "train clips --out creature --preset tiny --config quick.toml --seed 8 --resume";
    assert_refused(
        folder.path(),
        config,
        BAD_INPUT,
        &["creature", "seed = 8", "seed = 7", "repeat the flags"],
    );
    let says = ["w8a16.kara", "stranger", "the run that it was quantized from"];
    assert_refused(folder.path(), "sim compare stranger w8a16.kara", BAD_INPUT, &says);
}
