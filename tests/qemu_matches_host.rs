//! The emulated chip computes what the host computes: `firmware-sim run` on the committed blobs.
//!
//! Why here: the promise that matters most, checked where nothing but a blob and two programs is involved.

use firmware_sim::parity::POSE_COUNT_MIN;
use tests::{FLOAT_FORMAT, GOLDEN_BLOBS, Outcome, Program, golden_path, repository, skip};

/// `firmware-sim`'s exit code where QEMU or a cross-compiler is missing.
const MISSING_TOOL: i32 = 6;

/// The answer of the simulator, unless this machine cannot give one.
fn run(blob: &str) -> Option<Outcome> {
    let path = golden_path(blob);
    let arguments = [
        "run".as_ref(),
        path.as_os_str(),
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
        let Some(outcome) = run(blob) else { return };
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
