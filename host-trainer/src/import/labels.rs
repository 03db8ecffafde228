//! Says which action each clip shows: by a table, by a pattern on the file name, or by the folder's
//! name.
//!
//! In:  clip files and [`LabelOptions`].
//! Out: one action per clip, in the same order.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};

use regex::Regex;

use super::files::{ClipFile, LABELS_FILE};
use super::{ImportOptions, Remarks, label_groups};
use crate::error::{Error, Result};

/// Where the actions come from.
#[derive(Clone, Debug, Default)]
pub enum LabelSource {
    /// `labels.csv` beside the clips or one folder up; failing that the folders' names if there are
    /// several.
    #[default]
    Auto,
    /// This table.
    File(PathBuf),
    /// The first capture group of this pattern on the clip's name.
    Pattern(Regex),
    /// The name of the folder that holds the clip.
    Folder,
}

/// What the user may say about labels.
#[derive(Clone, Debug, Default)]
pub struct LabelOptions {
    /// Where actions come from.
    pub source: LabelSource,
    /// Column of the table that names the clip; `None`: the first.
    pub clip_column: Option<String>,
    /// Column of the table that names the action; `None`: the one called `action` or `label`, or
    /// the second of two.
    pub action_column: Option<String>,
    /// A TOML file `action = ["name", …]` that maps many names to one action.
    pub groups: Option<PathBuf>,
}

/// Columns taken for the action when the user names none.
const ACTION_COLUMNS: [&str; 2] = ["action", "label"];

impl LabelOptions {
    /// Whether `path` is the table the user named, and so not a clip.
    pub(crate) fn is_labels_file(&self, path: &Path) -> bool {
        matches!(&self.source, LabelSource::File(file) if same_file(file, path))
    }

    /// Labels by the only capture group of `pattern` on the clip's name.
    ///
    /// # Errors
    /// [`Error::BadInput`] if `pattern` is no regular expression or has another number of groups.
    pub fn with_pattern(mut self, pattern: &str) -> Result<Self> {
        let refused = |value: String| {
            let expected = "a regular expression with one capture group, such as ^([a-z]+)";
            Error::bad_input("--label-pattern", "pattern", value, expected, "correct it")
        };
        let regex = Regex::new(pattern).map_err(|error| refused(error.to_string()))?;
        if regex.captures_len() != 2 {
            return Err(refused(pattern.to_string()));
        }
        self.source = LabelSource::Pattern(regex);
        Ok(self)
    }
}

fn same_file(one: &Path, other: &Path) -> bool {
    one == other || matches!((one.canonicalize(), other.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// The action of every file.
pub(crate) fn actions(
    files: &[ClipFile],
    options: &ImportOptions,
    remarks: &mut Remarks,
) -> Result<Vec<String>> {
    let mut labels = labels(files, &options.labels, remarks)?;
    if let Some(path) = &options.labels.groups {
        label_groups::join(path, &mut labels, remarks)?;
    }
    let missing = files.iter().zip(&labels).find(|(_, label)| label.is_none());
    match missing.filter(|_| !options.tolerate_missing_labels) {
        None => Ok(labels.into_iter().map(Option::unwrap_or_default).collect()),
        Some((file, _)) => {
            let count = labels.iter().filter(|label| label.is_none()).count();
            let value = format!("missing (as for {count} of {} clips)", files.len());
            let expected = "a row in labels.csv, a match of --label-pattern, or --label-folder";
            let remedy = "add the row, or remove the clip";
            Err(Error::bad_input(&file.path, "label", value, expected, remedy))
        }
    }
}

fn labels(
    files: &[ClipFile],
    options: &LabelOptions,
    remarks: &mut Remarks,
) -> Result<Vec<Option<String>>> {
    let by_folder = || files.iter().map(|file| Some(file.folder_name())).collect();
    match &options.source {
        LabelSource::File(path) => by_table(files, path, options, remarks),
        LabelSource::Pattern(pattern) => Ok(by_pattern(files, pattern)),
        LabelSource::Folder => Ok(by_folder()),
        LabelSource::Auto => match (table_beside(files), has_several_folders(files)) {
            (Some(path), _) => by_table(files, &path, options, remarks),
            (None, true) => Ok(by_folder()),
            (None, false) => Ok(vec![None; files.len()]),
        },
    }
}

fn has_several_folders(files: &[ClipFile]) -> bool {
    let folders: BTreeSet<_> = files.iter().map(|file| file.path.parent()).collect();
    folders.len() > 1
}

/// `labels.csv` in the clips' folder or its parent.
fn table_beside(files: &[ClipFile]) -> Option<PathBuf> {
    let folder = files.first()?.path.parent()?;
    [Some(folder), folder.parent()]
        .into_iter()
        .flatten()
        .map(|folder| folder.join(LABELS_FILE))
        .find(|path| path.is_file())
}

fn by_pattern(files: &[ClipFile], pattern: &Regex) -> Vec<Option<String>> {
    let label = |file: &ClipFile| {
        let group = pattern.captures(&file.name)?.get(1)?;
        Some(group.as_str().to_string()).filter(|label| !label.is_empty())
    };
    files.iter().map(label).collect()
}

fn by_table(
    files: &[ClipFile],
    path: &Path,
    options: &LabelOptions,
    remarks: &mut Remarks,
) -> Result<Vec<Option<String>>> {
    let mut table = read_table(path, options)?;
    let mut take = |file: &ClipFile| {
        let file_name = file.path.file_name().unwrap_or_default().to_string_lossy();
        table.remove(&file.name).or_else(|| table.remove(file_name.as_ref()))
    };
    let labels = files.iter().map(&mut take).collect();
    if let Some(first) = table.keys().min() {
        let count = table.len();
        remarks.note(path, format!("{count} labels without a clip file (first: {first})"));
    }
    Ok(labels)
}

/// Reads clip name → action.
fn read_table(path: &Path, options: &LabelOptions) -> Result<HashMap<String, String>> {
    let bytes = fs::read(path).map_err(Error::io("read", path))?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes.as_slice());
    let malformed = |error: csv::Error| {
        let expected = "a table of comma-separated values in UTF-8";
        Error::bad_input(path, "table", error, expected, "correct the line")
    };
    let header = reader.headers().map_err(malformed)?.clone();
    let (clip_column, action_column) = choose_columns(path, &header, options)?;
    let mut table = HashMap::new();
    for record in reader.records() {
        let record = record.map_err(malformed)?;
        let (clip, action) = (&record[clip_column], &record[action_column]);
        if action.is_empty() {
            continue; // Reported as a missing label if the clip exists.
        }
        if let Some(first) = table.insert(clip.to_string(), action.to_string()) {
            let line = record.position().map_or(0, csv::Position::line);
            let field = format!("line {line}, clip {clip}");
            let expected = format!("one row per clip (an earlier one says {first})");
            return Err(Error::bad_input(path, field, action, expected, "delete one"));
        }
    }
    Ok(table)
}

fn choose_columns(
    path: &Path,
    header: &csv::StringRecord,
    options: &LabelOptions,
) -> Result<(usize, usize)> {
    let all: Vec<&str> = header.iter().collect();
    let find = |name: &str| header.iter().position(|column| column == name);
    let named = |flag: &str, name: &str| {
        let expected = format!("one of the columns {}", all.join(", "));
        find(name).ok_or_else(|| Error::bad_input(path, flag, name, expected, "correct the flag"))
    };
    let clip = match &options.clip_column {
        Some(name) => named("--label-clip-column", name)?,
        None => 0,
    };
    let action = match &options.action_column {
        Some(name) => Some(named("--label-action-column", name)?),
        None => ACTION_COLUMNS
            .iter()
            .find_map(|name| find(name))
            .or((all.len() == 2).then_some(1 - clip.min(1))),
    };
    let ambiguous = || {
        let expected = "a column called action or label, or two columns";
        let remedy = "choose one with --label-action-column";
        Error::bad_input(path, "header", all.join(","), expected, remedy)
    };
    Ok((clip, action.ok_or_else(ambiguous)?))
}

#[cfg(test)]
mod tests {
    use super::super::support::{assert_refused, folder};
    use super::super::{Format, files};
    use super::*;

    /// Labels the csv files of a folder.
    fn label(
        entries: &[(&str, &[u8])],
        labels: LabelOptions,
    ) -> Result<(Vec<String>, Vec<String>)> {
        let folder = folder(entries);
        let source = match labels.source {
            LabelSource::File(name) => LabelSource::File(folder.path().join(name)),
            other => other,
        };
        let groups = labels.groups.map(|name| folder.path().join(name));
        let labels = LabelOptions { source, groups, ..labels };
        let options = ImportOptions { labels, format: Some(Format::Npy), ..Default::default() };
        let mut remarks = Remarks::default();
        let (_, files) = files::find(folder.path(), &options, &mut remarks)?;
        Ok((actions(&files, &options, &mut remarks)?, remarks.into_lines()))
    }

    const CLIPS: [(&str, &[u8]); 2] = [("walk1.npy", b""), ("wave1.npy", b"")];

    fn with<'a>(name: &'a str, text: &'a [u8]) -> Vec<(&'a str, &'a [u8])> {
        CLIPS.into_iter().chain([(name, text)]).collect()
    }

    #[test]
    fn clip_without_any_label_is_refused() {
        let words = ["walk1.npy", "missing (as for 2 of 2 clips)", "--label-pattern"];
        assert_refused(label(&CLIPS, LabelOptions::default()), &words);
    }

    #[test]
    fn clip_without_a_row_or_with_an_empty_one_is_refused() {
        for table in [&b"clip,action\nwalk1,walk\n"[..], b"clip,action\nwalk1,walk\nwave1,\n"] {
            let result = label(&with("labels.csv", table), LabelOptions::default());
            assert_refused(result, &["wave1.npy", "label is missing (as for 1 of 2 clips)"]);
        }
    }

    #[test]
    fn clip_with_two_rows_is_refused() {
        let table = b"clip,action\nwalk1,walk\nwave1,wave\nwalk1,run\n";
        let result = label(&with("labels.csv", table), LabelOptions::default());
        assert_refused(result, &["labels.csv", "line 4, clip walk1", "run", "says walk"]);
    }

    #[test]
    fn table_with_ragged_rows_is_refused() {
        let table = b"clip,action\nwalk1,walk,fast\n";
        let result = label(&with("labels.csv", table), LabelOptions::default());
        assert_refused(result, &["labels.csv", "line: 2", "3 fields"]);
    }

    #[test]
    fn table_that_is_no_text_is_refused() {
        let result =
            label(&with("labels.csv", b"clip,action\n\xff,\xfe\n"), LabelOptions::default());
        assert_refused(result, &["labels.csv", "UTF-8"]);
        let result = label(&with("labels.csv", b""), LabelOptions::default());
        assert_refused(result, &["labels.csv", "header"]);
    }

    #[test]
    fn ambiguous_or_unknown_columns_are_refused() {
        let table = b"clip,coarse,fine\nwalk1,walk,slow\nwave1,wave,slow\n";
        let entries = with("labels.csv", table);
        let result = label(&entries, LabelOptions::default());
        assert_refused(result, &["clip,coarse,fine", "--label-action-column"]);
        let action_column = Some("course".into());
        let result = label(&entries, LabelOptions { action_column, ..Default::default() });
        assert_refused(result, &["--label-action-column is course", "clip, coarse, fine"]);
        let clip_column = Some("name".into());
        let result = label(&entries, LabelOptions { clip_column, ..Default::default() });
        assert_refused(result, &["--label-clip-column is name"]);
    }

    #[test]
    fn unusable_patterns_are_refused() {
        for pattern in ["(", "walk", "(a)(b)"] {
            let result = LabelOptions::default().with_pattern(pattern);
            assert_refused(result, &["--label-pattern", "one capture group"]);
        }
    }

    #[test]
    fn clip_that_the_pattern_does_not_match_is_refused() {
        let labels = LabelOptions::default().with_pattern("^(walk)").unwrap();
        assert_refused(label(&CLIPS, labels), &["wave1.npy", "label is missing"]);
    }

    #[test]
    fn labels_without_a_group_are_listed() {
        let labels = LabelOptions::default().with_pattern(r"^([a-z]+)").unwrap();
        let labels = LabelOptions { groups: Some("groups.toml".into()), ..labels };
        let result = label(&with("groups.toml", b"calm = ['sit']"), labels);
        assert_refused(result, &["groups.toml", "missing labels", "walk, wave"]);
    }

    #[test]
    fn unusable_groups_are_refused() {
        let labels = LabelOptions::default().with_pattern(r"^([a-z]+)").unwrap();
        let labels = LabelOptions { groups: Some("groups.toml".into()), ..labels };
        for text in ["calm = 'walk'", "calm ["] {
            let result = label(&with("groups.toml", text.as_bytes()), labels.clone());
            assert_refused(result, &["groups.toml", "happy = ["]);
        }
        let text = b"calm = ['walk', 'wave']\nfast = ['walk']";
        let result = label(&with("groups.toml", text), labels);
        assert_refused(result, &["walk is in calm and in fast", "one group"]);
    }

    #[test]
    fn table_labels_by_name_or_file_name_and_unused_rows_are_remarked() {
        let table = "\u{feff}clip , action\nwave1.npy, wave\nwalk1,walk\nrun1,run\n";
        let (actions, remarks) =
            label(&with("labels.csv", table.as_bytes()), LabelOptions::default()).unwrap();
        assert_eq!(actions, ["walk", "wave"]);
        assert!(remarks[0].ends_with("1 labels without a clip file (first: run1)"));
    }

    #[test]
    fn named_table_and_named_columns_win() {
        let table = b"id,file,what\n1,walk1,stroll\n2,wave1,greet\n";
        let labels = LabelOptions {
            source: LabelSource::File("table.csv".into()),
            clip_column: Some("file".into()),
            action_column: Some("what".into()),
            groups: None,
        };
        assert_eq!(label(&with("table.csv", table), labels).unwrap().0, ["stroll", "greet"]);
    }

    #[test]
    fn pattern_and_groups_join_labels() {
        let labels = LabelOptions::default().with_pattern(r"^([a-z_]+?)\d+$").unwrap();
        let labels = LabelOptions { groups: Some("groups.toml".into()), ..labels };
        let text = b"lively = ['walk', 'wave', 'run']";
        let (actions, remarks) = label(&with("groups.toml", text), labels).unwrap();
        assert_eq!(actions, ["lively", "lively"]);
        assert!(remarks[0].ends_with("label run occurs in no clip"));
    }

    #[test]
    fn folders_label_where_there_is_no_table() {
        let entries: [(&str, &[u8]); 2] = [("nod/1.npy", b""), ("wave/1.npy", b"")];
        let (actions, _) = label(&entries, LabelOptions::default()).unwrap();
        assert_eq!(actions, ["nod", "wave"]);
        let entries: [(&str, &[u8]); 1] = [("nod/1.npy", b"")];
        let labels = LabelOptions { source: LabelSource::Folder, ..Default::default() };
        assert_eq!(label(&entries, labels).unwrap().0, ["nod"]);
    }
}
