//! Motions as recorded moves of Reachy Mini (JSON).
//!
//! In:  a [`Motion`] with that robot's channels, as our importer names them.
//! Out: the bytes of one file.
//!
//! Source: the recorder's format as `import/reachy.rs` reads it; times are zero-based, as in published files.

use serde::Serialize;

use crate::bake::credit;
use crate::body::rotation::Rotation;
use crate::error::{Error, Result};
use crate::export::Motion;
use crate::layout::{GroupKind, Unit};

#[derive(Serialize)]
struct Move {
    description: String,
    time: Vec<f64>,
    set_target_data: Vec<Target>,
}

#[derive(Serialize)]
struct Target {
    head: [[f64; 4]; 4],
    antennas: [f64; 2], // right, left
    #[serde(skip_serializing_if = "Option::is_none")]
    body_yaw: Option<f64>,
    check_collision: bool,
}

/// Every channel that a move can have.
const CHANNELS: [(&str, GroupKind, Unit); 5] = [
    ("head", GroupKind::Translation, Unit::Metre),
    ("head_rotation", GroupKind::Rotation6d, Unit::One),
    ("antenna_right", GroupKind::Scalar, Unit::Radian),
    ("antenna_left", GroupKind::Scalar, Unit::Radian),
    ("body_yaw", GroupKind::Scalar, Unit::Radian),
];

/// The whole file.
///
/// # Errors
/// The model has other channels than the robot.
pub fn emit(motion: &Motion) -> Result<Vec<u8>> {
    let ([head, rotation, right, left], body_yaw) = starts(motion)?;
    let target = |pose: &[f32]| {
        let value = |channel: usize| f64::from(pose[channel]);
        let rows = Rotation::from_6d(&std::array::from_fn(|index| value(rotation + index))).rows;
        let row = |index: usize| {
            let [a, b, c] = rows[index];
            [a, b, c, value(head + index)]
        };
        Target {
            head: [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            antennas: [value(right), value(left)],
            body_yaw: body_yaw.map(value),
            check_collision: false,
        }
    };
    let file = Move {
        description: credit(motion),
        time: (0..motion.frame_count()).map(|frame| frame as f64 / motion.rate_hz).collect(),
        set_target_data: motion.frames().map(target).collect(),
    };
    serde_json::to_vec(&file).map_err(|error| Error::io("encode", "json")(error.into()))
}

/// First channels of all that every move has, and of the body's yaw: without it a move does not drive the body.
fn starts(motion: &Motion) -> Result<([usize; 4], Option<usize>)> {
    let mut starts = [None; CHANNELS.len()];
    for (group, range) in motion.layout.ranges() {
        let (kind, unit) = (group.kind, group.unit);
        match CHANNELS.iter().position(|channel| *channel == (&group.name, kind, unit)) {
            Some(index) => starts[index] = Some(range.start),
            None => {
                let value = format!("`{}` ({}, {})", group.name, kind.name(), unit.suffix());
                return Err(refusal(&value));
            }
        }
    }
    let start =
        |index: usize| starts[index].ok_or_else(|| refusal(&format!("no `{}`", CHANNELS[index].0)));
    Ok(([start(0)?, start(1)?, start(2)?, start(3)?], starts[4]))
}

fn refusal(value: &str) -> Error {
    let names =
        CHANNELS.map(|(name, kind, unit)| format!("{name} ({}, {})", kind.name(), unit.suffix()));
    let expected = format!("the channels of Reachy Mini: {}", names.join(", "));
    let remedy = "bake a model that was trained on its moves (`host-trainer train MOVES --format reachy`), or csv";
    Error::bad_input("--format", "a channel of the model", value, expected, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;
    use crate::import::{Format, ImportOptions, read};
    use crate::layout::{Group, PoseLayout};

    fn robot(count: usize) -> Motion {
        let group = |(name, kind, unit): (&str, _, _)| Group { name: name.into(), kind, unit };
        let layout = PoseLayout { groups: CHANNELS.into_iter().take(count).map(group).collect() };
        let poses = (0..40).flat_map(|frame| {
            let at = frame as f32 / 40.0;
            let (sine, cosine) = (0.5 * at).sin_cos();
            let rotation = [cosine, -sine, 0.0, sine, cosine, 0.0];
            let rest = [0.3 * at, -0.2 * at, 0.1 - at];
            [&[0.01 * at, -0.02 * at, 0.005][..], &rotation, &rest[..count - 2]].concat()
        });
        Motion { poses: poses.collect(), layout, ..specimen::motion_of(&[]) }
    }

    #[test]
    fn models_with_other_channels_are_refused_by_name() {
        let error = emit(&specimen::motion_of(&[0.0])).unwrap_err().to_string();
        assert!(
            error.contains("`jaw` (scalar, deg)") && error.contains("antenna_right"),
            "{error}"
        );
        let error = emit(&robot(3)).unwrap_err().to_string();
        assert!(error.contains("no `antenna_left`"), "{error}");
    }

    #[test]
    fn moves_come_back_through_the_importer() {
        for count in [4, 5] {
            let motion = robot(count);
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("nod.json"), emit(&motion).unwrap()).unwrap();
            let options = ImportOptions {
                format: Some(Format::Reachy),
                tolerate_missing_labels: true,
                ..ImportOptions::default()
            };
            let set = read(folder.path(), &options).unwrap();
            assert_eq!((set.rate_hz, &set.layout), (50.0, &motion.layout));
            let pairs = set.clips[0].poses.iter().zip(&motion.poses);
            assert_eq!(set.clips[0].poses.len(), motion.poses.len());
            assert!(pairs.into_iter().all(|(read, written)| (read - written).abs() < 1e-6));
        }
    }
}
