//! What a motion costs on every core, number by number: `firmware-sim bench` against a golden.
//!
//! Why here: instruction counts are the same in every run on every machine, so any change is a change of the code. A
//! regression fails, and an improvement fails until somebody accepts it, lest it be lost again unnoticed. Another
//! version of the compiler makes another program: then numbers may only stay below the golden's by a margin, and the
//! test says loudly that it compared no more than that.

use std::collections::BTreeMap;
use std::env;
use std::fmt::Write;
use std::fs;
use std::sync::OnceLock;

use serde_json::Value;
use tests::{Program, golden_path, repository, skip, skip_for_lack_of_rights};

const GOLDEN: &str = "instructions.csv";
/// `firmware-sim`'s exit code where QEMU, a C compiler or a cross-compiler is missing.
const MISSING_TOOL: i32 = 6;
/// Fields of a row that name it.
const KEYS: [&str; 3] = ["target", "format", "network"];
/// Fields that are compared.
const NUMBERS: [&str; 18] = [
    "instructions_per_pose",
    "pair_instructions_per_pose",
    "time_table_instructions_per_pose",
    "kernel_instructions",
    "load_instructions",
    "sample_instructions",
    "fold_instructions",
    "gaussian_instructions",
    "code_bytes",
    "text_bytes",
    "rodata_bytes",
    "workspace_bytes",
    "model_bytes",
    "static_bytes",
    "load_stack_bytes",
    "sample_stack_bytes",
    "fold_stack_bytes",
    "pose_stack_bytes",
];
/// How much larger than the golden's a number of another compiler's program may be.
const OTHER_COMPILER_FACTOR: f64 = 1.1;

/// Name of a row → its numbers, in the order of [`NUMBERS`]; none where the row has no such number.
type Table = BTreeMap<String, Vec<Option<f64>>>;

/// Compiler and counts of this machine; none where a tool is missing.
fn counted() -> Option<&'static (String, Table)> {
    static COUNTED: OnceLock<Option<(String, Table)>> = OnceLock::new();
    COUNTED.get_or_init(count).as_ref()
}

fn count() -> Option<(String, Table)> {
    let arguments = ["bench", "--network", "paper", "--network", "tiny", "--json"];
    let outcome = Program::FirmwareSim.run(&repository(), arguments);
    if outcome.code == Some(MISSING_TOOL) {
        skip(outcome.stderr.trim());
        return None;
    }
    let rows = outcome.succeeded().json();
    let rows = rows.as_array().expect("an array of rows");
    let compiler = rows[0]["compiler"].as_str().expect("the compiler's version").to_owned();
    Some((compiler, rows.iter().map(|row| (name(row), numbers(row))).collect()))
}

fn name(row: &Value) -> String {
    KEYS.map(|key| row[key].as_str().expect("a name")).join(",")
}

fn numbers(row: &Value) -> Vec<Option<f64>> {
    NUMBERS.iter().map(|&field| row[field].as_f64()).collect()
}

/// The golden: a line with the compiler, a line with the names of the columns, a line a row.
fn text(compiler: &str, table: &Table) -> String {
    let mut text = format!("{compiler}\n{},{}\n", KEYS.join(","), NUMBERS.join(","));
    for (name, numbers) in table {
        let cells = numbers.iter().map(|number| number.map_or(String::new(), |n| n.to_string()));
        let _ = writeln!(text, "{name},{}", cells.collect::<Vec<_>>().join(","));
    }
    text
}

fn golden() -> (String, Table) {
    // Without a golden, every number is one too many.
    let text = fs::read_to_string(golden_path(GOLDEN)).unwrap_or_default();
    let mut lines = text.lines();
    let compiler = lines.next().unwrap_or_default().to_owned();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let (name, numbers) = cells.split_at(KEYS.len());
        (name.join(","), numbers.iter().map(|cell| cell.parse().ok()).collect())
    };
    (compiler, lines.skip(1).map(row).collect())
}

/// Every number that differs: row, field, old and new.
fn differences(old: &Table, new: &Table) -> Vec<(String, Option<f64>, Option<f64>)> {
    let mut found = Vec::new();
    let names: std::collections::BTreeSet<_> = old.keys().chain(new.keys()).collect();
    for name in names {
        for (index, field) in NUMBERS.iter().enumerate() {
            let number = |table: &Table| table.get(name).and_then(|numbers| numbers[index]);
            if number(old) != number(new) {
                found.push((format!("{name} {field}"), number(old), number(new)));
            }
        }
    }
    found
}

fn listed(differences: &[(String, Option<f64>, Option<f64>)]) -> String {
    let number = |number: &Option<f64>| number.map_or("none".into(), |number| number.to_string());
    let line = |(name, old, new): &(String, Option<f64>, Option<f64>)| {
        format!("  {name}: golden {}, now {}\n", number(old), number(new))
    };
    differences.iter().map(line).collect()
}

#[test]
fn every_count_is_the_goldens() {
    let Some((compiler, new)) = counted() else { return };
    if env::var_os("UPDATE_GOLDEN").is_some() {
        return fs::write(golden_path(GOLDEN), text(compiler, new)).expect("a writable golden");
    }
    let (golden_compiler, old) = golden();
    let mut found = differences(&old, new);
    let grows = |old: Option<f64>, new: Option<f64>, factor: f64| {
        old.zip(new).is_none_or(|(old, new)| new > factor * old)
    };
    if *compiler != golden_compiler {
        skip_for_lack_of_rights(&format!(
            "exact counts are those of {golden_compiler}; with {compiler} they may grow by a tenth"
        ));
        found.retain(|&(_, old, new)| grows(old, new, OTHER_COMPILER_FACTOR));
    }
    let verdict = match found.iter().any(|&(_, old, new)| grows(old, new, 1.0)) {
        true => "WORSE: find out why; if it is the price of something wanted,",
        false => "better: so that it stays so,",
    };
    assert!(
        found.is_empty(),
        "{verdict} accept it with `UPDATE_GOLDEN=1 cargo test -p tests --test \
         instruction_counts` and review the difference of tests/golden/{GOLDEN}\n{}",
        listed(&found)
    );
}

/// What the decoder promises at the paper's size: row, field, largest number.
const PROMISES: [(&str, &str, f64); 19] = [
    ("cortex-m4,w8a16,paper", "instructions_per_pose", 1_500_000.0),
    ("cortex-m7,w8a16,paper", "instructions_per_pose", 1_500_000.0),
    ("cortex-m33,w8a16,paper", "instructions_per_pose", 1_500_000.0),
    ("cortex-m4,w8a8,paper", "instructions_per_pose", 1_250_000.0),
    ("cortex-m7,w8a8,paper", "instructions_per_pose", 1_250_000.0),
    ("cortex-m33,w8a8,paper", "instructions_per_pose", 1_250_000.0),
    ("cortex-m4,w8a8,paper", "pair_instructions_per_pose", 1_000_000.0),
    ("cortex-m4,w8a16,paper", "time_table_instructions_per_pose", 1_200_000.0),
    ("cortex-m4,w4a8,paper", "instructions_per_pose", 1_350_000.0),
    ("cortex-m4,f16,paper", "instructions_per_pose", 3_200_000.0),
    ("cortex-m0plus,w8a8,paper", "instructions_per_pose", 4_900_000.0),
    ("cortex-m55,w8a8,paper", "instructions_per_pose", 350_000.0),
    ("cortex-m4,w8a8,paper", "workspace_bytes", 10_240.0),
    ("cortex-m4,w4a8,paper", "workspace_bytes", 10_240.0),
    ("cortex-m4,w8a8,paper", "pose_stack_bytes", 1024.0),
    ("cortex-m4,w8a8,paper", "fold_stack_bytes", 1024.0),
    ("cortex-m4,w8a8,paper", "load_stack_bytes", 1024.0),
    ("cortex-m0plus,w8a8,paper", "pose_stack_bytes", 1024.0),
    ("cortex-m0plus,w8a8,paper", "load_stack_bytes", 1024.0),
];

#[test]
fn accepted_counts_keep_every_promise() {
    let (_, golden) = golden();
    for (row, field, most) in PROMISES {
        let index = NUMBERS.iter().position(|known| *known == field).expect("a compared field");
        let number = golden.get(row).and_then(|numbers| numbers[index]);
        assert!(number.is_some_and(|number| number <= most), "{row} {field}: {number:?} > {most}");
    }
}
