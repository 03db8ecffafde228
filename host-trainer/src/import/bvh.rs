//! Station 1: Biovision hierarchies → root translation and one rotation a joint.
//!
//! Every joint has a local transform: a translation from its parent (its `OFFSET`, or its position channels, which
//! replace the offset) and the product of its rotations in listed order. Where all clips keep a translation still it is
//! a bone and goes into the skeleton; what moves becomes channels.
//!
//! Source: Meredith and Maddock, "Motion capture file formats explained", 2001; the position rule is that of Blender's
//! reader and of the files of the Bandai Namco set, where every joint carries six channels.

mod joint_motion;
mod parser;

use std::path::Path;

use super::files::ClipFile;
use super::resample::{resample, rounded_rate_hz};
use super::{ImportOptions, Recordings, Remarks, check_poses, check_rate, with_progress};
use crate::error::{Error, Result};
use crate::layout::Unit;
use crate::rotation::Rotation;
use joint_motion::JointMotion;
use parser::{Bvh, Channel, Joint};

/// Reads every file; all must have the joints and, unless `--fps` is given, the rate of the first.
pub(crate) fn read(
    files: &[ClipFile],
    options: &ImportOptions,
    remarks: &mut Remarks,
) -> Result<Recordings> {
    let first = &files[0].path;
    let mut motion: Option<JointMotion> = None;
    let mut set_rate_hz = options.rate_hz;
    for file in with_progress(files) {
        let bytes = std::fs::read(&file.path).map_err(Error::io("read", &file.path))?;
        let bvh = parser::parse(&file.path, &bytes)?;
        check_finite(&file.path, &bvh, options)?;
        let motion = motion.get_or_insert_with(|| JointMotion {
            joints: bvh.joints.clone(),
            unit: options.unit.unwrap_or(Unit::Centimetre),
            clips: Vec::with_capacity(files.len()),
        });
        check_same_joints(&file.path, &bvh.joints, first, &motion.joints)?;
        let own_rate_hz = rounded_rate_hz(bvh.frame_time_s);
        check_rate(&file.path, own_rate_hz)?;
        let rate_hz = *set_rate_hz.get_or_insert(own_rate_hz);
        let layout = motion.layout();
        let mut poses = transforms(&bvh, options.scale.unwrap_or(1.0));
        if own_rate_hz != rate_hz {
            check_rate_is_chosen(&file.path, own_rate_hz, rate_hz, options)?;
            let frame_count = poses.len() / layout.channel_count();
            let times_s: Vec<f64> = (0..frame_count).map(|i| i as f64 / own_rate_hz).collect();
            poses = resample(&layout, &times_s, &poses, rate_hz);
            remarks.note(
                &file.path,
                format!("resampled to {rate_hz} poses per second"),
            );
        }
        check_poses(&file.path, &layout, &poses, options)?;
        motion.clips.push(poses);
    }
    let (Some(motion), Some(rate_hz)) = (motion, set_rate_hz) else {
        return Err(Error::bad_input(
            first,
            "files",
            "none",
            "a BVH file",
            "name a folder",
        ));
    };
    Ok(motion.into_recordings(rate_hz, first, remarks))
}

/// Names the first value that is no number; here, because a rotation hides which of its angles was wrong.
fn check_finite(file: &Path, bvh: &Bvh, options: &ImportOptions) -> Result<()> {
    let bad = bvh.values.iter().position(|value| !value.is_finite());
    let Some(index) = bad.filter(|_| !options.tolerate_non_finite) else {
        return Ok(());
    };
    let names: Vec<String> = bvh.joints.iter().flat_map(channel_names).collect();
    let field = format!(
        "frame {}, {}",
        index / names.len(),
        names[index % names.len()]
    );
    let remedy = "repair or remove the clip";
    Err(Error::bad_input(
        file,
        field,
        bvh.values[index],
        "a finite number",
        remedy,
    ))
}

fn channel_names(joint: &Joint) -> impl Iterator<Item = String> {
    joint.channels.iter().map(|channel| match channel {
        Channel::Position(axis) => format!("{} {}position", joint.name, ["X", "Y", "Z"][*axis]),
        Channel::Rotation(axis) => format!("{} {}rotation", joint.name, ["X", "Y", "Z"][*axis]),
    })
}

/// Same joints in the same tree; offsets may differ, as bodies do, and channel orders do not matter.
fn check_same_joints(file: &Path, joints: &[Joint], first: &Path, wanted: &[Joint]) -> Result<()> {
    let remedy = "import files of different skeletons separately";
    if joints.len() != wanted.len() {
        let value = format!("{} joints", joints.len());
        let expected = format!("{} as in {}", wanted.len(), first.display());
        return Err(Error::bad_input(file, "hierarchy", value, expected, remedy));
    }
    let differs = |(a, b): &(&Joint, &Joint)| a.name != b.name || a.parent != b.parent;
    match joints.iter().zip(wanted).find(differs) {
        None => Ok(()),
        Some((joint, wanted)) => {
            let expected = format!("{} in its place, as in {}", wanted.name, first.display());
            Err(Error::bad_input(
                file,
                "joint",
                &joint.name,
                expected,
                remedy,
            ))
        }
    }
}

fn check_rate_is_chosen(
    file: &Path,
    own_rate_hz: f64,
    rate_hz: f64,
    options: &ImportOptions,
) -> Result<()> {
    if options.rate_hz.is_some() {
        return Ok(());
    }
    let value = format!("{own_rate_hz} poses per second");
    let expected = format!("{rate_hz} as in the first file");
    let remedy = "choose one rate for all with --fps";
    Err(Error::bad_input(
        file,
        "Frame Time",
        value,
        expected,
        remedy,
    ))
}

/// Local transforms: translation scaled by `scale`, then the 6D rotation. // (frame, joint, 9)
fn transforms(bvh: &Bvh, scale: f64) -> Vec<f32> {
    let mut transforms = Vec::new();
    for frame in bvh.values.chunks_exact(bvh.channel_count()) {
        let mut rest = frame;
        for joint in &bvh.joints {
            let (values, others) = rest.split_at(joint.channels.len());
            rest = others;
            let (translation, rotation) = transform(joint, values);
            transforms.extend(translation.map(|component| (component * scale) as f32));
            transforms.extend(rotation.map(|element| element as f32));
        }
    }
    transforms
}

fn transform(joint: &Joint, values: &[f64]) -> ([f64; 3], [f64; 6]) {
    let mut translation = joint.offset;
    let mut rotation = Rotation::IDENTITY;
    let mut is_finite = true;
    for (channel, &value) in joint.channels.iter().zip(values) {
        match *channel {
            Channel::Position(axis) => translation[axis] = value,
            Channel::Rotation(axis) => {
                let mut vector = [0.0; 3];
                vector[axis] = value.to_radians();
                rotation = rotation.after(&Rotation::from_rotation_vector(vector));
                is_finite &= value.is_finite();
            }
        }
    }
    // A NaN angle must show as NaN, where `inspect` tolerates it to report it.
    let rotation = if is_finite {
        rotation.to_6d()
    } else {
        [f64::NAN; 6]
    };
    (translation, rotation)
}
