//! Motions of servos → BVH: one joint about z for every scalar angle, side by side on a root that stands still.
//!
//! In:  a [`Motion`] of scalars in degrees or radians.
//! Out: text for animation programs.

use std::f64::consts::PI;
use std::fmt::Write;

use crate::export::Motion;
use crate::layout::{Group, GroupKind, Unit};

/// Distance between neighbours, so that they can be told apart on the screen.
const SPACING: f64 = 10.0;

/// Writes the whole file, or `None` where a channel is not an angle.
pub fn emit(motion: &Motion) -> Option<String> {
    let groups = &motion.layout.groups;
    let factors: Vec<f64> = groups.iter().map(degrees_per_unit).collect::<Option<_>>()?;
    let mut text = String::from(
        "HIERARCHY\nROOT servos\n{\n\tOFFSET 0.000000 0.000000 0.000000\n\tCHANNELS 6 Xposition Yposition \
         Zposition Zrotation Xrotation Yrotation\n",
    );
    for (index, group) in groups.iter().enumerate() {
        let (name, x) = (group.name.replace(char::is_whitespace, "_"), SPACING * index as f64);
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\tJOINT {name}\n\t{{\n\t\tOFFSET {x:.6} 0.000000 0.000000\n\t\tCHANNELS 1 Zrotation\n\t\tEnd \
             Site\n\t\t{{\n\t\t\tOFFSET 0.000000 {SPACING:.6} 0.000000\n\t\t}}\n\t}}\n"
        );
    }
    let (count, frame_s) = (motion.frame_count(), 1.0 / motion.rate_hz);
    let _ = write!(text, "}}\nMOTION\nFrames: {count}\nFrame Time: {frame_s:.8}\n");
    for pose in motion.frames() {
        text.push_str("0 0 0 0 0 0");
        for (value, factor) in pose.iter().zip(&factors) {
            let _ = write!(text, " {:.6}", f64::from(*value) * factor);
        }
        text.push('\n');
    }
    Some(text)
}

fn degrees_per_unit(group: &Group) -> Option<f64> {
    match (group.kind, group.unit) {
        (GroupKind::Scalar, Unit::Degree) => Some(1.0),
        (GroupKind::Scalar, Unit::Radian) => Some(180.0 / PI),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;
    use crate::import::{Format, ImportOptions, read};

    #[test]
    fn pulse_widths_are_no_angles() {
        let mut motion = specimen::motion_of(&[0.0, 1.0]);
        motion.layout.groups[0].unit = Unit::Microsecond;
        assert_eq!(emit(&motion), None);
    }

    #[test]
    fn angles_come_back_through_the_importer() {
        let mut motion = specimen::character(1).remove(0);
        motion.layout.groups[0].unit = Unit::Radian;
        let channel_count = motion.layout.channel_count();
        motion.poses.iter_mut().step_by(channel_count).for_each(|value| *value /= 60.0);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("nod.bvh"), emit(&motion).unwrap()).unwrap();
        let options = ImportOptions {
            format: Some(Format::Bvh),
            tolerate_missing_labels: true,
            ..ImportOptions::default()
        };
        let set = read(folder.path(), &options).unwrap();
        assert_eq!(set.rate_hz, motion.rate_hz);
        let width = set.layout.channel_count();
        let starts: Vec<(usize, f64)> = set
            .layout
            .ranges()
            .filter_map(|(group, range)| {
                let servo = motion.layout.groups.iter().position(|own| own.name == group.name)?;
                Some((range.start, degrees_per_unit(&motion.layout.groups[servo])?))
            })
            .collect();
        assert_eq!(starts.len(), channel_count);
        for (read, written) in set.clips[0].poses.chunks_exact(width).zip(motion.frames()) {
            for ((start, factor), value) in starts.iter().zip(written) {
                // Rz: cos −sin 0, sin cos 0.
                let angle_deg = read[start + 3].atan2(read[*start]).to_degrees();
                assert!((f64::from(angle_deg) - f64::from(*value) * factor).abs() < 1e-3);
            }
        }
    }
}
