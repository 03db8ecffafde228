//! What the importers' tests share: folders of files, NumPy bytes, and the question whether an
//! error says enough.

use std::fmt::Debug;
use std::fs;
use std::path::PathBuf;

use tempfile::TempDir;

use crate::error::{Error, Result};

/// A new folder that holds these files; subfolders are made.
pub(crate) fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    folder
}

/// Asserts that `result` is an error whose message contains every one of `words`.
pub(crate) fn assert_refused<T: Debug>(result: Result<T>, words: &[&str]) {
    let message = refusal(result).to_string();
    for word in words {
        assert!(message.contains(word), "{word:?} is missing in: {message}");
    }
}

fn refusal<T: Debug>(result: Result<T>) -> Error {
    match result {
        Err(error) => error,
        Ok(value) => panic!("accepted as {value:?}"),
    }
}

/// A NumPy file of version 1 with any header fields and any bytes of values.
pub(crate) fn npy(dtype: &str, fortran_order: bool, shape: &str, values: &[u8]) -> Vec<u8> {
    let order = if fortran_order { "True" } else { "False" };
    let text = format!("{{'descr': '{dtype}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let len_bytes = u16::try_from(text.len()).unwrap().to_le_bytes();
    [b"\x93NUMPY\x01\x00", &len_bytes[..], text.as_bytes(), values].concat()
}

/// A NumPy file of little-endian f32.
pub(crate) fn npy_f32(shape: &str, values: &[f32]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    npy("<f4", false, shape, &bytes)
}

/// The shared data, or `None` after saying so; a missing folder is an error on CI.
pub(crate) fn shared(folder: &str) -> Option<PathBuf> {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let path = PathBuf::from(data).join(folder);
    if path.is_dir() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing", path.display());
    eprintln!("SKIPPED: {} is missing", path.display());
    None
}
