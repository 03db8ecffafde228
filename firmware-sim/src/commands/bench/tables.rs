//! Rows of the benchmark as tables for people.

use crate::benchmark::{QEMU_COUNTS_INSTRUCTIONS, Row};

/// Columns that name a row and stand to the left.
const NAME_COLUMNS: usize = 2;

/// All tables of all networks, with what there is to say about them.
pub fn report(rows: &[Row]) -> String {
    let mut networks: Vec<&str> = Vec::new();
    for row in rows {
        if !networks.contains(&row.network.as_str()) {
            networks.push(&row.network);
        }
    }
    let of =
        |network: &str| -> Vec<&Row> { rows.iter().filter(|row| row.network == network).collect() };
    let tables: String =
        networks.into_iter().map(|network| network_report(network, &of(network))).collect();
    let compiler = rows.first().map_or("", |row| row.compiler.as_str());
    format!("{tables}{QEMU_COUNTS_INSTRUCTIONS} Compiler: {compiler}.\n")
}

fn network_report(network: &str, rows: &[&Row]) -> String {
    let work = rows.first().map_or(0, |row| row.multiply_accumulates);
    let part_names = rows.first().map(|row| row.parts.as_slice()).unwrap_or_default();
    let part_names: Vec<&str> = part_names.iter().map(|part| part.part.as_str()).collect();
    let sections = [
        ("instructions per pose", table(rows, &POSE, pose)),
        ("instructions per pose by part", table(rows, &part_names, by_part)),
        ("instructions at the start", table(rows, &START, start)),
        ("bytes of flash", table(rows, &FLASH, flash)),
        ("bytes of RAM", table(rows, &RAM, ram)),
        (ESTIMATE_TITLE, table(rows, &ESTIMATE, estimate)),
    ];
    let sections = sections.map(|(title, table)| format!("{title}\n{table}\n")).concat();
    format!("{network}: {} multiply-accumulates per pose\n\n{sections}", grouped(work))
}

/// Kernel, activation and library are those of the layers; see `PartCounts`.
const POSE: [&str; 8] = [
    "per pose",
    "per MAC",
    "of a pair",
    "time table",
    "time embedding",
    "kernels",
    "activation, requantise",
    "library",
];

fn pose(row: &Row) -> Vec<String> {
    let time = row.parts.iter().filter(|part| !part.is_layer()).map(|part| part.instructions);
    vec![
        grouped(row.instructions_per_pose),
        format!("{:.3}", row.instructions_per_multiply_accumulate),
        or_none(row.pair_instructions_per_pose),
        or_none(row.time_table_instructions_per_pose),
        grouped(time.sum()),
        grouped(row.kernel_instructions),
        grouped(row.activation_instructions),
        grouped(row.library_instructions),
    ]
}

fn by_part(row: &Row) -> Vec<String> {
    row.parts.iter().map(|part| grouped(part.instructions)).collect()
}

const START: [&str; 4] = ["load (once)", "sample", "fold", "a Gaussian"];

fn start(row: &Row) -> Vec<String> {
    vec![
        grouped(row.load_instructions),
        grouped(row.sample_instructions),
        grouped(row.fold_instructions),
        format!("{:.1}", row.gaussian_instructions),
    ]
}

const FLASH: [&str; 6] =
    ["blob: weights", "blob: time table", "blob: rest", "program", "its .text", "its .rodata"];

fn flash(row: &Row) -> Vec<String> {
    [
        row.weight_bytes,
        row.time_table_bytes,
        row.table_bytes,
        row.code_bytes,
        row.text_bytes,
        row.rodata_bytes,
    ]
    .map(grouped)
    .to_vec()
}

const RAM: [&str; 10] = [
    "Workspace",
    "PairWorkspace",
    "Model",
    "Code",
    "Pose",
    "static",
    "stack: load",
    "sample",
    "fold",
    "decode",
];

fn ram(row: &Row) -> Vec<String> {
    let rest = [
        row.model_bytes,
        row.motion_code_bytes,
        row.pose_bytes,
        row.static_bytes,
        row.load_stack_bytes,
        row.sample_stack_bytes,
        row.fold_stack_bytes,
        row.pose_stack_bytes,
    ];
    let workspaces = [grouped(row.workspace_bytes), or_none(row.pair_workspace_bytes)];
    workspaces.into_iter().chain(rest.map(grouped)).collect()
}

const ESTIMATE_TITLE: &str = "ESTIMATE of poses per second, not measured: \
     cycles per instruction are assumed, memory without wait states";
const ESTIMATE: [&str; 4] = ["part", "MHz", "cycles/instr.", "poses/s"];

fn estimate(row: &Row) -> Vec<String> {
    let estimate = row.estimate;
    vec![
        estimate.part.to_owned(),
        estimate.clock_mhz.to_string(),
        format!("{:.1}", estimate.cycles_per_instruction),
        format!("{:.1}", estimate.poses_per_second),
    ]
}

/// A line for each row under a line of headings, columns aligned.
fn table(rows: &[&Row], headings: &[&str], cells: impl Fn(&Row) -> Vec<String>) -> String {
    let head = ["target", "format"].iter().chain(headings).map(|&cell| cell.to_owned()).collect();
    let body =
        rows.iter().map(|row| [vec![row.target.into(), row.format.into()], cells(row)].concat());
    let lines: Vec<Vec<String>> = std::iter::once(head).chain(body).collect();
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        lines.iter().filter_map(|line| line.get(column)).map(|cell| cell.chars().count()).max()
    };
    let widths: Vec<usize> = (0..columns).map(|column| width(column).unwrap_or(0)).collect();
    lines.iter().map(|line| aligned(line, &widths)).collect()
}

fn aligned(line: &[String], widths: &[usize]) -> String {
    let cells = line.iter().zip(widths).enumerate().map(|(column, (cell, &width))| {
        if column < NAME_COLUMNS { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
    });
    format!("  {}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
}

fn or_none(number: Option<u64>) -> String {
    number.map_or("-".into(), grouped)
}

/// Thousands apart: 1,396,700.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::grouped;

    #[test]
    fn thousands_are_grouped() {
        assert_eq!([0, 999, 1000, 1_396_700].map(grouped), ["0", "999", "1,000", "1,396,700"]);
    }
}
