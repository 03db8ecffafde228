//! Station 1: Biovision hierarchies → root translation and one rotation a joint.
//!
//! Every joint has a local transform: a translation from its parent (its `OFFSET`, or its position
//! channels, which replace the offset) and the product of its rotations in listed order. Where all
//! clips keep a translation still it is a bone and goes into the skeleton; what moves becomes
//! channels.
//!
//! Source: Meredith and Maddock, "Motion capture file formats explained", 2001; the position rule
//! is that of Blender's reader and of the files of the Bandai Namco set, where every joint carries
//! six channels.

mod parser;
mod motion;
mod joint_motion;

use std::path::Path;

use super::files::ClipFile;
use super::resample::{resample, rounded_rate_hz};
use super::{ImportOptions, Recordings, Remarks, check_poses, check_rate, with_progress};
use crate::body::rotation::Rotation;
use crate::error::{Error, Result};
use crate::layout::Unit;
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
        let mut bvh = parser::parse(&file.path, &bytes)?;
        check_finite(&file.path, &bvh, options)?;
        scale_lengths(&mut bvh, options.scale.unwrap_or(1.0));
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
        let mut poses = transforms(&bvh);
        if own_rate_hz != rate_hz {
            check_rate_is_chosen(&file.path, own_rate_hz, rate_hz, options)?;
            let frame_count = poses.len() / layout.channel_count();
            let times_s: Vec<f64> = (0..frame_count).map(|i| i as f64 / own_rate_hz).collect();
            poses = resample(&layout, &times_s, &poses, rate_hz);
            remarks.note(&file.path, format!("resampled to {rate_hz} poses per second"));
        }
        check_poses(&file.path, &layout, &poses, options)?;
        motion.clips.push(poses);
    }
    let (Some(motion), Some(rate_hz)) = (motion, set_rate_hz) else {
        return Err(Error::bad_input(first, "files", "none", "a BVH file", "name a folder"));
    };
    Ok(motion.into_recordings(rate_hz, first, remarks))
}

/// Names the first value that is no number; here, because a rotation hides which of its angles was
/// wrong.
fn check_finite(file: &Path, bvh: &Bvh, options: &ImportOptions) -> Result<()> {
    let bad = bvh.values.iter().position(|value| !value.is_finite());
    let Some(index) = bad.filter(|_| !options.tolerate_non_finite) else {
        return Ok(());
    };
    let names: Vec<String> = bvh.joints.iter().flat_map(channel_names).collect();
    let field = format!("frame {}, {}", index / names.len(), names[index % names.len()]);
    let remedy = "repair or remove the clip";
    Err(Error::bad_input(file, field, bvh.values[index], "a finite number", remedy))
}

fn channel_names(joint: &Joint) -> impl Iterator<Item = String> {
    joint.channels.iter().map(|channel| match channel {
        Channel::Position(axis) => format!("{} {}position", joint.name, ["X", "Y", "Z"][*axis]),
        Channel::Rotation(axis) => format!("{} {}rotation", joint.name, ["X", "Y", "Z"][*axis]),
    })
}

/// Same joints in the same tree; offsets may differ, as bodies do, and channel orders do not
/// matter.
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
            Err(Error::bad_input(file, "joint", &joint.name, expected, remedy))
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
    Err(Error::bad_input(file, "Frame Time", value, expected, remedy))
}

/// Multiplies offsets and positions.
fn scale_lengths(bvh: &mut Bvh, scale: f64) {
    let is_position = |channel: &Channel| matches!(channel, Channel::Position(_));
    let positions: Vec<bool> =
        bvh.joints.iter().flat_map(|joint| joint.channels.iter().map(is_position)).collect();
    for frame in bvh.values.chunks_exact_mut(positions.len()) {
        let lengths = frame.iter_mut().zip(&positions).filter(|(_, is_position)| **is_position);
        lengths.for_each(|(value, _)| *value *= scale);
    }
    for component in bvh.joints.iter_mut().flat_map(|joint| &mut joint.offset) {
        *component *= scale;
    }
}

/// Local transforms: translation, then the 6D rotation. // (frame, joint, 9)
fn transforms(bvh: &Bvh) -> Vec<f32> {
    let mut transforms = Vec::new();
    for frame in bvh.values.chunks_exact(bvh.channel_count()) {
        let mut rest = frame;
        for joint in &bvh.joints {
            let (values, others) = rest.split_at(joint.channels.len());
            rest = others;
            let (translation, rotation) = transform(joint, values);
            transforms.extend(translation.map(|component| component as f32));
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
    let rotation = if is_finite { rotation.to_6d() } else { [f64::NAN; 6] };
    (translation, rotation)
}

#[cfg(test)]
mod tests {
    use super::super::read as import;
    use super::super::support::{assert_refused, folder};
    use super::*;
    use crate::clip::ClipSet;

    /// A still root above travelling hips with an arm and a still leg, at 20 Hz; every joint has
    /// six channels.
    ///
    /// `frames` holds, per frame, root, hips and arm, each x y z and turns about z, x, y in
    /// degrees.
    fn body(frames: &[[[f64; 6]; 3]]) -> String {
        let six = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation";
        let mut text = format!(
            "HIERARCHY ROOT World {{ OFFSET 0 0 0 {six} JOINT Hips {{ OFFSET 0 90 0 {six} \
             JOINT Arm {{ OFFSET 10 0 0 {six} }} \
             JOINT Leg {{ OFFSET 0 -40 0 {six} }} }} }}\nMOTION\nFrames: {}\nFrame Time: 0.05\n",
            frames.len()
        );
        for frame in frames {
            let numbers: Vec<String> = frame.as_flattened().iter().map(f64::to_string).collect();
            text += &format!("{} 0 -40 0 0 0 0\n", numbers.join(" "));
        }
        text
    }

    const STILL: [f64; 6] = [0.0; 6];
    const ARM: [f64; 6] = [10.0, 0.0, 0.0, 0.0, 0.0, 0.0];

    fn walking() -> Vec<[[f64; 6]; 3]> {
        (0..4).map(|i| [STILL, [f64::from(i), 90.0, 0.0, 0.0, 0.0, 0.0], ARM]).collect()
    }

    fn imported_with(
        files: &[(&str, String)],
        change: impl Fn(&mut ImportOptions),
    ) -> Result<ClipSet> {
        let files: Vec<(&str, &[u8])> =
            files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
        let folder = folder(&files);
        let mut options = ImportOptions { tolerate_missing_labels: true, ..Default::default() };
        change(&mut options);
        import(folder.path(), &options)
    }

    fn imported(files: &[(&str, String)]) -> Result<ClipSet> {
        imported_with(files, |_| ())
    }

    #[test]
    fn one_frame_is_refused() {
        let result = imported(&[("a.bvh", body(&walking()[..1]))]);
        assert_refused(result, &["a.bvh", "1 frame", "at least 2"]);
    }

    #[test]
    fn non_finite_value_is_refused_with_its_place_unless_tolerated() {
        let mut frames = walking();
        frames[2][1][3] = f64::NAN;
        let files = [("a.bvh", body(&frames))];
        assert_refused(imported(&files), &["a.bvh", "frame 2, Hips Zrotation", "NaN"]);
        let set = imported_with(&files, |options| options.tolerate_non_finite = true).unwrap();
        let count = set.clips[0].poses.iter().filter(|value| value.is_nan()).count();
        assert_eq!(count, 9, "the folded hips of one frame are not known");
    }

    #[test]
    fn different_skeletons_are_refused() {
        let renamed = body(&walking()).replace("Arm", "Wing");
        let result = imported(&[("a.bvh", body(&walking())), ("b.bvh", renamed)]);
        assert_refused(result, &["b.bvh", "joint is Wing", "Arm in its place"]);
        let shorter = "HIERARCHY ROOT World { OFFSET 0 0 0 CHANNELS 1 Xrotation }\nMOTION\n\
                       Frames: 2\nFrame Time: 0.05\n1\n2\n";
        let result = imported(&[("a.bvh", body(&walking())), ("b.bvh", shorter.into())]);
        assert_refused(result, &["b.bvh", "1 joints", "4 as in"]);
    }

    #[test]
    fn different_rates_are_refused_until_one_is_chosen() {
        let faster = body(&walking()).replace("0.05", "0.025");
        let files = [("a.bvh", body(&walking())), ("b.bvh", faster)];
        assert_refused(imported(&files), &["b.bvh", "40 poses per second", "20 as in", "--fps"]);
        let set = imported_with(&files, |options| options.rate_hz = Some(20.0)).unwrap();
        let lengths: Vec<usize> =
            set.clips.iter().map(|clip| clip.frame_count(&set.layout)).collect();
        assert_eq!(lengths, [4, 2]);
        assert!(set.remarks.iter().any(|remark| remark.contains("b.bvh: resampled to 20")));
    }

    #[test]
    fn rate_that_no_body_has_is_refused() {
        let result = imported(&[("a.bvh", body(&walking()).replace("0.05", "1e-9"))]);
        assert_refused(result, &["a.bvh", "rate is", "1.0..=1000.0"]);
    }

    #[test]
    fn rotations_multiply_in_listed_order() {
        let frame = [STILL, [0.0, 0.0, 0.0, 90.0, 90.0, 0.0], ARM];
        let set = imported(&[("a.bvh", body(&[frame, frame]))]).unwrap();
        let hips = set.layout.ranges().find(|(group, _)| group.name == "Hips").unwrap().1;
        // Rz(90) · Rx(90): y goes to z by the second and stays there by the first; x goes to y.
        let expected = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0];
        for (value, expected) in set.clips[0].poses[hips].iter().zip(expected) {
            assert!((value - expected).abs() < 1e-6, "{value} is not {expected}");
        }
    }

    #[test]
    fn still_translations_are_bones_and_still_roots_are_folded() {
        let set = imported(&[("a.bvh", body(&walking()))]).unwrap();
        let groups: Vec<&str> = set.layout.groups.iter().map(|group| group.name.as_str()).collect();
        assert_eq!(groups, ["root", "Hips", "Arm", "Leg"]);
        assert_eq!(set.clips[0].poses[21..24], [1.0, 90.0, 0.0]);
        let skeleton = set.skeleton.unwrap();
        assert_eq!(skeleton.names, ["Hips", "Arm", "Leg"]);
        assert_eq!(skeleton.parents, [None, Some(0), Some(0)]);
        assert_eq!(skeleton.offsets, [[0.0; 3], [10.0, 0.0, 0.0], [0.0, -40.0, 0.0]]);
        assert!(set.remarks[0].contains("World is folded into Hips"));
    }

    #[test]
    fn folding_keeps_the_child_where_it_is_in_the_world() {
        let world = [5.0, 0.0, 0.0, 90.0, 0.0, 0.0];
        let frames: Vec<_> =
            (0..3).map(|i| [world, [f64::from(i), 0.0, 0.0, 90.0, 0.0, 0.0], ARM]).collect();
        let set = imported(&[("a.bvh", body(&frames))]).unwrap();
        // The root turns x into y, so that hips at x = 2 stand at (5, 2, 0); two quarter turns are
        // a half turn.
        let expected = [5.0, 2.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0];
        let width = set.layout.channel_count();
        for (value, expected) in set.clips[0].poses[2 * width..].iter().zip(expected) {
            assert!((value - expected).abs() < 1e-6, "{value} is not {expected}");
        }
    }

    #[test]
    fn joint_that_also_travels_gets_channels_of_its_own() {
        let mut frames = walking();
        frames[2][2][1] = 3.0;
        let set = imported(&[("a.bvh", body(&frames))]).unwrap();
        let names = set.layout.channel_names().join(" ");
        assert!(names.contains("Arm_translation_y_cm"), "{names}");
        assert!(set.remarks.iter().any(|remark| remark.contains("Arm also travels")));
    }

    #[test]
    fn bones_of_several_bodies_are_averaged_and_remarked() {
        let tall = body(&walking()).replace(" 10 0 0 0 0 0 0 -40", " 12 0 0 0 0 0 0 -40");
        let set = imported(&[("a.bvh", body(&walking())), ("b.bvh", tall)]).unwrap();
        assert_eq!(set.skeleton.unwrap().offsets[1], [11.0, 0.0, 0.0]);
        assert!(set.remarks.iter().any(|remark| remark.contains("by up to 1.000 cm")));
    }

    #[test]
    fn unit_and_scale_apply_to_lengths_alone() {
        let set = imported_with(&[("a.bvh", body(&walking()))], |options| {
            options.unit = Some(Unit::Metre);
            options.scale = Some(0.01);
        })
        .unwrap();
        assert_eq!(set.layout.channel_names()[0], "root_x_m");
        assert_eq!(set.clips[0].poses[..6], [0.0, 0.9, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(set.skeleton.unwrap().offsets[1], [0.1, 0.0, 0.0]);
    }

    #[test]
    fn joint_called_root_makes_room_for_the_translation() {
        let set = imported(&[("a.bvh", body(&walking()).replace("Hips", "root"))]).unwrap();
        let names: Vec<&str> = set.layout.groups.iter().map(|group| group.name.as_str()).collect();
        assert_eq!(names, ["root", "root_joint", "Arm", "Leg"]);
    }
}
