//! The small vocabulary that the tests speak: programs and what they answer, a trained run, goldens, skipping.
//!
//! Why here: a test should read as a sentence and a table; how a process is started stands here, once.

use std::collections::BTreeMap;
use std::env;
use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use firmware_sim::case::Case;
use karakuri::Model;
use serde::Deserialize;
use tempfile::TempDir;

/// Number formats by their names on the command line.
pub const FORMATS: [&str; 3] = ["w8a16", "w8a8", "f16"];

/// Root of the repository.
pub fn repository() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    fs::canonicalize(root).expect("the repository that these tests were compiled in")
}

/// Says, past the test harness's capture, that a test proves nothing on this machine; in continuous integration
/// (`CI` is set) that is a failure.
pub fn skip(reason: &str) {
    assert!(env::var_os("CI").is_none(), "skipping is not allowed where CI is set: {reason}");
    // The note is a courtesy; without standard error there is nobody to read it.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
}

/// A folder of `shared/data` beside the repository; skips where the data is not.
pub fn shared(name: &str) -> Option<PathBuf> {
    let folder = repository().join("../shared/data").join(name);
    if !folder.is_dir() {
        skip(&format!("{} is not on this machine", folder.display()));
        return None;
    }
    Some(folder)
}

/// Every file that git tracks or would add, with slashes, from the root of the repository.
pub fn repository_files() -> Vec<String> {
    let list = ["ls-files", "--cached", "--others", "--exclude-standard"];
    let output = Command::new("git")
        .args(list)
        .current_dir(repository())
        .output()
        .expect("git is installed");
    assert!(
        output.status.success(),
        "not a git repository: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let text = String::from_utf8(output.stdout).expect("plain file names");
    // A file deleted but not yet committed is still listed.
    text.lines().filter(|path| repository().join(path).exists()).map(str::to_owned).collect()
}

/// A new empty folder that vanishes with its value.
pub fn sandbox() -> TempDir {
    tempfile::Builder::new().prefix("karakuri-").tempdir().expect("a temporary folder")
}

/// Every file below a folder with its bytes, and every folder with none; names relative to the folder.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut waiting = vec![folder.to_path_buf()];
    while let Some(next) = waiting.pop() {
        for entry in fs::read_dir(&next).expect("a readable folder") {
            let path = entry.expect("a readable folder").path();
            let name = path.strip_prefix(folder).expect("inside").to_path_buf();
            let bytes =
                if path.is_dir() { Vec::new() } else { fs::read(&path).expect("a readable file") };
            if path.is_dir() {
                waiting.push(path);
            }
            found.insert(name, bytes);
        }
    }
    found
}

/// One of the project's command lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    /// `host-trainer`
    HostTrainer,
    /// `firmware-sim`
    FirmwareSim,
}

impl Program {
    /// The name that a user types.
    pub fn name(self) -> &'static str {
        match self {
            Self::HostTrainer => "host-trainer",
            Self::FirmwareSim => "firmware-sim",
        }
    }

    /// Where cargo built it for these tests.
    pub fn path(self) -> PathBuf {
        assert_cmd::cargo::cargo_bin(format!("{}-under-test", self.name()))
    }

    /// The program, to be started in `folder`. Cargo's variables are taken away: a user's shell has none.
    pub fn command(self, folder: &Path) -> assert_cmd::Command {
        let mut command = assert_cmd::Command::new(self.path());
        command.current_dir(folder).env_remove("CARGO").timeout(TIME_LIMIT);
        command
    }

    /// Runs it to its end.
    pub fn run<Argument: AsRef<OsStr>>(
        self,
        folder: &Path,
        arguments: impl IntoIterator<Item = Argument>,
    ) -> Outcome {
        let arguments: Vec<_> =
            arguments.into_iter().map(|one| one.as_ref().to_os_string()).collect();
        let output = self.command(folder).args(&arguments).output().expect("the program starts");
        let words = arguments.iter().map(|one| one.to_string_lossy());
        Outcome {
            command: std::iter::once(self.name().into()).chain(words).collect::<Vec<_>>().join(" "),
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).expect("text on standard output"),
            stderr: String::from_utf8(output.stderr).expect("text on standard error"),
        }
    }
}

/// No command of a test takes longer, even on a busy machine.
const TIME_LIMIT: Duration = Duration::from_secs(600);

/// `host-trainer` with the words of `line`, in `folder`.
pub fn host_trainer(folder: &Path, line: &str) -> Outcome {
    Program::HostTrainer.run(folder, line.split_whitespace())
}

/// `firmware-sim` with the words of `line`, in `folder`.
pub fn firmware_sim(folder: &Path, line: &str) -> Outcome {
    Program::FirmwareSim.run(folder, line.split_whitespace())
}

/// How a command ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// As a user would type it.
    pub command: String,
    /// Exit code; none after a signal.
    pub code: Option<i32>,
    /// Data.
    pub stdout: String,
    /// Progress, remarks, errors.
    pub stderr: String,
}

impl Outcome {
    /// Demands exit code 0.
    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{self}");
        self
    }

    /// Demands the exit code, nothing on standard output, one line of error without a panic, and every word in it.
    #[track_caller]
    pub fn refused(self, code: i32, words: &[&str]) -> Self {
        assert_eq!(self.code, Some(code), "{self}");
        assert_eq!(self.stdout, "", "data although refused: {self}");
        assert!(!self.stderr.contains("panicked"), "{self}");
        let errors = self.stderr.lines().filter(|line| line.starts_with("error: ")).count();
        assert_eq!(errors, 1, "exactly one line `error: …`: {self}");
        for word in words {
            assert!(self.stderr.contains(word), "the error does not say {word:?}: {self}");
        }
        self
    }

    /// Standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("no JSON, {error}: {self}"))
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "`{}` ended with {:?}", self.command, self.code)?;
        writeln!(f, "--- standard output\n{}--- standard error\n{}", self.stdout, self.stderr)
    }
}

/// Settings of the runs that tests train: preset `tiny` with an end after seconds.
pub const QUICK_CONFIG: &str = "[decoder]\nhidden_widths = [32, 24]\n[budget]\nsteps = 300\n";

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

/// A file of `tests/golden`.
pub fn golden_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden").join(name)
}

/// Compares with a committed text, or replaces it where `UPDATE_GOLDEN` is set.
#[track_caller]
pub fn assert_golden(name: &str, actual: &str) {
    let path = golden_path(name);
    if env::var_os("UPDATE_GOLDEN").is_some() {
        return fs::write(&path, actual).expect("a writable golden");
    }
    let expected = fs::read_to_string(&path).unwrap_or_default();
    if expected == actual {
        return;
    }
    let pairs = expected.lines().map(Some).chain(std::iter::repeat(None)).zip(actual.lines());
    let line = pairs.clone().position(|(expected, actual)| expected != Some(actual));
    let place = line.unwrap_or(actual.lines().count());
    panic!(
        "{name} is different from line {} on:\n golden: {}\n    now: {}\n\
         if the change is meant: UPDATE_GOLDEN=1 cargo test -p tests, and review the diff",
        place + 1,
        expected.lines().nth(place).unwrap_or("(its end)"),
        actual.lines().nth(place).unwrap_or("(its end)"),
    );
}

/// The committed blobs: one small model of the built-in character in every number format.
pub const GOLDEN_BLOBS: [(&str, &str); 3] = [
    ("w8a16", "creature-tiny-w8a16.kara"),
    ("w8a8", "creature-tiny-w8a8.kara"),
    ("f16", "creature-tiny-f16.kara"),
];

/// Bytes of the committed blob in a number format.
pub fn golden_blob(format: &str) -> Vec<u8> {
    let (_, name) =
        GOLDEN_BLOBS.iter().find(|(known, _)| *known == format).expect("a known format");
    fs::read(golden_path(name)).expect("a committed blob")
}

/// One motion of `tests/cases/poses.toml`, and the positions at which it is looked at; whole numbers only.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// Name of the action.
    pub action: String,
    /// Length in frames.
    pub frames: u32,
    /// Seed of the code.
    pub seed: u64,
    /// First position, Q16.16 frames.
    pub first_q16: u32,
    /// Distance of positions, Q16.16 frames.
    pub step_q16: u32,
    /// Number of positions.
    pub pose_count: u16,
}

impl Motion {
    /// The case as simulator and firmware take it.
    pub fn case(&self, model: &Model<'_>) -> Case {
        let action =
            model.action_by_name(&self.action).expect("cases name actions of the committed blobs");
        Case {
            action: action.0,
            pose_count: self.pose_count,
            frames: self.frames,
            seed: self.seed,
            first_bits: self.first_q16,
            step_bits: self.step_q16,
        }
    }
}

/// The case list that every engine decodes.
pub fn motions() -> Vec<Motion> {
    #[derive(Deserialize)]
    struct File {
        motion: Vec<Motion>,
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("cases").join("poses.toml");
    let text = fs::read_to_string(path).expect("the case list");
    toml::from_str::<File>(&text).expect("a case list of whole numbers").motion
}
