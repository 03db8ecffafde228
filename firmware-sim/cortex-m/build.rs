//! Puts the blob, the cases and the board's memory map where the program and the linker look for them.
//!
//! In:  the environment: `KARAKURI_BLOB` and `KARAKURI_CASES`, paths (only for programs that include them);
//!      `KARAKURI_WIDTH`, the number of activations of the widest layer; `KARAKURI_MEMORY`, a file name in `memory/`
//!      (default `mps2.x`).
//! Out: `blob.rs`, `cases.rs` and `memory.x` in `OUT_DIR`.
//!
//! Why here: `firmware_sim::firmware` sets what a program needs. Who builds by hand gets told what is missing.

use std::{env, fs, path::Path};

/// What to do about a missing variable.
const REMEDY: &str = "run `firmware-sim run model.kara`, which builds this program with its inputs";

fn main() {
    let out_dir = variable("OUT_DIR");
    let out_dir = Path::new(&out_dir);
    let blob = including("KARAKURI_BLOB", blob);
    fs::write(out_dir.join("blob.rs"), blob).expect("OUT_DIR can be written");
    let cases = including("KARAKURI_CASES", cases);
    fs::write(out_dir.join("cases.rs"), cases).expect("OUT_DIR can be written");

    println!("cargo:rerun-if-env-changed=KARAKURI_MEMORY");
    let map = env::var("KARAKURI_MEMORY").unwrap_or_else(|_| "mps2.x".to_owned());
    let map = format!("memory/{map}");
    println!("cargo:rerun-if-changed={map}");
    fs::copy(&map, out_dir.join("memory.x")).unwrap_or_else(|error| panic!("{map}: {error}"));
    println!("cargo:rustc-link-search={}", out_dir.display());
}

/// Rust text about the file in a variable; without it, an error for who builds a program that includes the text.
fn including(name: &str, text: fn(&str) -> String) -> String {
    println!("cargo:rerun-if-env-changed={name}");
    match env::var(name) {
        Ok(path) => text(&input_path(&path)),
        Err(error) => format!("compile_error!(\"{name}: {error}; {REMEDY}\");\n"),
    }
}

fn blob(path: &str) -> String {
    let width: usize = variable("KARAKURI_WIDTH").parse().expect("KARAKURI_WIDTH is a number");
    format!(
        "/// The blob under test.\n\
         static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!({path:?}));\n\
         /// Activations of the widest layer.\n\
         const WORKSPACE_WIDTH: usize = {width};\n"
    )
}

fn cases(path: &str) -> String {
    format!(
        "/// Cases for the blob, in the format of `case.rs`.\n\
         static CASES: &[u8] = include_bytes!({path:?});\n"
    )
}

fn variable(name: &str) -> String {
    println!("cargo:rerun-if-env-changed={name}");
    env::var(name).unwrap_or_else(|error| panic!("{name}: {error}; {REMEDY}"))
}

/// An absolute path that `include_bytes!` in `OUT_DIR` can use.
fn input_path(path: &str) -> String {
    println!("cargo:rerun-if-changed={path}");
    let path = fs::canonicalize(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    path.to_str().expect("the path is UTF-8").to_owned()
}
