//! Motions in the formats of the Blender add-on "Servo Animation": C header, binary stream, JSON.
//!
//! In:  a [`PulseTrack`].
//! Out: the bytes of one file.
//!
//! The stream, in the header and in the binary alike: a record `3C id high low 3E` for every servo that moved, then
//! `0A`; the first frame has every servo. Positions are whole µs.
//!
//! Why here: the markers are not escaped, and the reader on the Arduino scans for them. A position with a byte 0A ends
//! the frame in the middle of a record, which loses the position and every later frame comes one too late; a byte 3C
//! begins the record anew. So the bytes of a position are never 0A or 3C (it moves by 1 µs instead), ids 10 and 60 are
//! skipped, and the first frame, which a reader has no older positions for, is whole.
//! Source: format of version 2.1.1 of the add-on, read; its reader's behaviour, measured on an own copy of its rules.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::Serialize;

use crate::bake::credit;
use crate::bake::pulse_track::PulseTrack;
use crate::bake::servo::pulses_us;
use crate::error::{Error, Result};
use crate::export::Motion;

const START: u8 = 0x3C;
const END: u8 = 0x3E;
const LINE_BREAK: u8 = 0x0A;

/// Largest step between frames that the reader follows: its threshold is one byte.
const THRESHOLD_MAX: f64 = 255.0;
/// The reader's threshold unless the sketch sets another.
const THRESHOLD: f64 = 20.0;
/// Bytes in a line of the header.
const BYTES_A_LINE: usize = 12;

/// The ids that servos get: from 0 on, without those that are markers.
fn ids(track: &PulseTrack<'_>, remarks: &mut Vec<String>) -> Vec<u8> {
    let is_marker = |id: &u8| [START, LINE_BREAK].contains(id);
    let ids: Vec<u8> = (0..=u8::MAX).filter(|id| !is_marker(id)).take(track.servos.len()).collect();
    let moved = (0..).zip(&ids).zip(track.servos).filter(|((index, id), _)| index != *id);
    let moved: Vec<String> =
        moved.map(|((_, id), servo)| format!("{} is {id}", servo.name)).collect();
    if !moved.is_empty() {
        let list = moved.join(", ");
        let text = format!("servo ids 10 and 60 are markers of the stream and left out: {list}");
        if !remarks.contains(&text) {
            remarks.push(text);
        }
    }
    ids
}

/// `.bin`.
pub fn stream(track: &PulseTrack<'_>, remarks: &mut Vec<String>) -> Result<Vec<u8>> {
    let ids = ids(track, remarks);
    let frames = marker_free(track, remarks)?;
    remarks.extend(threshold_remark(track));
    let mut bytes = Vec::new();
    for (frame, positions) in frames.iter().enumerate() {
        for (servo, (id, position)) in ids.iter().zip(positions).enumerate() {
            if frame == 0 || frames[frame - 1][servo] != *position {
                let [high, low] = position.to_be_bytes();
                bytes.extend([START, *id, high, low, END]);
            }
        }
        bytes.push(LINE_BREAK);
    }
    Ok(bytes)
}

/// `.h`.
pub fn header(track: &PulseTrack<'_>, remarks: &mut Vec<String>) -> Result<String> {
    let motion = track.motion;
    let fps = whole_fps(motion)?;
    let bytes = stream(track, remarks)?;
    let mut text = format!(
        "/*\n  Blender Servo Animation Positions\n\n  FPS: {fps}\n  Frames: {}\n  Seconds: {:.0}\n  Bones: {}\n  \
         Scene: {}\n  File: {}\n\n  {}\n",
        motion.frame_count(),
        motion.seconds,
        track.servos.len(),
        scene(motion),
        file(motion),
        credit(motion)
    );
    for (id, servo) in ids(track, remarks).iter().zip(track.servos) {
        let _ = writeln!(text, "  Servo {id}: {}, µs", comment(&servo.name));
    }
    let _ = write!(
        text,
        "*/\n\n#include <Arduino.h>\n\nnamespace {} {{\n\nconst byte FPS = {fps};\nconst int FRAMES = {};\nconst int \
         LENGTH = {};\n\nconst byte PROGMEM ANIMATION_DATA[LENGTH] = {{\n",
        scene(motion),
        motion.frame_count(),
        bytes.len()
    );
    for line in bytes.chunks(BYTES_A_LINE) {
        let line: Vec<String> = line.iter().map(|byte| format!("0x{byte:02x}")).collect();
        let _ = writeln!(text, "    {},", line.join(", "));
    }
    let _ = write!(text, "}};\n\n}} // namespace {}\n", scene(motion));
    Ok(text)
}

/// The JSON file; field order is the add-on's.
#[derive(Serialize)]
struct PositionFile {
    description: String,
    fps: u8,
    frames: usize,
    seconds: f64,
    bones: usize,
    file: String,
    scene: String,
    positions: Vec<BTreeMap<u8, u16>>,
}

/// `.json`: no markers, so every position is exactly the nearest µs.
pub fn json(track: &PulseTrack<'_>, remarks: &mut Vec<String>) -> Result<Vec<u8>> {
    let (motion, ids) = (track.motion, ids(track, remarks));
    remarks.extend(threshold_remark(track));
    let frames = track.whole_us();
    let changed = |(index, positions): (usize, &Vec<u16>)| {
        let entries = ids.iter().zip(positions).enumerate();
        let is_new = |servo: usize, position| index == 0 || frames[index - 1][servo] != position;
        entries
            .filter(|(servo, (_, position))| is_new(*servo, **position))
            .map(|(_, (id, position))| (*id, *position))
            .collect()
    };
    let file = PositionFile {
        description: format!("Blender Servo Animation Positions; {}", credit(motion)),
        fps: whole_fps(motion)?,
        frames: motion.frame_count(),
        seconds: motion.seconds.round(),
        bones: track.servos.len(),
        file: file(motion),
        scene: scene(motion),
        positions: frames.iter().enumerate().map(changed).collect(),
    };
    serde_json::to_vec_pretty(&file).map_err(|error| Error::io("encode", "json")(error.into()))
}

/// Whole µs without marker bytes. // (frame, servo)
fn marker_free(track: &PulseTrack<'_>, remarks: &mut Vec<String>) -> Result<Vec<Vec<u16>>> {
    let mut frames = track.whole_us();
    let mut moved = 0;
    for (index, frame) in frames.iter_mut().enumerate() {
        for (servo, position) in track.servos.iter().zip(frame) {
            let [min, _, max] = pulses_us(servo);
            let nearby = [*position, position.wrapping_sub(1), position.wrapping_add(1)];
            let is_fit = |near: &&u16| {
                let [high, low] = near.to_be_bytes();
                let is_in_range = (min..=max).contains(&f64::from(**near)) || **near == *position;
                is_in_range && ![high, low].iter().any(|byte| [START, LINE_BREAK].contains(byte))
            };
            let Some(near) = nearby.iter().find(is_fit) else {
                let field = format!("seed {}, frame {index}, {}", track.motion.seed, servo.name);
                let expected = "a pulse without a byte 0A or 3C within 1 µs: this stream cannot hold 2560 to 2815 µs";
                let remedy = "calibrate the servo to at most 2559 µs, or bake blender-json";
                return Err(Error::bad_input(
                    "--format",
                    field,
                    format!("{position} µs"),
                    expected,
                    remedy,
                ));
            };
            moved += usize::from(near != position);
            *position = *near;
        }
    }
    if moved > 0 {
        remarks.push(format!(
            "seed {}: {moved} positions with a byte 0A or 3C moved by 1 µs, which the Arduino reader would misread",
            track.motion.seed
        ));
    }
    Ok(frames)
}

fn threshold_remark(track: &PulseTrack<'_>) -> Option<String> {
    let step = (0..track.servos.len()).map(|servo| track.step_us_max(servo)).fold(0.0, f64::max);
    // Rounding and avoiding markers may add 1 µs at either end.
    let needed = step.ceil() + 2.0;
    let seed = track.motion.seed;
    match needed {
        _ if needed > THRESHOLD_MAX => Some(format!(
            "seed {seed}: a step of {step:.0} µs between frames is more than the Arduino library follows; bake with a \
             higher --fps"
        )),
        _ if needed > THRESHOLD => Some(format!(
            "seed {seed}: steps of up to {step:.0} µs; the Arduino library ignores steps beyond its threshold of 20: \
             call setDefaultServoThreshold({needed:.0}) in the sketch"
        )),
        _ => None,
    }
}

fn whole_fps(motion: &Motion) -> Result<u8> {
    let rate_hz = motion.rate_hz;
    if rate_hz.fract() == 0.0 && rate_hz <= f64::from(u8::MAX) {
        return Ok(rate_hz as u8);
    }
    let remedy = "bake at a whole rate, such as --fps 30";
    Err(Error::bad_input(
        "--format",
        "frames per second",
        rate_hz,
        "a whole number up to 255",
        remedy,
    ))
}

fn scene(motion: &Motion) -> String {
    crate::bake::identifier(motion)
}

fn file(motion: &Motion) -> String {
    format!("seed {}", motion.seed)
}

fn comment(name: &str) -> String {
    name.replace("*/", "* /")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::bake::specimen;

    /// A strict reader: records of five bytes, never by scanning. // (frame, servo) in order of ids
    fn records(bytes: &[u8]) -> Vec<BTreeMap<u8, u16>> {
        let (mut frames, mut rest, mut now) = (Vec::new(), bytes, BTreeMap::new());
        while let Some(first) = rest.first() {
            match *first {
                LINE_BREAK => {
                    frames.push(now.clone());
                    rest = &rest[1..];
                }
                START => {
                    assert_eq!(rest[4], END, "a record has five bytes");
                    now.insert(rest[1], u16::from_be_bytes([rest[2], rest[3]]));
                    rest = &rest[5..];
                }
                other => panic!("{other:02x} begins nothing"),
            }
        }
        frames
    }

    /// The Arduino library's way: a line break ends the frame and a start marker begins anew wherever they stand.
    fn scanned(bytes: &[u8]) -> Vec<BTreeMap<u8, u16>> {
        let (mut frames, mut now, mut values) = (Vec::new(), BTreeMap::new(), [0u8; 5]);
        let mut index = 0;
        for &byte in bytes {
            if byte == LINE_BREAK {
                frames.push(now.clone());
                continue;
            }
            if byte == START {
                (values, index) = ([0; 5], 0);
            }
            if index < 5 {
                values[index] = byte;
                index += 1;
            }
            if values[0] == START && values[4] == END {
                now.insert(values[1], u16::from_be_bytes([values[2], values[3]]));
            }
        }
        frames
    }

    fn positions(frames: &[BTreeMap<u8, u16>]) -> Vec<Vec<u16>> {
        frames.iter().map(|frame| frame.values().copied().collect()).collect()
    }

    fn assert_near(found: &[Vec<u16>], wanted: &[Vec<u16>], tolerance_us: u16) {
        assert_eq!(found.len(), wanted.len());
        for (found, wanted) in found.iter().zip(wanted) {
            assert_eq!(found.len(), wanted.len());
            assert!(found.iter().zip(wanted).all(|(a, b)| a.abs_diff(*b) <= tolerance_us));
        }
    }

    #[test]
    fn naive_reader_fails_on_a_plain_stream_and_survives_ours() {
        // 1290 µs is 050A: in a plain stream that position is lost and playback is a frame late for ever.
        let plain = [START, 0, 0x05, 0x0A, END, LINE_BREAK];
        assert_ne!(scanned(&plain), records(&plain));
        let motion = specimen::motion_of(&[-21.0, -16.0, -16.0, 0.0]);
        let servos = specimen::servos(&motion);
        let mut remarks = Vec::new();
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let bytes = stream(&track, &mut remarks).unwrap();
        assert_eq!(scanned(&bytes), records(&bytes));
        assert_eq!(positions(&records(&bytes)), [[1289], [1339], [1339], [1500]]);
        assert!(remarks[0].contains("3 positions"), "{remarks:?}");
    }

    #[test]
    fn pulses_that_the_stream_cannot_hold_are_refused() {
        let motion = specimen::motion_of(&[0.0, 120.0]);
        let mut servos = specimen::servos(&motion);
        servos[0] = specimen::servo([500, 1500, 3000]);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let error = stream(&track, &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("frame 1, jaw is 2700 µs"), "{error}");
        assert!(json(&track, &mut Vec::new()).is_ok());
    }

    #[test]
    fn rate_that_is_no_byte_is_refused() {
        let motion = Motion { rate_hz: 29.97, ..specimen::motion_of(&[0.0, 1.0]) };
        let servos = specimen::servos(&motion);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        assert!(header(&track, &mut Vec::new()).unwrap_err().to_string().contains("--fps 30"));
    }

    #[test]
    fn marker_ids_are_skipped_and_said() {
        let groups = (0..32).map(|index| crate::layout::Group {
            name: format!("servo{index}"),
            kind: crate::layout::GroupKind::Scalar,
            unit: crate::layout::Unit::Degree,
        });
        let mut motion = specimen::motion_of(&[1.0; 64]);
        motion.layout.groups = groups.collect();
        let servos = specimen::servos(&motion);
        let mut remarks = Vec::new();
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let ids = ids(&track, &mut remarks);
        assert_eq!((ids[9], ids[10], ids[31]), (9, 11, 32));
        assert!(remarks[0].contains("servo10 is 11"), "{remarks:?}");
    }

    #[test]
    fn three_files_of_one_motion_say_the_same() {
        for motion in specimen::character(5) {
            let servos = specimen::servos(&motion);
            let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
            let mut remarks = Vec::new();
            let bytes = stream(&track, &mut remarks).unwrap();
            assert_eq!(scanned(&bytes), records(&bytes));
            assert_near(&positions(&records(&bytes)), &track.whole_us(), 1);

            let text = header(&track, &mut remarks).unwrap();
            let array = text.split_once("[LENGTH] = {").unwrap().1.split_once('}').unwrap().0;
            let digits = array.split(',').filter_map(|byte| byte.trim().strip_prefix("0x"));
            let listed: Vec<u8> =
                digits.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
            assert_eq!(listed, bytes);
            assert!(
                text.contains(&format!("LENGTH = {};", bytes.len())) && text.contains("deadbeef")
            );

            let file: serde_json::Value =
                serde_json::from_slice(&json(&track, &mut remarks).unwrap()).unwrap();
            let mut now = BTreeMap::new();
            let mut frames = Vec::new();
            for frame in file["positions"].as_array().unwrap() {
                let entries = frame.as_object().unwrap().iter();
                now.extend(
                    entries.map(|(id, p)| (id.parse::<u8>().unwrap(), p.as_u64().unwrap() as u16)),
                );
                frames.push(now.clone());
            }
            assert_eq!(positions(&frames), track.whole_us());
            assert_eq!(
                (file["fps"].as_u64(), file["bones"].as_u64()),
                (Some(50), Some(servos.len() as u64))
            );
        }
    }

    proptest! {
        #[test]
        fn any_motion_survives_the_naive_reader(
            degrees in prop::collection::vec(-150.0..150.0f32, 1..60)
        ) {
            let motion = specimen::motion_of(&degrees);
            let servos = specimen::servos(&motion);
            let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
            let bytes = stream(&track, &mut Vec::new()).unwrap();
            prop_assert_eq!(scanned(&bytes), records(&bytes));
            assert_near(&positions(&records(&bytes)), &track.whole_us(), 1);
        }
    }
}
