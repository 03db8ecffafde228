//! A small trained run that the tests of one program share.

use std::env;
use std::fs;
use std::path::PathBuf;
use std::sync::OnceLock;

use tempfile::TempDir;

use super::{host_trainer, sandbox};

/// Number formats by their names on the command line, in the order of `NumberFormat::ALL`.
pub const FORMATS: [&str; 4] = ["w8a16", "w8a8", "w4a8", "f16"];

/// The format that rests on floating point: no promise of the same bits.
pub const FLOAT_FORMAT: &str = "f16";

/// Settings of the runs that tests train: preset `tiny` with an end after seconds, and without phases, which no time
/// table can hold.
pub const QUICK_CONFIG: &str =
    "[decoder]\nhidden_widths = [32, 24]\nmodulation = \"gates\"\n[budget]\nsteps = 300\n";

/// The same with phases.
pub const TURNED_CONFIG: &str = "[decoder]\nhidden_widths = [32, 24]\n[budget]\nsteps = 300\n";

/// A trained run of the built-in character and its blobs.
#[derive(Debug)]
pub struct Trained {
    /// Holds everything below.
    pub folder: PathBuf,
    /// Clips.
    pub clips: PathBuf,
    /// The run.
    pub run: PathBuf,
}

impl Trained {
    /// The blob in a number format.
    pub fn blob(&self, format: &str) -> PathBuf {
        self.folder.join(format!("{format}.kara"))
    }
}

/// Trained once for each test program, by the commands that a user types; nobody may change it.
pub fn trained() -> &'static Trained {
    static TRAINED: OnceLock<Trained> = OnceLock::new();
    TRAINED.get_or_init(|| {
        let folder = own_folder();
        fs::write(folder.join("quick.toml"), QUICK_CONFIG).expect("a writable folder");
        host_trainer(&folder, "character --out clips --seed 7 --clips-per-action 4").succeeded();
        let train =
            "train clips --out creature --preset tiny --config quick.toml --seed 7 --threads 1";
        host_trainer(&folder, train).succeeded();
        for format in FORMATS {
            let quantize = format!("quantize creature --format {format} --out {format}.kara");
            host_trainer(&folder, &quantize).succeeded();
        }
        Trained { clips: folder.join("clips"), run: folder.join("creature"), folder }
    })
}

/// A folder with a run `turned`, whose frequencies follow the code too, beside the trained one.
pub fn workplace_with_phases() -> TempDir {
    let folder = workplace();
    fs::write(folder.path().join("turned.toml"), TURNED_CONFIG).expect("a writable folder");
    let train = "train clips --out turned --preset tiny --config turned.toml --seed 7 --threads 1";
    host_trainer(folder.path(), train).succeeded();
    folder
}

/// A new folder with links to the trained run, its clips and its blobs: `clips`, `creature`, `w8a16.kara`, ….
pub fn workplace() -> TempDir {
    let folder = sandbox();
    for entry in fs::read_dir(&trained().folder).expect("a trained run") {
        let entry = entry.expect("a trained run");
        let link = folder.path().join(entry.file_name());
        std::os::unix::fs::symlink(entry.path(), link).expect("a file system with links");
    }
    folder
}

/// An empty folder for the running test program. A static value is never dropped, so the folder is emptied at the next
/// start instead.
fn own_folder() -> PathBuf {
    let program = env::current_exe().expect("a running program");
    let stem = program.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    // Cargo ends the name with a hash of the build.
    let name = stem.rsplit_once('-').map_or(stem.as_str(), |(name, _)| name);
    let target = program.ancestors().nth(2).expect("target/<profile>/deps");
    let folder = target.join("karakuri-tests").join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).expect("an earlier test's folder can be emptied");
    }
    fs::create_dir_all(&folder).expect("a writable target folder");
    folder
}
