//! The habits of the house, checked: sizes, unkept promises, the map of the code, goldens, presets, data of others.
//!
//! Why here: what no compiler checks decays. Every message says which file and line, and what to do.

use std::collections::BTreeSet;
use std::fs;

use tests::{repository, repository_files};

const FILE_LINES_MAX: usize = 400;
const FUNCTION_LINES_MAX: usize = 70;
const LINE_COLUMNS_MAX: usize = 120;

/// File names that say nothing about what is inside.
const EMPTY_NAMES: [&str; 6] = ["utils", "util", "misc", "helpers", "helper", "common"];

/// Promises of later work, written so that this file does not contain them.
const PROMISES: [&str; 7] = [
    concat!("TO", "DO"),
    concat!("FIX", "ME"),
    concat!("XX", "X"),
    concat!("todo", "!("),
    concat!("unimplemented", "!("),
    concat!("#[ig", "nore]"),
    concat!("#[ig", "nore ="),
];

/// Extensions of recordings and weights; the project ships only data that it makes.
const RECORDINGS: [&str; 11] =
    ["npy", "npz", "bvh", "fbx", "c3d", "amc", "asf", "pkl", "pt", "onnx", "safetensors"];

/// A file of the repository.
struct Source {
    /// From the root, with slashes.
    path: String,
    text: String,
}

fn with_extension(extension: &str) -> Vec<Source> {
    let ending = format!(".{extension}");
    let paths = repository_files().into_iter().filter(|path| path.ends_with(&ending));
    let read = |path: String| Source {
        text: fs::read_to_string(repository().join(&path)).expect("a text file"),
        path,
    };
    let sources: Vec<Source> = paths.map(read).collect();
    assert!(!sources.is_empty(), "no .{extension} file found: the test looks in the wrong place");
    sources
}

/// Fails with every complaint at once.
#[track_caller]
fn assert_none(habit: &str, complaints: Vec<String>) {
    assert!(complaints.is_empty(), "{habit}\n  {}", complaints.join("\n  "));
}

/// Lines before the file's own tests.
fn line_count_before_tests(text: &str) -> usize {
    let lines: Vec<&str> = text.lines().collect();
    let is_tests = |pair: &[&str]| {
        pair[0] == "#[cfg(test)]" && pair[1].starts_with("mod ") && pair[1].ends_with('{')
    };
    lines.windows(2).position(is_tests).unwrap_or(lines.len())
}

#[test]
fn files_are_short_before_their_tests() {
    let counted = with_extension("rs")
        .into_iter()
        .map(|file| (line_count_before_tests(&file.text), file.path));
    let long = counted.filter(|(count, _)| *count > FILE_LINES_MAX);
    let habit =
        format!("a file has at most {FILE_LINES_MAX} lines before its tests; split it by meaning:");
    assert_none(&habit, long.map(|(count, path)| format!("{path}: {count} lines")).collect());
}

/// Name and number of lines of every function; relies on rustfmt's indentation.
fn functions(text: &str) -> Vec<(usize, String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let Some(name) = function_name(line) else { continue };
        let indentation = &line[..line.len() - line.trim_start().len()];
        let ends = |line: &str| {
            let rest = line.strip_prefix(indentation);
            rest.is_some_and(|rest| {
                rest.starts_with('}') || rest.starts_with(')') && rest.ends_with(';')
            })
        };
        let is_one_line = line.ends_with('}') || line.ends_with(';');
        let length =
            if is_one_line { Some(0) } else { lines[start..].iter().position(|line| ends(line)) };
        let length =
            length.unwrap_or_else(|| panic!("line {}: function {name} has no end", start + 1));
        found.push((start + 1, name.to_owned(), length + 1));
    }
    found
}

/// The name, if the line begins a function.
fn function_name(line: &str) -> Option<&str> {
    let mut words = line.trim_start();
    let modifiers =
        ["pub(crate) ", "pub(super) ", "pub ", "const ", "async ", "unsafe ", "extern \"C\" "];
    while let Some(rest) = modifiers.iter().find_map(|modifier| words.strip_prefix(modifier)) {
        words = rest;
    }
    let name = words.strip_prefix("fn ")?;
    name.split(['(', '<']).next()
}

#[test]
fn functions_are_short() {
    let mut long = Vec::new();
    for file in with_extension("rs") {
        let functions =
            functions(&file.text).into_iter().filter(|(_, _, count)| *count > FUNCTION_LINES_MAX);
        long.extend(
            functions.map(|(line, name, count)| {
                format!("{}:{line}: {name} has {count} lines", file.path)
            }),
        );
    }
    assert_none(
        &format!("a function has at most {FUNCTION_LINES_MAX} lines; name its parts:"),
        long,
    );
}

#[test]
fn function_lengths_are_measured() {
    let text = "fn a() {}\nimpl X {\n    pub const fn b(\n        x: u8,\n    ) -> u8 {\n        x\n    }\n    \
                fn c();\n}\n";
    assert_eq!(functions(text), [(1, "a".into(), 1), (3, "b".into(), 5), (8, "c".into(), 1)]);
}

#[test]
fn lines_fit_a_screen() {
    let mut wide = Vec::new();
    for file in with_extension("rs").into_iter().chain(with_extension("toml")) {
        let columns = file.text.lines().map(|line| line.chars().count()).enumerate();
        let wide_lines = columns.filter(|(_, count)| *count > LINE_COLUMNS_MAX);
        wide.extend(
            wide_lines.map(|(line, count)| format!("{}:{}: {count} columns", file.path, line + 1)),
        );
    }
    assert_none(&format!("a line has at most {LINE_COLUMNS_MAX} columns:"), wide);
}

#[test]
fn no_file_name_says_nothing() {
    let stem = |path: &str| {
        path.rsplit('/').next().and_then(|name| name.split('.').next()).unwrap_or("").to_owned()
    };
    let empty =
        repository_files().into_iter().filter(|path| EMPTY_NAMES.contains(&stem(path).as_str()));
    assert_none("a file is named after what is in it:", empty.collect());
}

#[test]
fn no_work_is_promised_for_later() {
    let mut promises = Vec::new();
    for file in
        with_extension("rs").into_iter().chain(with_extension("toml")).chain(with_extension("md"))
    {
        for (index, line) in file.text.lines().enumerate() {
            let found = PROMISES.iter().find(|promise| contains_word(line, promise));
            promises.extend(found.map(|word| format!("{}:{}: {word}", file.path, index + 1)));
        }
    }
    assert_none("do it, or open an issue and leave no mark here:", promises);
}

/// Whether the word stands in the line, not as part of a longer one.
fn contains_word(line: &str, word: &str) -> bool {
    let is_part = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    line.match_indices(word).any(|(start, _)| {
        let (before, after) =
            (line[..start].chars().next_back(), line[start + word.len()..].chars().next());
        !(is_part(before) || word.ends_with(char::is_alphanumeric) && is_part(after))
    })
}

/// First cells of the tables in the section of `ARCHITECTURE.md` whose heading says "code map"; without backticks.
fn code_map() -> BTreeSet<String> {
    let path = repository().join("ARCHITECTURE.md");
    let text = fs::read_to_string(&path).expect("ARCHITECTURE.md at the root");
    let level = |line: &str| line.chars().take_while(|&c| c == '#').count();
    let is_map = |line: &&str| line.starts_with('#') && line.to_lowercase().contains("code map");
    let heading = text.lines().find(is_map).expect("a heading `## Code map` in ARCHITECTURE.md");
    let section = text.lines().skip_while(|line| *line != heading).skip(1);
    let section = section.take_while(|line| !(1..=level(heading)).contains(&level(line)));
    let paths = section.filter_map(|line| line.strip_prefix("| `")?.split_once('`'));
    paths.map(|(path, _)| path.to_owned()).collect()
}

#[test]
fn code_map_names_every_source_file() {
    let map = code_map();
    let sources = repository_files().into_iter().filter(|path| path.ends_with(".rs"));
    let missing =
        sources.filter(|path| !map.contains(path)).map(|path| format!("| `{path}` | what it is |"));
    assert_none("add a row to the code map of ARCHITECTURE.md:", missing.collect());
}

#[test]
fn code_map_names_nothing_that_does_not_exist() {
    let gone = code_map().into_iter().filter(|path| !repository().join(path).exists());
    assert_none("correct or remove in the code map of ARCHITECTURE.md:", gone.collect());
}

/// Names of the files in `tests/golden` and `tests/cases`, except their explanations.
fn golden_names() -> Vec<String> {
    let of_folder =
        |path: &String| path.starts_with("tests/golden/") || path.starts_with("tests/cases/");
    let names = repository_files().into_iter().filter(of_folder);
    let names = names.filter_map(|path| path.rsplit('/').next().map(str::to_owned));
    names.filter(|name| name != "README.md").collect()
}

#[test]
fn every_golden_is_read_by_a_test() {
    let tests: Vec<Source> =
        with_extension("rs").into_iter().filter(|file| file.path.starts_with("tests/")).collect();
    let is_read = |name: &String| tests.iter().any(|test| test.text.contains(&format!("{name}\"")));
    let dead = golden_names().into_iter().filter(|name| !is_read(name));
    assert_none("no test names these files; delete them or read them:", dead.collect());
}

#[test]
fn every_golden_is_explained() {
    let readme = fs::read_to_string(repository().join("tests/golden/README.md"))
        .expect("tests/golden/README.md");
    let unexplained = golden_names().into_iter().filter(|name| !readme.contains(name.as_str()));
    assert_none(
        "tests/golden/README.md does not say what made these files and what they prove:",
        unexplained.collect(),
    );
}

#[test]
fn every_key_of_a_preset_has_a_comment() {
    let mut bare = Vec::new();
    for file in with_extension("toml").into_iter().filter(|file| file.path.contains("/presets/")) {
        for (index, line) in file.text.lines().enumerate() {
            let is_key =
                line.split_once('=').is_some_and(|(key, _)| !key.trim_start().starts_with('#'));
            if is_key && !line.contains('#') {
                bare.push(format!("{}:{}: {line}", file.path, index + 1));
            }
        }
    }
    assert_none(
        "a comment after every key says its unit, its meaning and where the value comes from:",
        bare,
    );
}

#[test]
fn no_recordings_or_weights_are_committed() {
    let extension = |path: &String| path.rsplit('.').next().unwrap_or("").to_lowercase();
    let foreign = repository_files()
        .into_iter()
        .filter(|path| RECORDINGS.contains(&extension(path).as_str()));
    assert_none("data belongs beside the repository, not into it:", foreign.collect());
}
