//! Files that are replaced as a whole or not at all.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::error::{Error, Result};

/// What to do about a file that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overwrite {
    /// Leave it and say so.
    Refuse,
    /// Replace it in one step.
    Replace,
}

impl Overwrite {
    /// What the flag `--force` means.
    pub const fn from_force(force: bool) -> Self {
        if force { Self::Replace } else { Self::Refuse }
    }
}

/// Checks that a file may be written, before the work that fills it begins.
///
/// # Errors
/// `BadInput` when it exists and `overwrite` is `Refuse`.
pub fn check(path: &Path, overwrite: Overwrite) -> Result<()> {
    if overwrite == Overwrite::Refuse && path.exists() {
        let remedy = "choose another --out, or replace it with --force";
        return Err(Error::bad_input(path, "output file", "there already", "a new file", remedy));
    }
    Ok(())
}

/// Writes `bytes` as a whole or not at all.
///
/// # Errors
/// Those of [`check`] and [`replace`].
pub fn write(path: &Path, bytes: &[u8], overwrite: Overwrite) -> Result<()> {
    check(path, overwrite)?;
    replace(path, |file| file.write_all(bytes))
}

/// Replaces `path` by what `write` writes; after an error or a kill at any moment the old file stands unharmed.
///
/// # Errors
/// `Io` when writing, flushing to the disk or renaming fails; the unfinished file is removed.
pub fn replace(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".partial");
    let partial = path.with_file_name(name);
    let written = write_and_rename(&partial, path, write);
    if written.is_err() {
        // Best effort: the error that brought us here is the one to report.
        let _ = fs::remove_file(&partial);
    }
    written.map_err(Error::io("write", path))
}

fn write_and_rename(
    partial: &Path,
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(partial)?);
    write(&mut file)?;
    file.flush()?;
    file.get_ref().sync_all()?;
    fs::rename(partial, path)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    // The rename itself lasts only when the folder has reached the disk.
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("kept");
        replace(&path, |file| file.write_all(b"old")).unwrap();
        let full = |file: &mut BufWriter<File>| {
            file.write_all(b"half of the new")?;
            Err(std::io::Error::from(std::io::ErrorKind::StorageFull))
        };
        assert!(matches!(replace(&path, full), Err(Error::Io { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
