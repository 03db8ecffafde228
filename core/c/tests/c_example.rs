//! The C example, compiled by the machine's C compiler against the static library: the pulses that Rust makes.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use karakuri::{Decoder, Intent, Model, Player, ServoLimits, ServoMap, ServoStage, Workspace};
use karakuri_c::STORAGE_BYTES;

const TICK_US: u32 = 20_000;

fn package() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn blob_path() -> PathBuf {
    package().join("../../tests/golden/creature-tiny-w8a16.kara")
}

/// The newest static library beside this test.
fn library() -> PathBuf {
    let test = env::current_exe().expect("this test has a path");
    let folder = test.parent().expect("it lies in a folder");
    let entries = fs::read_dir(folder).expect("the folder of this test");
    let files = entries.map(|entry| entry.expect("an entry").path());
    let is_library = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        name.starts_with("libkarakuri_c") && name.ends_with(".a")
    };
    let written = |path: &PathBuf| fs::metadata(path).and_then(|file| file.modified()).ok();
    files.filter(is_library).max_by_key(written).expect("cargo has built the static library")
}

/// What the example prints; `None`, said aloud, where no C compiler is installed.
fn run_example(source: &Path, argument: &Path) -> Option<(bool, String)> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let program = folder.join(source.file_stem().expect("a name"));
    let mut cc = Command::new(env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-O1", "-I"]);
    cc.arg(package().join("include")).arg(source).arg(library());
    cc.args(["-lpthread", "-ldl", "-lm", "-o"]).arg(&program);
    let Ok(compiled) = cc.output() else {
        assert!(env::var_os("CI").is_none(), "CI is set, so nothing may be skipped");
        println!("SKIPPED: no C compiler");
        return None;
    };
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let ran = Command::new(&program).arg(argument).output().expect("it was just compiled");
    Some((ran.status.success(), String::from_utf8(ran.stdout).expect("text")))
}

/// What the example does, in Rust.
fn pulses_by_rust(blob: &[u8]) -> String {
    let model = Model::from_bytes(blob).expect("a golden");
    let mut workspace = Workspace::<256>::new();
    let decoder = Decoder::new(&model, &mut workspace).expect("wide enough");
    let limits = ServoLimits { pulse_us_per_s_max: 4000, pulse_us_per_s2_max: 40_000 };
    let servo = |channel, direction: i32, park_us| {
        let map = ServoMap::new(channel, [700, 1500, 2300], direction * (10 << 16), limits);
        map.and_then(|map| map.with_park_at(park_us)).expect("a sound calibration")
    };
    let servos = [servo(0, 1, 1500), servo(2, -1, 1400)];
    let stage = ServoStage::new(&servos).expect("two");
    let mut player = Player::<32>::new(&model, decoder, 1, stage, 7).expect("few channels");
    player.wake();
    let nod = model.action_by_name("nod").expect("it can nod");
    player.play(Intent::new(nod, 2000, 7)).expect("a trained length");
    let mut text = String::new();
    for _ in 0..150 {
        let pulses_us = player.tick(TICK_US).pulses_us();
        text += &format!("{},{}\n", pulses_us[0], pulses_us[1]);
    }
    text
}

#[repr(align(16))]
struct Aligned([u8; 65_536]);

#[test]
fn c_example_makes_the_pulses_that_rust_makes() {
    let bytes = fs::read(blob_path()).expect("a golden");
    let mut aligned = Aligned([0; 65_536]);
    aligned.0[..bytes.len()].copy_from_slice(&bytes);
    let source = package().join("examples/cmake/main.c");
    let Some((succeeded, printed)) = run_example(&source, &blob_path()) else { return };
    let expected = pulses_by_rust(&aligned.0[..bytes.len()]);
    assert!(expected.lines().collect::<std::collections::BTreeSet<_>>().len() > 30, "it moves");
    assert!(succeeded);
    assert_eq!(printed, expected);
}

#[test]
fn everything_that_c_can_do_wrong_has_a_status() {
    let source = package().join("tests/wrong_calls.c");
    let Some((succeeded, printed)) = run_example(&source, &blob_path()) else { return };
    assert!(succeeded, "{printed}");
}

#[test]
fn header_and_library_agree_about_sizes() {
    let header = fs::read_to_string(package().join("include/karakuri.h")).expect("the header");
    let define = format!("#define KARAKURI_STORAGE_BYTES {STORAGE_BYTES}\n");
    assert!(header.contains(&define));
    assert!(size_of::<karakuri_c::Body>() > STORAGE_BYTES * 2 / 3, "the storage is too generous");
}
