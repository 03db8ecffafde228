//! Puts the blob, the cases and the board's memory map where the program and the linker look for them.
//!
//! In:  the environment: `KARAKURI_WIDTH`, the number of activations of the widest layer; `KARAKURI_BLOB` and
//!      `KARAKURI_CASES`, paths, both or none; `KARAKURI_MEMORY`, a file name in `memory/` (default `mps2.x`).
//! Out: `width.rs`, `inputs.rs` and `memory.x` in `OUT_DIR`.
//!
//! Why here: `firmware_sim::firmware` sets what a program needs. Who builds by hand gets told what is missing; the
//! benchmarks need neither blob nor cases.

use std::{env, fs, path::Path};

const REMEDY: &str = "run `firmware-sim run model.kara`, which builds this program with its inputs";

fn main() {
    let out_dir = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let out_dir = Path::new(&out_dir);
    let width: usize = variable("KARAKURI_WIDTH")
        .unwrap_or_else(|| panic!("KARAKURI_WIDTH is not set; {REMEDY}"))
        .parse()
        .expect("KARAKURI_WIDTH is a number");
    let width =
        format!("/// Activations of the widest layer.\nconst WORKSPACE_WIDTH: usize = {width};\n");
    fs::write(out_dir.join("width.rs"), width).expect("OUT_DIR can be written");
    fs::write(out_dir.join("inputs.rs"), inputs()).expect("OUT_DIR can be written");

    println!("cargo:rerun-if-env-changed=KARAKURI_MEMORY");
    let map = env::var("KARAKURI_MEMORY").unwrap_or_else(|_| "mps2.x".to_owned());
    let map = format!("memory/{map}");
    println!("cargo:rerun-if-changed={map}");
    fs::copy(&map, out_dir.join("memory.x")).unwrap_or_else(|error| panic!("{map}: {error}"));
    println!("cargo:rustc-link-search={}", out_dir.display());
}

/// What `decode_cases` includes: its blob and cases, or why it has none.
fn inputs() -> String {
    let (Some(blob), Some(cases)) = (variable("KARAKURI_BLOB"), variable("KARAKURI_CASES")) else {
        let what = format!("KARAKURI_BLOB or KARAKURI_CASES is not set; {REMEDY}");
        return format!("compile_error!({what:?});");
    };
    let (blob_path, cases_path) = (input_path(&blob), input_path(&cases));
    format!(
        "/// The blob under test.\n\
         static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!({blob_path:?}));\n\
         /// Its cases, in the format of `case.rs`.\n\
         static CASES: &[u8] = include_bytes!({cases_path:?});\n"
    )
}

fn variable(name: &str) -> Option<String> {
    println!("cargo:rerun-if-env-changed={name}");
    env::var(name).ok()
}

/// An absolute path that `include_bytes!` in `OUT_DIR` can use.
fn input_path(path: &str) -> String {
    println!("cargo:rerun-if-changed={path}");
    let path = fs::canonicalize(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    path.to_str().expect("the path is UTF-8").to_owned()
}
