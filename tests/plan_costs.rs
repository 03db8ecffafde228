//! What `host-trainer plan` says about instructions, code and stack is what was counted.
//!
//! Why here: the plan runs without an emulator, on a model of three numbers a core and format. When the counts of
//! `instructions.csv` are accepted anew, the numbers in `host-trainer/src/plan/core_cost.rs` must follow.

use std::fs;

use firmware_sim::benchmark::Estimate;
use firmware_sim::network::Network;
use firmware_sim::target::Target;
use host_trainer::plan::core_cost::{Core, PoseWork};
use karakuri::NumberFormat;
use tests::golden_path;

/// How far the model may be from a count.
const INSTRUCTIONS_SHARE: f64 = 0.02;
/// How far code and stack may be.
const BYTES_SHARE: f64 = 0.1;

/// What was counted: of which network, in which format, on which core; names and texts of the counts.
type Row = (Core, NumberFormat, Network, Vec<(String, String)>);

/// Every counted row of a core that has boards: core, format, network, its cells.
fn rows() -> Vec<Row> {
    let text = fs::read_to_string(golden_path("instructions.csv")).expect("a golden");
    let mut lines = text.lines().skip(1);
    let names: Vec<&str> = lines.next().expect("names").split(',').collect();
    let row = |line: &str| {
        let cells = names.iter().zip(line.split(',')).map(|(a, b)| (a.to_string(), b.to_string()));
        let cells: Vec<(String, String)> = cells.collect();
        let core = Core::ALL.into_iter().find(|core| core.name() == cells[0].1)?;
        let format = NumberFormat::ALL.into_iter().find(|format| format.name() == cells[1].1)?;
        let networks = [Network::Paper, Network::Small, Network::Tiny];
        let network = networks.into_iter().find(|network| network.name() == cells[2].1)?;
        Some((core, format, network, cells))
    };
    lines.filter_map(row).collect()
}

fn number(cells: &[(String, String)], name: &str) -> f64 {
    let (_, cell) = cells.iter().find(|(column, _)| column == name).expect("a column");
    cell.parse().expect("a number")
}

#[test]
fn instructions_of_the_model_are_those_counted_within_two_percent() {
    let rows = rows();
    assert_eq!(rows.len(), Core::ALL.len() * NumberFormat::ALL.len() * 2);
    for (core, format, network, cells) in rows {
        let layers = network.shape().layers();
        let work = PoseWork::of_layers(layers.iter().skip(1).copied());
        let modelled = core.pose_instructions(format, &work);
        let counted = number(&cells, "instructions_per_pose");
        let share = (modelled / counted - 1.0).abs();
        let row = format!("{} {} {}", core.name(), format.name(), network.name());
        assert!(share < INSTRUCTIONS_SHARE, "{row}: {modelled:.0}, counted {counted}");
    }
}

#[test]
fn code_and_stack_are_those_counted_within_a_tenth() {
    for (core, format, _, cells) in rows() {
        let cost = core.cost(format);
        let stacks = ["load", "sample", "fold", "pose"]
            .map(|part| number(&cells, &format!("{part}_stack_bytes")));
        let stack = stacks.into_iter().fold(0.0, f64::max);
        for (planned, counted) in
            [(cost.code_bytes, number(&cells, "code_bytes")), (cost.stack_bytes, stack)]
        {
            let share = (f64::from(planned) / counted - 1.0).abs();
            assert!(
                share < BYTES_SHARE,
                "{} {}: {planned}, counted {counted}",
                core.name(),
                format.name()
            );
        }
    }
}

#[test]
fn cycles_per_instruction_are_the_simulators() {
    for core in Core::ALL {
        let target =
            Target::ALL.into_iter().find(|target| target.name() == core.name()).expect("a target");
        for format in NumberFormat::ALL {
            let estimate = Estimate::new(target, format, 1);
            assert_eq!(core.cycles_per_instruction(format), estimate.cycles_per_instruction);
        }
    }
}
