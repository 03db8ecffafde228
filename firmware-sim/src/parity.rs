//! Proves that a chip computes what the host computes: the same cases on both, compared bit by bit.
//!
//! In:  a blob, a [`Target`].
//! Out: [`Parity`].
//!
//! Why here: integer formats promise the same bits on every machine, so one differing bit is a failure. `f16` rests on
//! the machine's f32 arithmetic and promises only [`F16_TOLERANCE`].

use std::collections::HashSet;
use std::hash::Hash;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use karakuri::{Model, NumberFormat};
use serde::Serialize;

use crate::case::Case;
use crate::choose_cases::choose_cases;
use crate::error::{Error, Result};
use crate::firmware::Firmware;
use crate::host::decode_cases;
use crate::qemu::{self, Qemu};
use crate::target::Target;
use crate::transcript::{Ram, Transcript};

/// Poses that a proof compares unless told otherwise; the least that the project asks for.
pub const POSE_COUNT_MIN: usize = 1_000;

/// Largest difference of an `f16` channel, as a share of the channel's travel over the compared poses.
///
/// Both sides do the same IEEE operations in the same order, so no difference is expected. A compiler that fuses
/// multiply and add, or another `expm1f`, moves a sum of 1,000 products by about 2^-24 · √1000 of its terms;
/// 2^-10 leaves room for several layers of that and is still below what a servo resolves.
pub const F16_TOLERANCE: f64 = 1.0 / 1024.0;

/// Smallest difference that the `f16` tolerance allows even to a channel that does not move: 2 LSB of a pose.
const F16_TOLERANCE_LSB: f64 = 2.0;

/// A pose takes a Cortex-M0+ with software floats and a large model seconds; longer silence is a hang.
const SILENCE_MAX: Duration = Duration::from_secs(120);

/// Result of one proof.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parity {
    /// Name of the target.
    pub target: &'static str,
    /// QEMU's board.
    pub machine: &'static str,
    /// QEMU's core on that board.
    pub emulated_core: &'static str,
    /// Number format of the blob.
    pub number_format: &'static str,
    /// Bytes of the blob.
    pub blob_bytes: usize,
    /// Actions among the cases.
    pub action_count: usize,
    /// Distinct lengths among the cases.
    pub length_count: usize,
    /// Motions: one per action, length and seed.
    pub motion_count: usize,
    /// Poses compared.
    pub pose_count: usize,
    /// How the two sides differ.
    pub differences: Differences,
    /// Largest difference as a share of the tolerance; `None` for formats that tolerate nothing.
    pub tolerance_used: Option<f64>,
    /// Memory that the program used on the device.
    pub ram: Ram,
    /// Duration of the emulation. It says nothing about the chip.
    pub emulation_s: f64,
}

impl Parity {
    /// Whether the device kept the format's promise.
    pub fn passes(&self) -> bool {
        match self.tolerance_used {
            None => self.differences.bits_differing == 0,
            Some(share) => share <= 1.0,
        }
    }
}

/// A bitwise comparison of two lists of poses.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Differences {
    /// Bits compared, 32 a channel.
    pub bits_compared: u64,
    /// Bits that differ.
    pub bits_differing: u64,
    /// Poses with at least one of them.
    pub poses_differing: usize,
    /// The first channel with one of them.
    pub first: Option<Difference>,
}

/// One channel that differs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// Index of the pose among all.
    pub pose: usize,
    /// Index of the channel.
    pub channel: usize,
    /// The host's value, Q15.16 in channel units.
    pub host: i32,
    /// The device's value, Q15.16 in channel units.
    pub device: i32,
}

/// Builds the firmware, runs it in QEMU and compares at least `pose_count_min` poses.
///
/// `progress` counts the poses that arrive; `ProgressBar::hidden()` for none.
///
/// # Errors
/// [`Error::Blob`]; [`Error::MissingTool`] without QEMU or cross-compiler; [`Error::Build`]; [`Error::Firmware`] if the
/// program does not end, or not with one pose per position. A difference is no error: see [`Parity::passes`].
pub fn run_parity(
    blob: &[u8],
    target: Target,
    pose_count_min: usize,
    progress: &ProgressBar,
) -> Result<Parity> {
    let model = Model::from_bytes(blob)?;
    let cases = choose_cases(&model, pose_count_min);
    let host = decode_cases(&model, &cases)?;
    let qemu = Qemu { program: qemu::PROGRAM, silence_max: SILENCE_MAX };
    qemu.check_installed()?;
    progress.set_message(format!("building for {}", target.name()));
    let firmware = Firmware::build(blob, &cases, target)?;
    progress.set_length(host.len() as u64);
    progress.set_message(format!("decoding on {}", target.machine()));
    let start = Instant::now();
    let transcript = run_on_device(qemu, &firmware, target, progress)?;
    let emulation_s = start.elapsed().as_secs_f64();
    let ram = check_complete(&transcript, &host)?;
    let device = transcript.poses;
    let format = model.number_format();
    Ok(Parity {
        target: target.name(),
        machine: target.machine(),
        emulated_core: target.emulated_core(),
        number_format: format.name(),
        blob_bytes: blob.len(),
        action_count: distinct_count(&cases, |case| case.action),
        length_count: distinct_count(&cases, |case| case.frames),
        motion_count: cases.len(),
        pose_count: host.len(),
        differences: compare_bits(&host, &device),
        tolerance_used: (format == NumberFormat::F16).then(|| tolerance_used(&host, &device)),
        ram,
        emulation_s,
    })
}

fn run_on_device(
    qemu: Qemu<'_>,
    firmware: &Firmware,
    target: Target,
    progress: &ProgressBar,
) -> Result<Transcript> {
    let mut transcript = Transcript::default();
    let mut unreadable = None;
    qemu.run(firmware.elf(), target, |line| {
        if let Err(error) = transcript.read_line(line) {
            unreadable.get_or_insert(error);
        }
        progress.set_position(transcript.poses.len() as u64);
    })?;
    unreadable.map_or(Ok(transcript), Err)
}

/// A program that prints too little must not pass as one without differences.
pub(crate) fn check_complete(transcript: &Transcript, host: &[Vec<i32>]) -> Result<Ram> {
    let incomplete = |log: String| Error::Firmware { reason: "incomplete output".into(), log };
    if transcript.poses.len() != host.len() {
        let found = transcript.poses.len();
        return Err(incomplete(format!("{found} poses, expected {}", host.len())));
    }
    let mut pairs = host.iter().zip(&transcript.poses);
    if let Some(index) = pairs.position(|(host, device)| host.len() != device.len()) {
        return Err(incomplete(format!("pose {index} has another number of channels")));
    }
    transcript.ram.ok_or_else(|| incomplete("no line `ram`".into()))
}

/// Both lists have the same shape: `check_complete`.
pub(crate) fn compare_bits(host: &[Vec<i32>], device: &[Vec<i32>]) -> Differences {
    let mut differences = Differences::default();
    for (pose, (host, device)) in host.iter().zip(device).enumerate() {
        differences.bits_compared += 32 * host.len() as u64;
        differences.poses_differing += usize::from(host != device);
        for (channel, (&host, &device)) in host.iter().zip(device).enumerate() {
            let bits = (host ^ device).count_ones();
            differences.bits_differing += u64::from(bits);
            if bits != 0 {
                let first = Difference { pose, channel, host, device };
                differences.first.get_or_insert(first);
            }
        }
    }
    differences
}

/// Largest difference in units of what [`F16_TOLERANCE`] allows to its channel.
fn tolerance_used(host: &[Vec<i32>], device: &[Vec<i32>]) -> f64 {
    let channel_count = host.first().map_or(0, Vec::len);
    let share = |channel: usize| {
        let values = || host.iter().map(|pose| f64::from(pose[channel]));
        let travel = values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min);
        let differences =
            values().zip(device).map(|(a, pose)| (a - f64::from(pose[channel])).abs());
        differences.fold(0.0, f64::max) / (F16_TOLERANCE * travel).max(F16_TOLERANCE_LSB)
    };
    (0..channel_count).map(share).fold(0.0, f64::max)
}

fn distinct_count<Key: Eq + Hash>(cases: &[Case], key: impl Fn(&Case) -> Key) -> usize {
    cases.iter().map(key).collect::<HashSet<_>>().len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_are_no_blob_are_rejected_before_anything_is_built() {
        let outcome = run_parity(b"no blob", Target::CortexM4, 1, &ProgressBar::hidden());
        assert_eq!(outcome.unwrap_err().exit_code(), 5);
    }

    #[test]
    fn too_few_poses_are_an_error_not_a_pass() {
        let transcript = Transcript { poses: vec![vec![1]], ram: Some(Ram::default()) };
        assert!(check_complete(&transcript, &[vec![1], vec![2]]).is_err());
    }

    #[test]
    fn pose_with_a_channel_less_is_an_error() {
        let transcript = Transcript { poses: vec![vec![1]], ram: Some(Ram::default()) };
        assert!(check_complete(&transcript, &[vec![1, 2]]).is_err());
    }

    #[test]
    fn output_without_its_last_line_is_an_error() {
        let transcript = Transcript { poses: vec![vec![1]], ram: None };
        assert!(check_complete(&transcript, &[vec![1]]).is_err());
    }

    #[test]
    fn one_flipped_bit_is_found_where_it_is() {
        let host = vec![vec![0, 0], vec![5, 0x1000]];
        let device = vec![vec![0, 0], vec![5, 0x1001]];
        let found = compare_bits(&host, &device);
        let first = Difference { pose: 1, channel: 1, host: 0x1000, device: 0x1001 };
        let expected = Differences {
            bits_compared: 128,
            bits_differing: 1,
            poses_differing: 1,
            first: Some(first),
        };
        assert_eq!(found, expected);
    }

    #[test]
    fn f16_tolerance_follows_the_travel_of_the_channel() {
        let host = vec![vec![0], vec![1 << 20]];
        assert_eq!(tolerance_used(&host, &[vec![1 << 10], vec![1 << 20]]), 1.0);
        assert_eq!(tolerance_used(&[vec![7]], &[vec![8]]), 0.5);
    }
}
