//! What can go wrong in the simulator, in words that tell the user what to do.
//!
//! Why here: a missing tool is the commonest event on a new machine, so every variant carries its remedy.

use std::path::{Path, PathBuf};

/// Stands for the file of a blob where only its bytes are known; [`Error::in_file`] puts the name there.
pub(crate) const BLOB: &str = "blob";

/// A fallible result of this library.
pub type Result<T> = std::result::Result<T, Error>;

/// Everything that can go wrong; a difference between host and device is a result, not an error.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A user's file or argument is not what it has to be.
    #[error("{file}: {field} is {value}, expected {expected}; {remedy}")]
    BadInput {
        /// The file, folder or flag.
        file: String,
        /// The place inside it.
        field: String,
        /// What stands there.
        value: String,
        /// What should stand there.
        expected: String,
        /// What the user can do now.
        remedy: String,
    },
    /// The operating system refused.
    #[error("{path}: cannot {action}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The verb that failed: `read`, `write`, `start`, …
        action: &'static str,
        /// The system's own words.
        #[source]
        source: std::io::Error,
    },
    /// Bytes that `core` refuses.
    #[error("{file}: not a usable blob: {reason}; make one with `host-trainer quantize`")]
    Blob {
        /// Where the bytes come from.
        file: String,
        /// The refusal of `karakuri::Model::from_bytes`.
        reason: karakuri::BlobError,
    },
    /// A program that has to be installed.
    #[error("{what} is not installed; {remedy}")]
    MissingTool {
        /// The program, or what it would do.
        what: String,
        /// The command that installs it.
        remedy: String,
    },
    /// The bare-metal program does not build.
    #[error("the firmware for {target} does not build:\n{log}")]
    Build {
        /// Name of the target.
        target: &'static str,
        /// The last lines of cargo.
        log: String,
    },
    /// The bare-metal program did not run to its end.
    #[error("the firmware stopped: {reason}\n{log}")]
    Firmware {
        /// Exit code, signal or silence.
        reason: String,
        /// What it printed last.
        log: String,
    },
}

impl From<karakuri::BlobError> for Error {
    fn from(reason: karakuri::BlobError) -> Self {
        Self::Blob { file: BLOB.to_owned(), reason }
    }
}

impl Error {
    /// Builds [`Error::BadInput`] from anything printable.
    pub fn bad_input(
        file: impl AsRef<Path>,
        field: impl ToString,
        value: impl ToString,
        expected: impl ToString,
        remedy: impl ToString,
    ) -> Self {
        Self::BadInput {
            file: file.as_ref().display().to_string(),
            field: field.to_string(),
            value: value.to_string(),
            expected: expected.to_string(),
            remedy: remedy.to_string(),
        }
    }

    /// For `map_err` on file operations: `fs::read(path).map_err(Error::io("read", path))`.
    pub fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, action, source }
    }

    /// Says of which file an error of bytes speaks.
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Blob { reason, .. } => Self::Blob { file: path.display().to_string(), reason },
            Self::BadInput { file, field, value, expected, remedy } if file == BLOB => {
                Self::BadInput { file: path.display().to_string(), field, value, expected, remedy }
            }
            other => other,
        }
    }

    /// Whether the machine lacks a program: a test may then skip, loudly.
    pub fn is_missing_tool(&self) -> bool {
        matches!(self, Self::MissingTool { .. })
    }

    /// Exit code of the process: 3 bad input, 4 input/output, 5 bad blob, 6 missing tool, 7 firmware
    /// (1 is a difference, 2 is clap's).
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::BadInput { .. } => 3,
            Self::Io { .. } => 4,
            Self::Blob { .. } => 5,
            Self::MissingTool { .. } => 6,
            Self::Build { .. } | Self::Firmware { .. } => 7,
        }
    }
}
