//! `firmware-sim run`: does a chip compute the host's bits?

use std::path::PathBuf;

use karakuri::Pose;

use super::{print_json, progress_bar, read_blob};
use crate::error::Result;
use crate::parity::{Difference, F16_TOLERANCE, POSE_COUNT_MIN, Parity, run_parity};
use crate::target::Target;

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  firmware-sim run creature.kara --target cortex-m4")]
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
    for (name, value) in facts(parity) {
        println!("{name:<16}{value}");
    }
}

/// Name and value of every line; the last is the verdict, complete in itself.
fn facts(parity: &Parity) -> Vec<(&'static str, String)> {
    let Parity { target, machine, emulated_core, differences, ram, .. } = parity;
    let stand_in = if emulated_core == target {
        String::new()
    } else {
        format!(", its code on a {emulated_core}")
    };
    let [actions, lengths] = [parity.action_count, parity.length_count];
    let motions =
        format!("{}: {actions} actions, {lengths} lengths, a seed each", parity.motion_count);
    let mut facts = vec![
        ("target", format!("{target} (QEMU {machine}{stand_in})")),
        ("blob", format!("{}, {} bytes", parity.number_format, parity.blob_bytes)),
        ("motions", motions),
        ("bits compared", differences.bits_compared.to_string()),
        ("RAM", format!("{} bytes stack + {} static", ram.stack_bytes_max, ram.static_bytes)),
        ("emulation", format!("{:.1} s", parity.emulation_s)),
    ];
    if let Some(share) = parity.tolerance_used {
        let percent = 100.0 * F16_TOLERANCE;
        facts.push((
            "tolerance",
            format!("{share:.3} used of {percent:.2} % of a channel's travel"),
        ));
    }
    facts.extend(differences.first.map(|first| ("first", describe(first))));
    let word = if parity.passes() { "equal" } else { "DIFFERENT" };
    let (poses, bits) = (parity.pose_count, differences.bits_differing);
    let mut verdict = format!("{word}: {poses} poses on {target}, {bits} bits differing");
    if bits != 0 {
        verdict += &format!(" in {} poses", differences.poses_differing);
    }
    facts.push(("verdict", verdict));
    facts
}

fn describe(first: Difference) -> String {
    let value = |bits: i32| f64::from(bits) / f64::from(1 << Pose::FRACTION_BITS);
    let (host, device) = (value(first.host), value(first.device));
    format!("pose {} channel {}: host {host:.6}, device {device:.6}", first.pose, first.channel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parity::Differences;
    use crate::transcript::Ram;

    fn parity(differences: Differences, tolerance_used: Option<f64>) -> Parity {
        Parity {
            target: Target::CortexM0Plus.name(),
            machine: Target::CortexM0Plus.machine(),
            emulated_core: Target::CortexM0Plus.emulated_core(),
            number_format: "f16",
            blob_bytes: 2,
            action_count: 1,
            length_count: 1,
            motion_count: 1,
            pose_count: 3,
            differences,
            tolerance_used,
            ram: Ram::default(),
            emulation_s: 0.0,
        }
    }

    #[test]
    fn one_differing_bit_fails_an_integer_format_and_is_described() {
        let first = Difference { pose: 1, channel: 2, host: 65_536, device: 65_537 };
        let differences = Differences {
            bits_compared: 96,
            bits_differing: 1,
            poses_differing: 1,
            first: Some(first),
        };
        let parity = parity(differences.clone(), None);
        assert!(!parity.passes());
        let text = format!("{:?}", facts(&parity));
        assert!(text.contains("pose 1 channel 2: host 1.000000, device 1.000015"), "{text}");
        assert!(text.contains("DIFFERENT: 3 poses on cortex-m0plus, 1 bits differing in 1 poses"));
    }

    #[test]
    fn tolerance_decides_for_f16() {
        assert!(parity(Differences::default(), Some(1.0)).passes());
        assert!(!parity(Differences::default(), Some(1.01)).passes());
    }
}
