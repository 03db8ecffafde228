//! Finds the clip files under a path and gives each clip its name.
//!
//! Why here: data sets come as one file, as a flat folder, as a folder with one subfolder of clips
//! (`clips/`, `moves/`) or as one subfolder per action. All of them become a sorted list of named
//! files.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::{Format, ImportOptions, Remarks};
use crate::error::{Error, Result};

/// One file that holds one clip.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ClipFile {
    /// Unique name: the file's stem, or `folder/stem` when the clips lie in several folders.
    pub name: String,
    /// The file.
    pub path: PathBuf,
}

impl ClipFile {
    /// Name of the folder that holds the file; empty at the root of the file system.
    pub fn folder_name(&self) -> String {
        let folder = self.path.parent().and_then(Path::file_name);
        folder.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    }
}

/// The name that marks a table of labels; never taken for a servo track.
pub(crate) const LABELS_FILE: &str = "labels.csv";

/// Lists the clip files under `path`, sorted by name, and their format.
pub(crate) fn find(
    path: &Path,
    options: &ImportOptions,
    remarks: &mut Remarks,
) -> Result<(Format, Vec<ClipFile>)> {
    let metadata = fs::metadata(path).map_err(Error::io("read", path))?;
    let mut paths =
        if metadata.is_dir() { candidates(path, options)? } else { vec![path.to_path_buf()] };
    let format = options.format.or_else(|| detect(&paths));
    let Some(format) = format else {
        return Err(no_clips(path, "nothing that looks like a clip"));
    };
    let others = paths.len();
    paths.retain(|path| metadata.is_file() || format_of(path) == Some(format));
    if paths.is_empty() {
        let value = format!("without any .{} file", format.extension());
        return Err(no_clips(path, &value));
    }
    if others > paths.len() {
        let (ignored, extension) = (others - paths.len(), format.extension());
        remarks.note(path, format!("{ignored} files other than .{extension} ignored"));
    }
    Ok((format, name_clips(paths)?))
}

/// Files of any known format directly in `folder`, or else in its subfolders.
fn candidates(folder: &Path, options: &ImportOptions) -> Result<Vec<PathBuf>> {
    let is_clip = |path: &PathBuf| {
        let is_labels = path.file_name().is_some_and(|name| name == LABELS_FILE)
            || options.labels.is_labels_file(path);
        let is_wanted = |format| options.format.is_none_or(|wanted| wanted == format);
        path.is_file() && format_of(path).is_some_and(is_wanted) && !is_labels
    };
    let entries = list(folder)?;
    let mut paths: Vec<PathBuf> = entries.iter().filter(|path| is_clip(path)).cloned().collect();
    if paths.is_empty() {
        for subfolder in entries.iter().filter(|path| path.is_dir()) {
            paths.extend(list(subfolder)?.into_iter().filter(|path| is_clip(path)));
        }
    }
    Ok(paths)
}

/// Everything in a folder but hidden entries: `._clip.npy` is what a Mac leaves behind, not a clip.
fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io("list", folder))? {
        let entry = entry.map_err(Error::io("list", folder))?;
        if !entry.file_name().to_string_lossy().starts_with('.') {
            paths.push(entry.path());
        }
    }
    Ok(paths)
}

/// The first format of [`Format::ALL`] that any file has.
fn detect(paths: &[PathBuf]) -> Option<Format> {
    let present = |format: &Format| paths.iter().any(|path| format_of(path) == Some(*format));
    Format::ALL.into_iter().find(present)
}

fn format_of(path: &Path) -> Option<Format> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    Format::ALL.into_iter().find(|format| format.extension() == extension)
}

fn name_clips(paths: Vec<PathBuf>) -> Result<Vec<ClipFile>> {
    let folders: BTreeSet<_> = paths.iter().filter_map(|path| path.parent()).collect();
    let is_scattered = folders.len() > 1;
    let mut files: Vec<ClipFile> = paths
        .iter()
        .map(|path| {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let mut file = ClipFile { name: stem.into_owned(), path: path.clone() };
            if is_scattered {
                file.name = format!("{}/{}", file.folder_name(), file.name);
            }
            file
        })
        .collect();
    files.sort();
    match files.windows(2).find(|pair| pair[0].name == pair[1].name) {
        None => Ok(files),
        Some(pair) => {
            let expected = format!("a name other than that of {}", pair[0].path.display());
            let (path, name) = (&pair[1].path, &pair[1].name);
            Err(Error::bad_input(path, "clip name", name, expected, "rename one of the two"))
        }
    }
}

fn no_clips(path: &Path, value: &str) -> Error {
    let expected = "clip files (.npy, .bvh, .json, .csv) in it or in its subfolders";
    Error::bad_input(path, "path", value, expected, "name the folder that holds the clips")
}

#[cfg(test)]
mod tests {
    use super::super::support::{assert_refused, folder};
    use super::*;

    fn find_in(path: &Path, options: &ImportOptions) -> Result<(Format, Vec<ClipFile>)> {
        find(path, options, &mut Remarks::default())
    }

    fn names(files: &[ClipFile]) -> Vec<&str> {
        files.iter().map(|file| file.name.as_str()).collect()
    }

    #[test]
    fn missing_path_is_refused() {
        let result = find_in(Path::new("/no/such/clips"), &ImportOptions::default());
        assert_refused(result, &["/no/such/clips", "cannot read"]);
    }

    #[test]
    fn folder_without_clips_is_refused() {
        let folder = folder(&[("readme.txt", b""), ("labels.csv", b"clip,action\n")]);
        let result = find_in(folder.path(), &ImportOptions::default());
        assert_refused(result, &["nothing that looks like a clip", ".npy, .bvh, .json, .csv"]);
    }

    #[test]
    fn folder_without_clips_of_the_wanted_format_is_refused() {
        let folder = folder(&[("a.json", b"{}")]);
        let options = ImportOptions { format: Some(Format::Bvh), ..Default::default() };
        assert_refused(find_in(folder.path(), &options), &["without any .bvh file"]);
    }

    #[test]
    fn two_clips_of_one_name_are_refused() {
        let folder = folder(&[("a.npy", b""), ("a.NPY", b"")]);
        let result = find_in(folder.path(), &ImportOptions::default());
        assert_refused(result, &["clip name is a", "rename one of the two"]);
    }

    #[test]
    fn clips_of_one_subfolder_keep_their_short_names() {
        let folder = folder(&[("clips/b.npy", b""), ("clips/a.npy", b""), ("labels.csv", b"")]);
        let (format, files) = find_in(folder.path(), &ImportOptions::default()).unwrap();
        assert_eq!((format, names(&files)), (Format::Npy, vec!["a", "b"]));
    }

    #[test]
    fn clips_of_several_subfolders_carry_the_folder_in_their_names() {
        let folder = folder(&[("wave/1.csv", b""), ("nod/1.csv", b""), (".git/1.csv", b"")]);
        let (_, files) = find_in(folder.path(), &ImportOptions::default()).unwrap();
        assert_eq!(names(&files), ["nod/1", "wave/1"]);
        assert_eq!(files[0].folder_name(), "nod");
    }

    #[test]
    fn sidecars_hidden_files_and_labels_are_no_clips() {
        let bytes: &[u8] = b"";
        let entries = ["a.bvh", "a.json", "._a.bvh", "labels.csv"].map(|name| (name, bytes));
        let folder = folder(&entries);
        let mut remarks = Remarks::default();
        let (format, files) = find(folder.path(), &ImportOptions::default(), &mut remarks).unwrap();
        assert_eq!((format, names(&files)), (Format::Bvh, vec!["a"]));
        assert!(remarks.into_lines()[0].ends_with("1 files other than .bvh ignored"));
    }

    #[test]
    fn single_file_is_a_set_of_one() {
        let folder = folder(&[("a.dat", b"")]);
        let options = ImportOptions { format: Some(Format::Csv), ..Default::default() };
        let (_, files) = find_in(&folder.path().join("a.dat"), &options).unwrap();
        assert_eq!(names(&files), ["a"]);
    }
}
