//! Builds the bare-metal programs.
//!
//! In:  a [`Target`], and what the program needs: blob and [`Case`]s, or a number format and a width.
//! Out: [`Firmware`], an ELF file for `qemu.rs`.
//!
//! Why here: for the parity proof, blob and cases are compiled in, as a product would do it, so alignment and flash
//! size are proved too. The benchmarks find any blob in a partition of its own, so one build serves every network.

use std::ffi::OsStr;
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
/// Lines of cargo's output that an error message keeps.
const LOG_LINES: usize = 30;
/// Bytes in front of a blob in its partition: its length as u32, then zeros.
const PARTITION_HEADER_BYTES: usize = 16;

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
        let workshop = Workshop::open(target)?;
        let blob_path = store(workshop.folder.join("blob.kara"), blob)?;
        let cases: Vec<u8> = cases.iter().flat_map(Case::to_bytes).collect();
        let cases_path = store(workshop.folder.join("cases.bin"), &cases)?;
        let inputs =
            [("KARAKURI_BLOB", blob_path.as_os_str()), ("KARAKURI_CASES", cases_path.as_os_str())];
        let format = model.number_format();
        let [program] =
            workshop.build(["decode_cases"], format, model.workspace_width(), &inputs)?;
        Ok(program)
    }

    /// Compiles blob, stint and cues into a program that performs on `target`.
    ///
    /// # Errors
    /// As [`build`](Self::build).
    pub fn build_performer(blob: &[u8], performance: &[u8], target: Target) -> Result<Self> {
        let model = Model::from_bytes(blob)?;
        let workshop = Workshop::open(target)?;
        let blob_path = store(workshop.folder.join("blob.kara"), blob)?;
        let cases_path = store(workshop.folder.join("performance.bin"), performance)?;
        let channels = model.channel_count().to_string();
        let inputs = [
            ("KARAKURI_BLOB", blob_path.as_os_str()),
            ("KARAKURI_CASES", cases_path.as_os_str()),
            ("KARAKURI_CHANNELS", OsStr::new(&channels)),
        ];
        let format = model.number_format();
        let [program] = workshop.build(["perform"], format, model.workspace_width(), &inputs)?;
        Ok(program)
    }

    /// The ELF file.
    pub fn elf(&self) -> &Path {
        &self.elf
    }
}

/// The programs of a benchmark, for every blob of one number format.
#[derive(Debug)]
pub struct BenchmarkFirmware {
    /// Counts the steps of a motion.
    pub counter: Firmware,
    /// The smallest product: its size counts.
    pub minimal: Firmware,
    /// What the compiler says about its version; counts depend on it.
    pub compiler: String,
}

impl BenchmarkFirmware {
    /// Compiles the programs for `target` with the arithmetic of `format` and a workspace of `width`.
    ///
    /// # Errors
    /// As [`Firmware::build`].
    pub fn build(format: NumberFormat, width: usize, target: Target) -> Result<Self> {
        let workshop = Workshop::open(target)?;
        let programs = ["count_instructions", "minimal"];
        let [counter, minimal] = workshop.build(programs, format, width, &[])?;
        let compiler = workshop.toolchain.compiler(workshop.source)?;
        Ok(Self { counter, minimal, compiler })
    }
}

/// What the benchmarks' programs expect in the partition of the blob; see `cortex-m/src/blob_partition.rs`.
pub fn partition_bytes(blob: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; PARTITION_HEADER_BYTES];
    bytes[..4].copy_from_slice(&(blob.len() as u32).to_le_bytes());
    bytes.extend_from_slice(blob);
    bytes
}

/// Everything that a build needs, for one user at a time.
struct Workshop {
    target: Target,
    source: &'static Path,
    toolchain: Toolchain,
    folder: PathBuf,
    _lock: File,
}

impl Workshop {
    fn open(target: Target) -> Result<Self> {
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
        let folder = build_folder(target.name())?;
        let lock = lock(&folder)?;
        Ok(Self { target, source, toolchain, folder, _lock: lock })
    }

    fn build<const COUNT: usize>(
        &self,
        programs: [&str; COUNT],
        format: NumberFormat,
        width: usize,
        inputs: &[(&str, &OsStr)],
    ) -> Result<[Firmware; COUNT]> {
        let output = self
            .toolchain
            .build_command()
            .args(programs.iter().flat_map(|program| ["--bin", program]))
            .args(["--no-default-features", "--features", format.name(), "--target-dir"])
            .arg(&self.folder)
            .envs(inputs.iter().copied())
            .env("KARAKURI_WIDTH", width.to_string())
            .env("KARAKURI_MEMORY", self.target.memory_map())
            .current_dir(self.source)
            .output()
            .map_err(Error::io("start cargo in", self.source))?;
        if !output.status.success() {
            let log = last_lines(&String::from_utf8_lossy(&output.stderr));
            return Err(Error::Build { target: self.target.name(), log });
        }
        let release = self.folder.join(self.target.triple()).join("release");
        let copies = programs.map(|program| copy_away(&release.join(program)));
        let copies = copies.into_iter().collect::<Result<Vec<_>>>()?;
        let programs: Vec<_> = copies.into_iter().map(|elf| Firmware { elf }).collect();
        Ok(programs.try_into().expect("as many programs as names"))
    }
}

/// `target/firmware/<name>` of the host workspace.
pub(crate) fn build_folder(name: &str) -> Result<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/firmware");
    let folder = workspace.join(name);
    fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    fs::canonicalize(&folder).map_err(Error::io("find", &folder))
}

/// Keeps others out until the returned file is dropped.
pub(crate) fn lock(folder: &Path) -> Result<File> {
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
pub(crate) fn copy_away(built: &Path) -> Result<TempPath> {
    let copy = NamedTempFile::new().map_err(Error::io("create", std::env::temp_dir()))?;
    fs::copy(built, copy.path()).map_err(Error::io("copy", built))?;
    Ok(copy.into_temp_path())
}

fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(LOG_LINES)..].join("\n")
}
