//! Station 1: recorded moves of Reachy Mini (JSON) → clips at 50 Hz.
//!
//! A file is `{description, time: [s], set_target_data: [{head, antennas, body_yaw}]}`: `head` a
//! 4 × 4 matrix in metres, row-major, identity when neutral; `antennas` right, left and `body_yaw`
//! in radians.
//!
//! Source: notes of the Pollen Robotics recorder and player. What published files do that the
//! format does not say: times may start at an epoch second, be one longer than the frames, or run
//! at 100 Hz; the frames' key may be `frames`; `body_yaw` may be absent, which means that the
//! recording does not drive it.

use std::path::Path;

use serde::Deserialize;

use super::files::ClipFile;
use super::resample::{check_times, is_regular, resample};
use super::{ImportOptions, Recordings, Remarks, check_poses, with_progress};
use crate::body::rotation::{Rotation, dot};
use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};

/// Poses per second that the robot's own player sends; `--fps` overrides it.
pub const RATE_HZ: f64 = 50.0;

/// Largest deviation of a head's matrix from a rotation, per element of R·Rᵀ − 1.
///
/// Published files carry six decimals, which leaves deviations up to a few millionths; a thousandth
/// is 0.06 degrees. What remains under it is orthonormalised away.
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
        drives_body.push(recorded.set_target_data.iter().any(|target| target.body_yaw.is_some()));
        let clip = regular_poses(&file.path, &layout, &recorded, rate_hz, remarks)?;
        check_poses(&file.path, &layout, &clip, options)?;
        poses.push(clip);
    }
    let mut recordings = Recordings { layout, rate_hz, skeleton: None, poses };
    settle_body_yaw(&mut recordings, files, &drives_body, remarks);
    Ok(recordings)
}

fn layout() -> PoseLayout {
    let group = |name: &str, kind, unit| Group { name: name.into(), kind, unit };
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
        Error::bad_input(file, "content", error, expected, "record or download it again")
    })?;
    let (time_count, frame_count) = (recorded.time.len(), recorded.set_target_data.len());
    if time_count == frame_count + 1 {
        recorded.time.truncate(frame_count);
        remarks.note(file, "one time more than frames; the last is ignored");
    } else if time_count != frame_count {
        let value = format!("{time_count} times");
        let expected = format!("one for each of the {frame_count} frames");
        return Err(Error::bad_input(file, "time", value, expected, "record the move again"));
    }
    check_times(file, &recorded.time, |index| format!("time[{index}]"))?;
    let drives_body = recorded.set_target_data.iter().any(|target| target.body_yaw.is_some());
    for (frame, target) in recorded.set_target_data.iter().enumerate() {
        check_head(file, frame, &target.head)?;
        if drives_body && target.body_yaw.is_none() {
            let field = format!("frame {frame}, body_yaw");
            let expected = "a number in every frame or in none";
            return Err(Error::bad_input(file, field, "absent", expected, "record it again"));
        }
    }
    Ok(recorded)
}

/// Checks that a 4 × 4 matrix is a rotation and a translation.
fn check_head(file: &Path, frame: usize, head: &[[f64; 4]; 4]) -> Result<()> {
    let [x, y, z] = [0, 1, 2].map(|row| [head[row][0], head[row][1], head[row][2]]);
    let products =
        [dot(x, x) - 1.0, dot(y, y) - 1.0, dot(z, z) - 1.0, dot(x, y), dot(y, z), dot(z, x)];
    let deviation = products.iter().fold(0.0, |max: f64, product| max.max(product.abs()));
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
        let undriven = files.iter().zip(drives_body).filter(|(_, drives)| !**drives);
        for (file, _) in undriven {
            remarks.note(&file.path, "body_yaw is not driven; taken as 0");
        }
        return;
    }
    let width = recordings.layout.channel_count();
    recordings.layout.groups.pop();
    for poses in &mut recordings.poses {
        *poses = poses.chunks_exact(width).flat_map(|pose| pose[..width - 1].to_vec()).collect();
    }
    remarks.note(&files[0].path, "no file drives body_yaw; the channel is left out");
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::{Value, json};

    use super::super::read as import;
    use super::super::support::{assert_refused, folder};
    use super::*;
    use crate::clip::ClipSet;

    /// A head turned by `yaw_rad` about z and moved by `x_m`.
    fn head(yaw_rad: f64, x_m: f64) -> Value {
        let (sine, cosine) = yaw_rad.sin_cos();
        json!([[cosine, -sine, 0, x_m], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    }

    /// Frames at `rate_hz` whose head, antennas and body all grow by 0.01 a frame.
    fn recorded(frame_count: usize, rate_hz: f64) -> Value {
        let frames: Vec<Value> = (0..frame_count)
            .map(|i| {
                let value = 0.01 * i as f64;
                json!({"head": head(value, value), "antennas": [value, -value],
                       "body_yaw": value, "check_collision": false})
            })
            .collect();
        let times: Vec<f64> = (0..frame_count).map(|i| i as f64 / rate_hz).collect();
        json!({"description": "a test", "time": times, "set_target_data": frames})
    }

    fn imported(files: &[(&str, &Value)]) -> Result<ClipSet> {
        let texts: Vec<(&str, String)> =
            files.iter().map(|(name, value)| (*name, value.to_string())).collect();
        let files: Vec<(&str, &[u8])> =
            texts.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
        let folder = folder(&files);
        let options = ImportOptions { tolerate_missing_labels: true, ..Default::default() };
        import(folder.path(), &options)
    }

    fn refused(change: impl Fn(&mut Value), words: &[&str]) {
        let mut value = recorded(4, 50.0);
        change(&mut value);
        assert_refused(imported(&[("nod1.json", &value)]), &[&["nod1.json"], words].concat());
    }

    #[test]
    fn malformed_json_is_refused_at_any_length() {
        let text = recorded(3, 50.0).to_string();
        for length in 0..text.len() {
            let result =
                parse(Path::new("nod1.json"), &text.as_bytes()[..length], &mut Remarks::default());
            assert!(result.is_err(), "accepted {length} bytes");
        }
        let nan = text.replace("-0.01", "NaN");
        let result = parse(Path::new("nod1.json"), nan.as_bytes(), &mut Remarks::default());
        assert_refused(result.map(|_| ()), &["nod1.json", "line 1 column", "recorded move"]);
    }

    #[test]
    fn wrong_fields_are_refused() {
        refused(
            |v| v["set_target_data"][2] = json!({"antennas": [0, 0]}),
            &["missing field `head`"],
        );
        refused(|v| v["set_target_data"][2]["antennas"] = json!([0]), &["invalid length 1"]);
        refused(|v| v["set_target_data"][2]["head"] = json!([[1, 0, 0, 0]]), &["invalid length 1"]);
        refused(|v| v["set_target_data"][2]["body_yaw"] = json!("left"), &["invalid type"]);
        refused(|v| v["time"] = Value::Null, &["invalid type: null"]);
    }

    #[test]
    fn head_that_is_no_rotation_is_refused() {
        let words = ["frame 2, head", "from a rotation", "1e-3, right-handed"];
        refused(|v| v["set_target_data"][2]["head"][0][0] = json!(1.01), &words);
        refused(|v| v["set_target_data"][2]["head"][2][2] = json!(-1.0), &words);
        refused(
            |v| {
                v["set_target_data"][2]["head"] =
                    json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]])
            },
            &words,
        );
        let words = ["frame 2, head", "last row", "0 0 0 1"];
        refused(|v| v["set_target_data"][2]["head"][3][0] = json!(0.5), &words);
    }

    #[test]
    fn value_beyond_f32_is_refused() {
        let words = ["frame 2, antenna_right_rad", "inf"];
        refused(|v| v["set_target_data"][2]["antennas"][0] = json!(1e300), &words);
    }

    #[test]
    fn times_that_do_not_fit_the_frames_are_refused() {
        refused(
            |v| v["time"] = json!([0, 0.02, 0.04]),
            &["time is 3 times", "each of the 4 frames"],
        );
        refused(|v| v["time"][2] = json!(0.02), &["time[2]", "a time after 0.02"]);
        refused(|v| v["time"][3] = json!(1e9), &["time[3]", "split the recording"]);
    }

    #[test]
    fn short_moves_are_refused() {
        let one = recorded(1, 50.0);
        assert_refused(imported(&[("a.json", &one)]), &["1 frame", "at least 2 frames"]);
        let none = recorded(0, 50.0);
        assert_refused(imported(&[("a.json", &none)]), &["0 frames"]);
    }

    #[test]
    fn body_yaw_that_comes_and_goes_is_refused() {
        refused(|v| v["set_target_data"][2]["body_yaw"] = Value::Null, &["frame 2, body_yaw"]);
    }

    #[test]
    fn channels_stand_in_their_order() {
        let set = imported(&[("nod1.json", &recorded(4, 50.0))]).unwrap();
        let names = "head_x_m head_y_m head_z_m head_rotation_r00 head_rotation_r01 head_rotation_r02 \
                     head_rotation_r10 head_rotation_r11 head_rotation_r12 \
                     antenna_right_rad antenna_left_rad body_yaw_rad";
        assert_eq!(set.layout.channel_names().join(" "), names);
        let (sine, cosine) = 0.01f32.sin_cos();
        let expected = [0.01, 0.0, 0.0, cosine, -sine, 0.0, sine, cosine, 0.0, 0.01, -0.01, 0.01];
        for (value, expected) in set.clips[0].poses[12..24].iter().zip(expected) {
            assert!((value - expected).abs() < 1e-7, "{value} is not {expected}");
        }
        assert_eq!((set.rate_hz, set.remarks), (50.0, Vec::new()));
    }

    #[test]
    fn slightly_skewed_heads_become_rotations() {
        let mut value = recorded(4, 50.0);
        value["set_target_data"][0]["head"][0][0] = json!(1.0004);
        let set = imported(&[("nod1.json", &value)]).unwrap();
        assert_eq!(set.clips[0].poses[3], 1.0);
    }

    #[test]
    fn legacy_key_extra_time_and_epoch_are_understood() {
        let mut value = recorded(4, 50.0);
        let frames = value["set_target_data"].take();
        let times: Vec<f64> = (0..5).map(|i| 1.7e9 + 0.02 * f64::from(i)).collect();
        let legacy = json!({"frames": frames, "time": times});
        let set = imported(&[("nod1.json", &legacy)]).unwrap();
        assert_eq!(set.clips[0].poses.len(), 4 * 12);
        assert_eq!(set.remarks.len(), 1, "{:?}", set.remarks);
        assert!(set.remarks[0].contains("one time more than frames"));
    }

    #[test]
    fn other_rates_are_resampled_and_remarked() {
        let set = imported(&[("nod1.json", &recorded(9, 100.0))]).unwrap();
        assert!(set.remarks[0].contains("resampled to 50"));
        let expected = recorded(5, 50.0);
        let antennas: Vec<f32> = set.clips[0].poses.chunks(12).map(|pose| pose[9]).collect();
        assert_eq!(antennas, [0.0, 0.02, 0.04, 0.06, 0.08]);
        assert_eq!(antennas.len(), expected["time"].as_array().unwrap().len());
    }

    #[test]
    fn undriven_body_is_left_out_or_stands_still() {
        let mut still = recorded(4, 50.0);
        for frame in still["set_target_data"].as_array_mut().unwrap() {
            frame.as_object_mut().unwrap().remove("body_yaw");
        }
        let alone = imported(&[("nod1.json", &still)]).unwrap();
        assert_eq!(alone.layout.channel_count(), 11);
        assert_eq!(alone.clips[0].poses.len(), 4 * 11);
        assert!(alone.remarks[0].contains("left out"));
        let mixed = imported(&[("nod1.json", &still), ("nod2.json", &recorded(4, 50.0))]).unwrap();
        assert_eq!(mixed.layout.channel_count(), 12);
        assert_eq!((mixed.clips[0].poses[47], mixed.clips[1].poses[47]), (0.0, 0.03));
        assert!(mixed.remarks[0].contains("nod1.json: body_yaw is not driven"));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = parse(Path::new("a.json"), &bytes, &mut Remarks::default()).map(|_| ());
        }

        #[test]
        fn damaged_file_never_panics(index in 0usize..10_000, byte in "[-0-9eE.,\\[\\]{}:\"a-z]") {
            let mut text = recorded(3, 50.0).to_string();
            let index = index % text.len();
            text.replace_range(index..=index, &byte);
            let _ = parse(Path::new("a.json"), text.as_bytes(), &mut Remarks::default()).map(|_| ());
        }
    }
}
