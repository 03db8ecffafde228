//! Station 1: recorded moves of Reachy Mini (JSON) → clips at 50 Hz.
//!
//! A file is `{description, time: [s], set_target_data: [{head, antennas, body_yaw, …}]}`: `head` a 4 × 4 matrix in
//! metres, row-major, identity when neutral; `antennas` right, left and `body_yaw` in radians.
//!
//! Source: notes of the Pollen Robotics recorder and player. What published files do that the format does not say:
//! times may start at an epoch second, be one longer than the frames, or run at 100 Hz; the frames' key may be `frames`;
//! `body_yaw` may be absent, which means that the recording does not drive it.

use std::path::Path;

use serde::Deserialize;

use super::files::ClipFile;
use super::resample::{check_times, is_regular, resample};
use super::{ImportOptions, Recordings, Remarks, check_poses, with_progress};
use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};
use crate::rotation::{Rotation, dot};

/// Poses per second that the robot's own player sends; `--fps` overrides it.
pub const RATE_HZ: f64 = 50.0;

/// Largest deviation of a head's matrix from a rotation, per element of R·Rᵀ − 1.
///
/// Published files carry six decimals, which leaves deviations up to a few millionths; a thousandth is 0.06 degrees.
/// What remains under it is orthonormalised away.
pub const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

#[derive(Deserialize)]
struct Move {
    time: Vec<f64>,
    #[serde(alias = "frames")]
    set_target_data: Vec<Target>,
}

#[derive(Deserialize)]
struct Target {
    head: [[f64; 4]; 4],
    antennas: [f64; 2], // right, left
    body_yaw: Option<f64>,
}

/// Reads every file.
pub(crate) fn read(
    files: &[ClipFile],
    options: &ImportOptions,
    remarks: &mut Remarks,
) -> Result<Recordings> {
    let layout = layout();
    let rate_hz = options.rate_hz.unwrap_or(RATE_HZ);
    let mut poses = Vec::with_capacity(files.len());
    let mut drives_body = Vec::with_capacity(files.len());
    for file in with_progress(files) {
        let bytes = std::fs::read(&file.path).map_err(Error::io("read", &file.path))?;
        let recorded = parse(&file.path, &bytes, remarks)?;
        drives_body.push(
            recorded
                .set_target_data
                .iter()
                .any(|target| target.body_yaw.is_some()),
        );
        let clip = regular_poses(&file.path, &layout, &recorded, rate_hz, remarks)?;
        check_poses(&file.path, &layout, &clip, options)?;
        poses.push(clip);
    }
    let mut recordings = Recordings {
        layout,
        rate_hz,
        skeleton: None,
        poses,
    };
    settle_body_yaw(&mut recordings, files, &drives_body, remarks);
    Ok(recordings)
}

fn layout() -> PoseLayout {
    let group = |name: &str, kind, unit| Group {
        name: name.into(),
        kind,
        unit,
    };
    PoseLayout {
        groups: vec![
            group("head", GroupKind::Translation, Unit::Metre),
            group("head_rotation", GroupKind::Rotation6d, Unit::One),
            group("antenna_right", GroupKind::Scalar, Unit::Radian),
            group("antenna_left", GroupKind::Scalar, Unit::Radian),
            group("body_yaw", GroupKind::Scalar, Unit::Radian),
        ],
    }
}

/// Decodes one file and checks everything but the finiteness of values, which JSON guarantees.
fn parse(file: &Path, bytes: &[u8], remarks: &mut Remarks) -> Result<Move> {
    let mut recorded: Move = serde_json::from_slice(bytes).map_err(|error| {
        let expected = "a recorded move {time, set_target_data: [{head, antennas, body_yaw}]}";
        Error::bad_input(
            file,
            "content",
            error,
            expected,
            "record or download it again",
        )
    })?;
    let (time_count, frame_count) = (recorded.time.len(), recorded.set_target_data.len());
    if time_count == frame_count + 1 {
        recorded.time.truncate(frame_count);
        remarks.note(file, "one time more than frames; the last is ignored");
    } else if time_count != frame_count {
        let value = format!("{time_count} times");
        let expected = format!("one for each of the {frame_count} frames");
        return Err(Error::bad_input(
            file,
            "time",
            value,
            expected,
            "record the move again",
        ));
    }
    check_times(file, &recorded.time, |index| format!("time[{index}]"))?;
    let drives_body = recorded
        .set_target_data
        .iter()
        .any(|target| target.body_yaw.is_some());
    for (frame, target) in recorded.set_target_data.iter().enumerate() {
        check_head(file, frame, &target.head)?;
        if drives_body && target.body_yaw.is_none() {
            let field = format!("frame {frame}, body_yaw");
            let expected = "a number in every frame or in none";
            return Err(Error::bad_input(
                file,
                field,
                "absent",
                expected,
                "record it again",
            ));
        }
    }
    Ok(recorded)
}

/// Checks that a 4 × 4 matrix is a rotation and a translation.
fn check_head(file: &Path, frame: usize, head: &[[f64; 4]; 4]) -> Result<()> {
    let [x, y, z] = [0, 1, 2].map(|row| [head[row][0], head[row][1], head[row][2]]);
    let products = [
        dot(x, x) - 1.0,
        dot(y, y) - 1.0,
        dot(z, z) - 1.0,
        dot(x, y),
        dot(y, z),
        dot(z, x),
    ];
    let deviation = products
        .iter()
        .fold(0.0, |max: f64, product| max.max(product.abs()));
    let is_right_handed = dot(rotation_rows(head).rows[2], z) > 0.0;
    let last = head[3];
    let field = format!("frame {frame}, head");
    let remedy = "record the move again or repair the matrix";
    // Not `deviation > tolerance`: a NaN must fail too.
    if !(deviation <= ORTHONORMAL_TOLERANCE && is_right_handed) {
        let value = format!("a matrix {deviation:.2e} from a rotation");
        let expected = format!("at most {ORTHONORMAL_TOLERANCE:e}, right-handed");
        return Err(Error::bad_input(file, field, value, expected, remedy));
    }
    if last != [0.0, 0.0, 0.0, 1.0] {
        let value = format!("a matrix with last row {last:?}");
        return Err(Error::bad_input(file, field, value, "0 0 0 1", remedy));
    }
    Ok(())
}

fn rotation_rows(head: &[[f64; 4]; 4]) -> Rotation {
    let [[a, b, c, _], [d, e, f, _], ..] = *head;
    Rotation::from_6d(&[a, b, c, d, e, f])
}

/// The file's poses at `rate_hz`, resampled only if they are not already there.
fn regular_poses(
    file: &Path,
    layout: &PoseLayout,
    recorded: &Move,
    rate_hz: f64,
    remarks: &mut Remarks,
) -> Result<Vec<f32>> {
    let poses: Vec<f32> = recorded.set_target_data.iter().flat_map(pose_of).collect();
    if is_regular(&recorded.time, rate_hz) {
        return Ok(poses);
    }
    remarks.note(file, format!("resampled to {rate_hz} poses per second"));
    Ok(resample(layout, &recorded.time, &poses, rate_hz))
}

/// The channels of one frame in the order of [`layout`]; an undriven body stands at 0.
fn pose_of(target: &Target) -> [f32; 12] {
    let [a, b, c, d, e, f] = rotation_rows(&target.head).to_6d();
    let [x, y, z] = [0, 1, 2].map(|row| target.head[row][3]);
    let [right, left] = target.antennas;
    let yaw = target.body_yaw.unwrap_or(0.0);
    [x, y, z, a, b, c, d, e, f, right, left, yaw].map(|value| value as f32)
}

/// Drops `body_yaw` if no file drives it; remarks on those that do not if others do.
fn settle_body_yaw(
    recordings: &mut Recordings,
    files: &[ClipFile],
    drives_body: &[bool],
    remarks: &mut Remarks,
) {
    if drives_body.iter().any(|&drives| drives) {
        let undriven = files
            .iter()
            .zip(drives_body)
            .filter(|(_, drives)| !**drives);
        for (file, _) in undriven {
            remarks.note(&file.path, "body_yaw is not driven; taken as 0");
        }
        return;
    }
    let width = recordings.layout.channel_count();
    recordings.layout.groups.pop();
    for poses in &mut recordings.poses {
        *poses = poses
            .chunks_exact(width)
            .flat_map(|pose| pose[..width - 1].to_vec())
            .collect();
    }
    remarks.note(
        &files[0].path,
        "no file drives body_yaw; the channel is left out",
    );
}
