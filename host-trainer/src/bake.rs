//! New motions → files that other software and firmware play as they are.
//!
//! In:  [`Motion`]s, the servos.
//! Out: the bytes of every file, and remarks about whatever a format could not hold exactly.
//!
//! Why here: people try a motion in the tool that they have before they change firmware. `generate` writes what
//! is looked at and measured; this writes what is played. Every format is read back by a parser in its own test.

pub mod servo;
pub mod pulse_track;
mod blender;
mod bottango;
mod maestro;
mod c_header;
mod reachy;
mod joint_trajectory;
mod rust_constant;

#[cfg(test)]
pub mod specimen;

use std::path::{Path, PathBuf};

use crate::calibration::Servo;
use crate::error::{Error, Result};
use crate::export::{self, ExportFormat, Motion};
use pulse_track::PulseTrack;

/// What to bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum BakeFormat {
    /// Blender Servo Animation: a header for its Arduino library. Pulses
    BlenderH,
    /// Blender Servo Animation: the stream, for SD cards. Pulses
    BlenderBin,
    /// Blender Servo Animation: JSON. Pulses
    BlenderJson,
    /// Bottango's generated code: cubic curves, up to 32 motions. Pulses
    Bottango,
    /// Pololu Maestro Control Center: settings with one sequence a motion. Pulses
    Maestro,
    /// Reachy Mini recorded move; models with its channels only
    Reachy,
    /// ROS 2 trajectory_msgs/JointTrajectory as YAML: positions and velocities of scalar channels
    JointTrajectory,
    /// Values in channel units with times
    Csv,
    /// Joint rotations, or one single-axis joint for every scalar in degrees or radians
    Bvh,
    /// One C header with all motions: stdint.h, PROGMEM by macro. Pulses
    CHeader,
    /// One Rust file with all motions as constants. Pulses
    Rust,
}

/// Files with their bytes, and what has to be said about them.
pub type Baked = (Vec<(PathBuf, Vec<u8>)>, Vec<String>);

impl BakeFormat {
    /// The file name extension.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::BlenderH | Self::CHeader => "h",
            Self::BlenderBin => "bin",
            Self::BlenderJson | Self::Reachy => "json",
            Self::Bottango => "cpp",
            Self::Maestro => "xml",
            Self::JointTrajectory => "yaml",
            Self::Csv => "csv",
            Self::Bvh => "bvh",
            Self::Rust => "rs",
        }
    }

    /// Whether the format holds pulse widths, so that servos have to be known.
    pub const fn has_pulses(self) -> bool {
        !matches!(self, Self::Reachy | Self::JointTrajectory | Self::Csv | Self::Bvh)
    }

    /// Whether all motions go together.
    pub const fn takes_all(self) -> bool {
        matches!(self, Self::Bottango | Self::Maestro | Self::CHeader | Self::Rust)
    }
}

/// What some formats need to know.
#[derive(Clone, Copy, Debug)]
pub struct BakeOptions<'a> {
    /// Of formats that hold pulses.
    pub servos: &'a [Servo],
    /// Bottango: the pin of every servo; empty: from 2 on.
    pub pins: &'a [u8],
    /// Bottango: how far a curve may be from the motion, µs.
    pub tolerance_us: f64,
}

/// Bakes motions, one or more, to files in or at `out`; nothing is written yet.
///
/// # Errors
/// A motion that the format cannot hold, by name; `out` is a file where there must be several.
pub fn bake(
    motions: &[Motion],
    format: BakeFormat,
    options: &BakeOptions<'_>,
    out: &Path,
) -> Result<Baked> {
    let mut remarks = Vec::new();
    if format.takes_all() {
        let files = bake_together(motions, format, options, out, &mut remarks)?;
        return Ok((files, remarks));
    }
    check_place(motions, format, out)?;
    let mut files = Vec::new();
    for motion in motions {
        let path = place(out, format, &identifier(motion));
        let bytes = bake_one(motion, format, options, &path, &mut remarks)?;
        files.push((path, bytes));
    }
    Ok((files, remarks))
}

fn bake_together(
    motions: &[Motion],
    format: BakeFormat,
    options: &BakeOptions<'_>,
    out: &Path,
    remarks: &mut Vec<String>,
) -> Result<Vec<(PathBuf, Vec<u8>)>> {
    let track = |motion| PulseTrack::new(motion, options.servos, remarks);
    let tracks: Vec<PulseTrack<'_>> = motions.iter().map(track).collect();
    let text = match format {
        BakeFormat::Bottango => {
            let files = bottango::emit(&tracks, options.pins, options.tolerance_us, remarks)?;
            let names =
                ["h", "cpp"].map(|extension| format!("GeneratedCodeAnimations.{extension}"));
            let named = names.into_iter().zip(files);
            return Ok(named.map(|(name, text)| (out.join(name), text.into_bytes())).collect());
        }
        BakeFormat::Maestro => maestro::emit(&tracks, remarks)?,
        BakeFormat::Rust => rust_constant::emit(&tracks),
        _ => c_header::emit(&tracks),
    };
    let stem = motions.first().map_or_else(String::new, action_name);
    Ok(vec![(place(out, format, &stem), text.into_bytes())])
}

fn bake_one(
    motion: &Motion,
    format: BakeFormat,
    options: &BakeOptions<'_>,
    path: &Path,
    remarks: &mut Vec<String>,
) -> Result<Vec<u8>> {
    match format {
        BakeFormat::Reachy => return reachy::emit(motion),
        BakeFormat::JointTrajectory => return joint_trajectory::emit(motion, remarks),
        BakeFormat::Csv => return export::encode_poses(motion, ExportFormat::Csv, path),
        BakeFormat::Bvh => return export::encode_poses(motion, ExportFormat::Bvh, path),
        _ => (),
    }
    let track = PulseTrack::new(motion, options.servos, remarks);
    match format {
        BakeFormat::BlenderH => blender::header(&track, remarks).map(String::into_bytes),
        BakeFormat::BlenderJson => blender::json(&track, remarks),
        _ => blender::stream(&track, remarks),
    }
}

/// `out` itself when it names a file of the format, else a file in that folder.
fn place(out: &Path, format: BakeFormat, stem: &str) -> PathBuf {
    match is_file(out, format) {
        true => out.to_owned(),
        false => out.join(format!("{stem}.{}", format.extension())),
    }
}

fn is_file(out: &Path, format: BakeFormat) -> bool {
    // Bottango's files have names of their own.
    format != BakeFormat::Bottango
        && out.extension().is_some_and(|extension| extension == format.extension())
        && !out.is_dir()
}

fn check_place(motions: &[Motion], format: BakeFormat, out: &Path) -> Result<()> {
    if motions.len() > 1 && is_file(out, format) {
        let value = format!("one file for {} motions", motions.len());
        let remedy =
            "name a folder, or bake a format that takes all of them: maestro, c-header, rust";
        return Err(Error::bad_input(out, "--out", value, "a folder", remedy));
    }
    Ok(())
}

/// Who made a motion, and how to make it again; one line without anything that ends a comment.
pub(crate) fn credit(motion: &Motion) -> String {
    let line = format!(
        "karakuri host-trainer {} from {}: {}, {} s, seed {}, {} Hz",
        env!("CARGO_PKG_VERSION"),
        motion.provenance,
        motion.action,
        motion.seconds,
        motion.seed,
        motion.rate_hz
    );
    line.replace(['\r', '\n'], " ").replace("*/", "* /").replace("--", "- -")
}

/// `nod_seed7`: a name for files and for code.
pub(crate) fn identifier(motion: &Motion) -> String {
    format!("{}_seed{}", action_name(motion), motion.seed)
}

fn action_name(motion: &Motion) -> String {
    identifier_of(&motion.action)
}

/// Whatever no identifier may have becomes an underscore.
pub(crate) fn identifier_of(name: &str) -> String {
    let safe = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    let safe: String = safe.collect();
    match safe.starts_with(|c: char| c.is_ascii_digit()) || safe.is_empty() {
        true => format!("_{safe}"),
        false => safe,
    }
}
