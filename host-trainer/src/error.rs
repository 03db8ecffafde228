//! What can go wrong on the host, in words that tell the user what to do.
//!
//! Why here: a bad file is the commonest event in a user's day. One type carries all five facts that help:
//! which file, which field, which value, what was expected, and the remedy.

use std::path::{Path, PathBuf};

/// A fallible result of this library.
pub type Result<T> = std::result::Result<T, Error>;

/// Everything that can go wrong; each variant has an exit code of its own.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A user's file or argument is not what it has to be.
    #[error("{file}: {field} is {value}, expected {expected}; {remedy}")]
    BadInput {
        /// The file, folder or flag.
        file: String,
        /// The place inside it: line, column, key, frame.
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
        /// The verb that failed: `read`, `write`, `create`, …
        action: &'static str,
        /// The system's own words.
        #[source]
        source: std::io::Error,
    },
    /// `check` found clips that a robot cannot do.
    #[error(
        "{exceeding_count} of {clip_count} clips exceed a limit of a servo; play them slower, change them, or \
         correct the calibration"
    )]
    LimitsExceeded {
        /// Clips that exceed a limit.
        exceeding_count: usize,
        /// Clips that were checked.
        clip_count: usize,
    },
    /// The user asked to stop; what was done is saved.
    #[error("interrupted; continue with: {resume}")]
    Interrupted {
        /// The command that goes on from here.
        resume: String,
    },
    /// A blob that `core` refuses.
    #[error(
        "{path}: not a usable blob: {reason}; copy it again, or make one with `host-trainer quantize`"
    )]
    Blob {
        /// The file.
        path: PathBuf,
        /// The refusal of `karakuri::Model::from_bytes`.
        reason: String,
    },
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

    /// Exit code of the process: 1 limits exceeded, 3 bad input, 4 input/output, 5 bad blob, 130 interrupted (2 is
    /// clap's).
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::LimitsExceeded { .. } => 1,
            Self::BadInput { .. } => 3,
            Self::Io { .. } => 4,
            Self::Blob { .. } => 5,
            Self::Interrupted { .. } => 130,
        }
    }
}
