//! Builds the program that decodes a list of cases with a blob on a bare-metal target.
//!
//! In:  blob bytes, [`Case`]s, a [`Target`].
//! Out: [`Firmware`], an ELF file for `qemu.rs`.
//!
//! Why here: blob and cases are compiled in, as a product would do it, so alignment and flash size are proved too.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use karakuri::{Model, NumberFormat};
use tempfile::{NamedTempFile, TempPath};

use crate::case::Case;
use crate::error::{Error, Result};
use crate::target::Target;
use crate::toolchain::Toolchain;

/// Where the bare-metal workspace was when this crate was compiled.
const SOURCE_FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/cortex-m");
/// The program's name in that workspace.
const PROGRAM: &str = "decode_cases";
/// Lines of cargo's output that an error message keeps.
const LOG_LINES: usize = 30;

/// A program, ready to run; its file vanishes with this value.
#[derive(Debug)]
pub struct Firmware {
    elf: TempPath,
}

impl Firmware {
    /// Compiles blob and cases into a program for `target`, with the workspace and the arithmetic that the model needs.
    ///
    /// Two calls at a time wait for each other: they share the build folder.
    ///
    /// # Errors
    /// [`Error::MissingTool`] without a cross-compiler, [`Error::Build`] if it fails, [`Error::Io`].
    pub fn build(blob: &[u8], cases: &[Case], target: Target) -> Result<Self> {
        let model = Model::from_bytes(blob)?;
        let source = Path::new(SOURCE_FOLDER);
        if !source.join("Cargo.toml").is_file() {
            return Err(Error::bad_input(
                source,
                "folder",
                "missing",
                "the bare-metal workspace of karakuri's repository",
                "run firmware-sim from a checkout, with `cargo run -p firmware-sim`",
            ));
        }
        let toolchain = Toolchain::find(target, source)?;
        let folder = build_folder(target)?;
        let _lock = lock(&folder)?;
        let blob_path = store(folder.join("blob.kara"), blob)?;
        let cases: Vec<u8> = cases.iter().flat_map(Case::to_bytes).collect();
        let cases_path = store(folder.join("cases.bin"), &cases)?;
        // Without the feature the workspace has no room for floats, as in a product with an integer model.
        let features = if model.number_format() == NumberFormat::F16 { "f16" } else { "" };
        let output = toolchain
            .build_command()
            .args(["--bin", PROGRAM, "--features", features, "--target-dir"])
            .arg(&folder)
            .env("KARAKURI_BLOB", blob_path)
            .env("KARAKURI_CASES", cases_path)
            .env("KARAKURI_WIDTH", model.workspace_width().to_string())
            .env("KARAKURI_MEMORY", target.memory_map())
            .current_dir(source)
            .output()
            .map_err(Error::io("start cargo in", source))?;
        if !output.status.success() {
            let log = last_lines(&String::from_utf8_lossy(&output.stderr));
            return Err(Error::Build { target: target.name(), log });
        }
        let built = folder.join(target.triple()).join("release").join(PROGRAM);
        Ok(Self { elf: copy_away(&built)? })
    }

    /// The ELF file.
    pub fn elf(&self) -> &Path {
        &self.elf
    }
}

/// `target/firmware/<target>` of the host workspace.
fn build_folder(target: Target) -> Result<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/firmware");
    let folder = workspace.join(target.name());
    fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    fs::canonicalize(&folder).map_err(Error::io("find", &folder))
}

/// Holds until the returned file is dropped.
fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let file = File::create(&path).map_err(Error::io("create", &path))?;
    file.lock().map_err(Error::io("lock", &path))?;
    Ok(file)
}

/// Writes `bytes` unless they are there already: cargo rebuilds whatever has a newer date.
fn store(path: PathBuf, bytes: &[u8]) -> Result<PathBuf> {
    if fs::read(&path).is_ok_and(|stored| stored == bytes) {
        return Ok(path);
    }
    fs::write(&path, bytes).map_err(Error::io("write", &path))?;
    Ok(path)
}

/// The next build replaces its output, so a program keeps a copy for as long as it is used.
fn copy_away(built: &Path) -> Result<TempPath> {
    let copy = NamedTempFile::new().map_err(Error::io("create", std::env::temp_dir()))?;
    fs::copy(built, copy.path()).map_err(Error::io("copy", built))?;
    Ok(copy.into_temp_path())
}

fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(LOG_LINES)..].join("\n")
}
