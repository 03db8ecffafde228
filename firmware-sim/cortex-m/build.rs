//! Puts the blob, the cases and the board's memory map where the program and the linker look for them.
//!
//! In:  the environment: `KARAKURI_BLOB` and `KARAKURI_CASES`, paths; `KARAKURI_WIDTH`, the number of activations of
//!      the widest layer; `KARAKURI_CHANNELS`, those of the model; `KARAKURI_MEMORY`, a file name in `memory/`
//!      (default `mps2.x`).
//! Out: `inputs.rs`, `width.rs`, `channels.rs` and `memory.x` in `OUT_DIR`.
//!
//! Why here: `firmware_sim::firmware` sets what a program needs. Who builds by hand gets told what is missing, by the
//! programs that need it: `decode_cases` all, the benchmarks the width, `check_kernels` nothing.

use std::{env, fs, path::Path};

fn main() {
    let out_dir = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let out_dir = Path::new(&out_dir);
    fs::write(out_dir.join("inputs.rs"), or_error(inputs())).expect("OUT_DIR can be written");
    fs::write(out_dir.join("width.rs"), or_error(width())).expect("OUT_DIR can be written");
    fs::write(out_dir.join("channels.rs"), or_error(channels())).expect("OUT_DIR can be written");

    println!("cargo:rerun-if-env-changed=KARAKURI_MEMORY");
    let map = env::var("KARAKURI_MEMORY").unwrap_or_else(|_| "mps2.x".to_owned());
    let map = format!("memory/{map}");
    println!("cargo:rerun-if-changed={map}");
    fs::copy(&map, out_dir.join("memory.x")).unwrap_or_else(|error| panic!("{map}: {error}"));
    println!("cargo:rustc-link-search={}", out_dir.display());
}

/// Rust text, or an error for who builds a program that includes it.
fn or_error(text: Result<String, String>) -> String {
    text.unwrap_or_else(|missing| {
        let remedy = "run `firmware-sim run model.kara` or `bench`, which build the programs";
        format!("compile_error!(\"{missing}; {remedy} with their inputs\");")
    })
}

/// What `decode_cases` decodes.
fn inputs() -> Result<String, String> {
    let blob_path = input_path(&variable("KARAKURI_BLOB")?);
    let cases_path = input_path(&variable("KARAKURI_CASES")?);
    Ok(format!(
        "/// The blob under test.\n\
         static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!({blob_path:?}));\n\
         /// Its cases, in the format of `case.rs`.\n\
         static CASES: &[u8] = include_bytes!({cases_path:?});\n"
    ))
}

/// The size of the workspace.
fn width() -> Result<String, String> {
    let width = variable("KARAKURI_WIDTH")?;
    let width: usize = width.parse().map_err(|error| format!("KARAKURI_WIDTH={width}: {error}"))?;
    let doc = "/// Activations of the widest layer.";
    Ok(format!("{doc}\nconst WORKSPACE_WIDTH: usize = {width};\n"))
}

/// The size of the player.
fn channels() -> Result<String, String> {
    let channels = variable("KARAKURI_CHANNELS")?;
    let channels: usize =
        channels.parse().map_err(|error| format!("KARAKURI_CHANNELS={channels}: {error}"))?;
    Ok(format!("/// Channels of the model.\nconst CHANNELS: usize = {channels};\n"))
}

fn variable(name: &str) -> Result<String, String> {
    println!("cargo:rerun-if-env-changed={name}");
    env::var(name).map_err(|error| format!("{name}: {error}"))
}

/// An absolute path that `include_bytes!` in `OUT_DIR` can use.
fn input_path(path: &str) -> String {
    println!("cargo:rerun-if-changed={path}");
    let path = fs::canonicalize(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    path.to_str().expect("the path is UTF-8").to_owned()
}
