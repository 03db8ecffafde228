//! `firmware-sim run`: does a chip compute the host's bits?

use std::path::PathBuf;

use karakuri::Pose;

use super::{print_json, progress_bar, read_blob};
use crate::error::Result;
use crate::parity::{F16_TOLERANCE, POSE_COUNT_MIN, Parity, run_parity};
use crate::target::Target;

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
pub struct RunArgs {
    /// Blob of `host-trainer quantize`
    model: PathBuf,
    /// Processor to build for and to emulate
    #[arg(long, value_enum, default_value_t = Target::CortexM4)]
    target: Target,
    /// Least number of poses to compare
    #[arg(long, value_name = "N", default_value_t = POSE_COUNT_MIN as u32,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    poses: u32,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Proves the blob on the target; false if the device broke the format's promise.
///
/// # Errors
/// See [`run_parity`].
pub fn run(args: &RunArgs) -> Result<bool> {
    let blob = read_blob(&args.model)?;
    let progress = progress_bar();
    let parity = run_parity(&blob, args.target, args.poses as usize, &progress)
        .map_err(|error| error.in_file(&args.model));
    progress.finish_and_clear();
    let parity = parity?;
    if args.json {
        print_json(&parity)?
    } else {
        print_table(&parity)
    }
    Ok(parity.passes())
}

fn print_table(parity: &Parity) {
    let line = |name: &str, value: String| println!("{name:<16}{value}");
    let core = match parity.emulated_core {
        core if core == parity.target => String::new(),
        core => format!(", its code on a {core}"),
    };
    line("target", format!("{} (QEMU {}{core})", parity.target, parity.machine));
    line("blob", format!("{}, {} bytes", parity.number_format, parity.blob_bytes));
    let [actions, lengths, motions] =
        [parity.action_count, parity.length_count, parity.motion_count];
    line("motions", format!("{motions}: {actions} actions, {lengths} lengths, a seed each"));
    line("poses compared", parity.pose_count.to_string());
    line("bits compared", parity.differences.bits_compared.to_string());
    line("bits differing", differing(parity));
    if let Some(share) = parity.tolerance_used {
        let percent = 100.0 * F16_TOLERANCE;
        line("tolerance", format!("{share:.3} used of {percent:.2} % of each channel's travel"));
    }
    if let Some(first) = parity.differences.first {
        let value = |bits: i32| f64::from(bits) / f64::from(1 << Pose::FRACTION_BITS);
        let (host, device) = (value(first.host), value(first.device));
        let place = format!("pose {} channel {}", first.pose, first.channel);
        line("first", format!("{place}: host {host:.6}, device {device:.6}"));
    }
    let ram = parity.ram;
    line("RAM", format!("{} bytes stack + {} static", ram.stack_bytes_max, ram.static_bytes));
    line("emulation", format!("{:.1} s", parity.emulation_s));
    line("verdict", if parity.passes() { "pass".to_owned() } else { "FAIL".to_owned() });
}

fn differing(parity: &Parity) -> String {
    match (parity.differences.bits_differing, parity.differences.poses_differing) {
        (0, _) => "0".to_owned(),
        (bits, poses) => format!("{bits} in {poses} poses"),
    }
}
