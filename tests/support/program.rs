//! The command lines under test, and what they answer.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::contents;

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

/// Runs `line` in `folder` ("sim …" is `firmware-sim`, everything else `host-trainer`): it must be refused with every
/// word of `says`, and the folder must stay as it was.
#[track_caller]
pub fn assert_refused(folder: &Path, line: &str, code: i32, says: &[&str]) {
    let before = contents(folder);
    match line.strip_prefix("sim ") {
        Some(line) => firmware_sim(folder, line).refused(code, says),
        None => host_trainer(folder, line).refused(code, says),
    };
    let after = contents(folder);
    let changed = after.iter().filter(|(name, bytes)| before.get(*name) != Some(bytes));
    let names: Vec<_> = changed.map(|(name, _)| name.display().to_string()).collect();
    assert!(names.is_empty(), "`{line}` was refused, but wrote {names:?}");
    assert_eq!(before.len(), after.len(), "`{line}` was refused, but removed files");
}
