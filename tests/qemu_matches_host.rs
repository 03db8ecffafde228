//! The emulated chip computes what the host computes: `firmware-sim run` on the committed blobs.
//!
//! Why here: the promise that matters most, checked where nothing but a blob and two programs is involved.

use std::path::Path;

use firmware_sim::parity::POSE_COUNT_MIN;
use tests::{
    FLOAT_FORMAT, GOLDEN_BLOBS, Outcome, Program, golden_path, host_trainer, repository, skip,
    workplace, workplace_with_phases,
};

/// `firmware-sim`'s exit code where QEMU or a cross-compiler is missing.
const MISSING_TOOL: i32 = 6;

/// … and where the program on the chip stopped.
const STOPPED: i32 = 7;

/// The answer of the simulator, unless this machine cannot give one.
fn run(blob: &Path) -> Option<Outcome> {
    let arguments = [
        "run".as_ref(),
        blob.as_os_str(),
        "--target".as_ref(),
        "cortex-m4".as_ref(),
        "--json".as_ref(),
    ];
    let outcome = Program::FirmwareSim.run(&repository(), arguments);
    if outcome.code == Some(MISSING_TOOL) {
        skip(outcome.stderr.trim());
        return None;
    }
    Some(outcome)
}

#[test]
fn a_cortex_m4_decodes_the_committed_blobs_as_the_host_does() {
    assert_eq!(POSE_COUNT_MIN, 1_000);
    let mut table =
        "format  poses  actions  lengths  bits compared  bits differing  tolerance used\n"
            .to_owned();
    for (format, blob) in GOLDEN_BLOBS {
        let Some(outcome) = run(&golden_path(blob)) else { return };
        let parity = outcome.succeeded().json();
        let count = |key: &str| parity[key].as_u64().unwrap_or_default();
        let bits = |key: &str| parity["differences"][key].as_u64().unwrap_or(u64::MAX);
        let tolerance = parity["tolerance_used"].as_f64();
        table += &format!(
            "{format:<6} {:>6} {:>8} {:>8} {:>14} {:>15} {:>15}\n",
            count("pose_count"),
            count("action_count"),
            count("length_count"),
            bits("bits_compared"),
            bits("bits_differing"),
            tolerance.map_or("-".into(), |share| format!("{share:.3}")),
        );
        assert_eq!(parity["number_format"], format);
        assert!(
            count("pose_count") >= 1_000 && count("action_count") > 1 && count("length_count") > 1,
            "{table}"
        );
        match tolerance {
            Some(share) => assert!(format == FLOAT_FORMAT && share <= 1.0, "{table}"),
            None => assert!(format != FLOAT_FORMAT && bits("bits_differing") == 0, "{table}"),
        }
    }
    println!("{table}");
}

/// What `quantize` writes with these flags, on the chip.
fn run_quantized(flags: &str) -> Option<Outcome> {
    let folder = workplace();
    let line = format!("quantize creature {flags} --out quantized.kara");
    host_trainer(folder.path(), &line).succeeded();
    run(&folder.path().join("quantized.kara"))
}

#[test]
fn a_cortex_m4_turns_frequencies_as_the_host_does() {
    let folder = workplace_with_phases();
    for format in ["w8a16", "w8a8"] {
        let line = format!("quantize turned --format {format} --out {format}-turned.kara");
        host_trainer(folder.path(), &line).succeeded();
        let Some(outcome) = run(&folder.path().join(format!("{format}-turned.kara"))) else {
            return;
        };
        let parity = outcome.succeeded().json();
        assert_eq!(parity["differences"]["bits_differing"], 0, "{parity}");
    }
}

/// Never a wrong pose: the kernels in assembly would read such weights in another order.
#[test]
fn a_cortex_m4_refuses_weights_in_rows_by_name() {
    let Some(outcome) = run_quantized("--packing rows") else { return };
    outcome.refused(STOPPED, &["PackedForAnotherKernel", "Rows", "dsp"]);
}

#[test]
fn a_cortex_m4_reads_a_time_table_as_the_host_does() {
    let Some(outcome) = run_quantized("--format w8a8 --time-table 300") else { return };
    let parity = outcome.succeeded().json();
    assert_eq!(parity["differences"]["bits_differing"], 0, "{parity}");
}
