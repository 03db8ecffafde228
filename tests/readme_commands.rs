//! Every command that a Markdown file of the repository shows is one that works.
//!
//! The convention: commands stand in blocks fenced by "```sh". Every `host-trainer` and `firmware-sim` command line in
//! such a block is parsed by the program itself, with `--help` added, so that no verb or flag in the text can go stale;
//! a script that is named must exist. A block right below the line `<!-- run -->` is also run, in an empty folder, from
//! first to last line; every line must end with exit code 0.
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
    let mut found = Vec::new();
    let mut before = "";
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        if line == "```sh" {
            let body: Vec<&str> =
                lines.by_ref().map(|(_, line)| line).take_while(|line| *line != "```").collect();
            let place = format!("{path}:{}", index + 1);
            found.push(Block {
                place,
                commands: commands(&body.join("\n")),
                is_run: before == "<!-- run -->",
            });
        }
        before = line;
    }
    found
}

fn commands(body: &str) -> Vec<String> {
    let joined = body.replace("\\\n", " ");
    let without_comment = |line: &str| match line.find('#') {
        Some(0) => String::new(),
        _ => line.split(" #").next().unwrap_or_default().trim().to_owned(),
    };
    joined.lines().map(without_comment).filter(|line| !line.is_empty()).collect()
}

/// The program that a command starts and the rest of the line, if it is one of ours.
fn ours(command: &str) -> Option<(Program, &str)> {
    [Program::HostTrainer, Program::FirmwareSim].into_iter().find_map(|program| {
        let name = program.name();
        let by_cargo = command.strip_prefix("cargo run ").and_then(|rest| {
            let (flags, arguments) = rest.split_once(" -- ")?;
            flags.ends_with(&format!("-p {name}")).then_some(arguments)
        });
        let by_name = || command.strip_prefix(name)?.strip_prefix(' ');
        by_cargo.or_else(by_name).map(|arguments| (program, arguments))
    })
}

/// Gives a command to the shell, with our programs' paths in place of their names; panics unless it succeeds.
fn shell(folder: &Path, place: &str, command: &str) {
    let line = match ours(command) {
        Some((program, arguments)) => format!("'{}' {arguments}", program.path().display()),
        None => command.to_owned(),
    };
    let mut shell = Command::new("sh");
    shell.args(["-ec", &line]).current_dir(folder).env_remove("CARGO");
    let output = shell.output().expect("a shell");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{place}: `{command}` ended with {}\n{errors}", output.status);
}

#[test]
fn readme_shows_commands_and_runs_some() {
    let blocks = blocks();
    let of_readme = || blocks.iter().filter(|block| block.place.starts_with("README.md"));
    assert!(of_readme().any(|block| block.commands.iter().any(|command| ours(command).is_some())));
    assert!(of_readme().any(|block| block.is_run), "no block of README.md is marked <!-- run -->");
}

#[test]
fn flags_of_every_shown_command_exist() {
    let folder = sandbox();
    for Block { place, commands, .. } in blocks() {
        for command in commands.iter().filter(|command| ours(command).is_some()) {
            // What follows a pipe or a redirection is the shell's.
            let own = command.split(['|', '>', ';', '&']).next().unwrap_or_default();
            shell(folder.path(), &place, &format!("{own} --help"));
        }
    }
}

#[test]
fn shown_scripts_exist() {
    for Block { place, commands, .. } in blocks() {
        let words = commands.iter().flat_map(|command| command.split_whitespace());
        for script in words.filter(|word| word.starts_with("./") || word.starts_with(".ci/")) {
            let exists = repository().join(script).exists();
            assert!(
                exists,
                "{place}: {script} does not exist, seen from the root of the repository"
            );
        }
    }
}

#[test]
fn blocks_marked_run_do_run() {
    for Block { place, commands, .. } in blocks().into_iter().filter(|block| block.is_run) {
        let folder = sandbox();
        commands.iter().for_each(|command| shell(folder.path(), &place, command));
    }
}

#[test]
fn blocks_are_found_and_commands_told_apart() {
    let text = "<!-- run -->\n```sh\n# why\nhost-trainer demo \\\n  --out x # so\nls\n```\n\
                ```text\nhost-trainer no\n```\n```sh\nls\n```\n";
    let blocks = blocks_of("a.md", text);
    let [run, shown] = &blocks[..] else { panic!("{} blocks", blocks.len()) };
    assert_eq!((run.is_run, shown.is_run), (true, false));
    assert_eq!(run.commands, ["host-trainer demo    --out x", "ls"]);
    let (program, arguments) =
        ours("cargo run --release -p firmware-sim -- run a.kara").expect("ours");
    assert_eq!((program, arguments), (Program::FirmwareSim, "run a.kara"));
    assert!(ours("cargo test").is_none() && ours("host-trainers x").is_none());
}
