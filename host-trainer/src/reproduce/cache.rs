//! Results of stages on the disk, so that nothing is done twice.
//!
//! In:  everything that a stage depends on, as a [`Key`].
//! Out: the stage's result, from its file or made now.
//!
//! Why here: a file's name holds the hash of its stage's inputs, so a result of other inputs is never taken for this
//! one, and changing an experiment back finds the old result again. A file that cannot be read is made again.

use std::fs;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use crate::atomic_file::{self, Overwrite};
use crate::checkpoint::hexadecimal;
use crate::error::{Error, Result};

/// Part of every key; change it when a stage would make another result of the same inputs.
const VERSION: &str = "karakuri reproduce 1";

/// Hash of what a stage depends on.
#[derive(Clone, Debug)]
pub struct Key(Sha256);

impl Key {
    /// Of a stage that nothing is yet known to go into.
    pub fn new(stage: &str) -> Self {
        Self(Sha256::new()).with(VERSION).with(stage)
    }

    /// One more input; its length keeps two inputs from reading as one.
    #[must_use]
    pub fn with(mut self, input: impl AsRef<[u8]>) -> Self {
        let input = input.as_ref();
        self.0.update((input.len() as u64).to_le_bytes());
        self.0.update(input);
        self
    }

    /// The first 12 hexadecimal digits, for a file's name.
    pub fn digits(&self) -> String {
        hexadecimal(&self.0.clone().finalize()[..6])
    }
}

/// The bytes in `path`, or those that `make` makes, which are then in `path`.
///
/// # Errors
/// Those of `make`; `Io` when the file cannot be written.
pub fn bytes(path: &Path, make: impl FnOnce() -> Result<Vec<u8>>) -> Result<Vec<u8>> {
    if let Ok(bytes) = fs::read(path) {
        return Ok(bytes);
    }
    let bytes = make()?;
    atomic_file::write(path, &bytes, Overwrite::Replace)?;
    Ok(bytes)
}

/// The value in the JSON file `path`, or the one that `make` makes, which is then in `path`.
///
/// # Errors
/// Those of `make`; `Io` when the file cannot be written.
pub fn value<T: Serialize + DeserializeOwned>(
    path: &Path,
    make: impl FnOnce() -> Result<T>,
) -> Result<T> {
    let stored = fs::read(path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
    if let Some(value) = stored {
        return Ok(value);
    }
    let value = make()?;
    let text = serde_json::to_vec_pretty(&value)
        .map_err(|error| Error::io("write", path)(std::io::Error::other(error)))?;
    atomic_file::write(path, &text, Overwrite::Replace)?;
    Ok(value)
}

/// Creates a folder and those above it.
///
/// # Errors
/// `Io` when the system refuses.
pub fn folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(Error::io("create", path))
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn failed_stage_leaves_no_result() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stage.json");
        let failing = || Err::<u32, _>(Error::bad_input("a", "b", "c", "d", "e"));
        assert!(value(&path, failing).is_err());
        assert!(!path.exists());
    }

    #[test]
    fn damaged_result_is_made_again_and_a_sound_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stage.json");
        fs::write(&path, "{").unwrap();
        let made = Cell::new(0);
        let make = || {
            made.set(made.get() + 1);
            Ok(7_u32)
        };
        assert_eq!([value(&path, make).unwrap(), value(&path, make).unwrap()], [7, 7]);
        assert_eq!(made.get(), 1);
    }

    #[test]
    fn keys_tell_inputs_apart_wherever_they_are_cut() {
        let keys = [["ab", "c"], ["a", "bc"], ["abc", ""]];
        let digits = keys.map(|[a, b]| Key::new("train").with(a).with(b).digits());
        assert!(digits[0] != digits[1] && digits[1] != digits[2] && digits[0].len() == 12);
        assert_ne!(Key::new("train").digits(), Key::new("quantize").digits());
    }
}
