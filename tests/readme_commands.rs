//! Every command that a Markdown file of the repository shows is one that works.
//!
//! The convention: commands stand in blocks fenced by "```sh". Every `host-trainer` and `firmware-sim` command line in
//! such a block is parsed by the program itself, with `--help` added, so that no verb or flag in the text can go stale;
//! a program that is called by its path must exist. A block right below the line `<!-- run -->` is also run from first
//! to last line, in an empty folder; every line must end with exit code 0.
//!
//! Programs are started as cargo built them for these tests: `cargo run --release -p host-trainer -- demo` and
//! `host-trainer demo` both mean `demo` to that program. In a block that is run, everything else (`ls`, `cat`, …) goes
//! to the shell.

use std::fs;
use std::path::Path;
use std::process::Command;

use tests::{Program, repository, repository_files, sandbox};

/// A fenced block of commands.
struct Block {
    /// File and line.
    place: String,
    /// One a line, continuation lines joined, comments left out.
    commands: Vec<String>,
    is_run: bool,
}

/// Every block of every Markdown file that git tracks or would add.
fn blocks() -> Vec<Block> {
    let paths = repository_files().into_iter().filter(|path| path.ends_with(".md"));
    let read = |path: &String| fs::read_to_string(repository().join(path)).expect("a text file");
    paths.flat_map(|path| blocks_of(&path, &read(&path))).collect()
}

fn blocks_of(path: &str, text: &str) -> Vec<Block> {
    let (mut found, mut open, mut before) = (Vec::new(), None::<Block>, "");
    for (index, line) in text.lines().enumerate() {
        match &mut open {
            Some(_) if line.starts_with("```") => found.extend(open.take()),
            Some(block) => block.commands.push(line.to_owned()),
            None if line == "```sh" => {
                let place = format!("{path}:{}", index + 1);
                open =
                    Some(Block { place, commands: Vec::new(), is_run: before == "<!-- run -->" });
            }
            None => (),
        }
        before = line;
    }
    assert!(open.is_none(), "{path}: a block of commands has no end");
    for block in &mut found {
        let joined = block.commands.join("\n").replace("\\\n", " ");
        let lines = joined.lines().map(|line| line.trim().trim_start_matches("$ "));
        block.commands = lines
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .map(str::to_owned)
            .collect();
    }
    found
}

/// The program that a command starts and the rest of the line, if it is one of ours.
fn ours(command: &str) -> Option<(Program, &str)> {
    [Program::HostTrainer, Program::FirmwareSim].into_iter().find_map(|program| {
        let name = program.name();
        let by_cargo = command.strip_prefix("cargo run ").and_then(|rest| {
            let (flags, arguments) = rest.split_once(" -- ")?;
            flags.ends_with(&format!("-p {name}")).then_some(arguments)
        });
        let by_name = || {
            let (first, arguments) = command.split_once(' ')?;
            (first == name || first == format!("target/release/{name}")).then_some(arguments)
        };
        by_cargo.or_else(by_name).map(|arguments| (program, arguments))
    })
}

/// The command with our programs' paths in place of their names, for a shell.
fn for_the_shell(command: &str) -> String {
    match ours(command) {
        Some((program, arguments)) => format!("'{}' {arguments}", program.path().display()),
        None => command.to_owned(),
    }
}

fn shell(folder: &Path, command: &str) -> std::process::Output {
    let mut shell = Command::new("sh");
    shell.args(["-ec", command]).current_dir(folder).env_remove("CARGO").output().expect("a shell")
}

#[test]
fn readme_has_commands() {
    let blocks = blocks();
    assert!(
        blocks.iter().any(|block| block.place.starts_with("README.md")),
        "README.md shows no commands"
    );
    assert!(blocks.iter().any(|block| block.is_run), "no block is marked <!-- run -->");
}

#[test]
fn flags_of_every_shown_command_exist() {
    let folder = sandbox();
    for block in blocks() {
        for command in &block.commands {
            let Some((program, arguments)) = ours(command) else { continue };
            // What follows a pipe or a redirection is the shell's.
            let own = arguments.split(['|', '>', ';', '&']).next().unwrap_or_default();
            let asked = format!("'{}' {own} --help", program.path().display());
            let output = shell(folder.path(), &asked);
            let errors = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{}: `{command}`\n{errors}", block.place);
        }
    }
}

#[test]
fn shown_scripts_exist() {
    for block in blocks() {
        for command in &block.commands {
            let program = command.split_whitespace().next().unwrap_or_default();
            let is_script = program.starts_with("./") || program.starts_with(".ci/");
            assert!(
                !is_script || repository().join(program).exists(),
                "{}: {program} does not exist, seen from the root of the repository",
                block.place
            );
        }
    }
}

#[test]
fn blocks_marked_run_do_run() {
    for block in blocks().iter().filter(|block| block.is_run) {
        let folder = sandbox();
        for command in &block.commands {
            let output = shell(folder.path(), &for_the_shell(command));
            let errors = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{}: `{command}`\n{errors}", block.place);
        }
    }
}

#[test]
fn blocks_are_found_and_commands_told_apart() {
    let text = "<!-- run -->\n```sh\n# why\nhost-trainer demo \\\n  --out x\nls\n```\n```text\nhost-trainer no\n```\n";
    let blocks = blocks_of("a.md", text);
    assert_eq!(blocks.len(), 1);
    assert!(blocks[0].is_run);
    assert_eq!(blocks[0].commands, ["host-trainer demo    --out x", "ls"]);
    let (program, arguments) =
        ours("cargo run --release -p firmware-sim -- run a.kara").expect("ours");
    assert_eq!((program, arguments), (Program::FirmwareSim, "run a.kara"));
    assert!(ours("cargo test").is_none());
}
