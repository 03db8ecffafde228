//! The motion section of a BVH file: two header lines, then one line of numbers a frame.

use std::path::Path;

use super::parser::{Bvh, CORRECT, EXPORT_AGAIN, Joint};
use crate::error::{Error, Result};

/// Parses `Frames:`, `Frame Time:` and the frames, from lines that are not blank.
pub(super) fn parse(file: &Path, joints: Vec<Joint>, lines: &[(usize, &str)]) -> Result<Bvh> {
    let frame_count = header_value(file, lines.first(), "Frames:")?;
    let frame_time_s = header_value(file, lines.get(1), "Frame Time:")?;
    if frame_time_s <= 0.0 {
        let expected = "a time in seconds above 0";
        return Err(Error::bad_input(file, "Frame Time", frame_time_s, expected, CORRECT));
    }
    let mut bvh = Bvh { joints, frame_time_s, values: Vec::new() };
    if bvh.channel_count() == 0 {
        let expected = "at least one channel";
        return Err(Error::bad_input(file, "CHANNELS", "0 in all", expected, EXPORT_AGAIN));
    }
    let frames = &lines[2..];
    if frames.len() as f64 != frame_count {
        let value = format!("{} lines", frames.len());
        let expected = format!("{frame_count} as Frames: says");
        return Err(Error::bad_input(file, "motion", value, expected, EXPORT_AGAIN));
    }
    for (number, line) in frames {
        frame(file, *number, line, &mut bvh)?;
    }
    Ok(bvh)
}

fn header_value(file: &Path, line: Option<&(usize, &str)>, key: &str) -> Result<f64> {
    let (number, text) = line.copied().unwrap_or((0, ""));
    let value = text
        .trim()
        .get(..key.len())
        .filter(|start| start.eq_ignore_ascii_case(key))
        .and_then(|_| text.trim()[key.len()..].trim().parse::<f64>().ok())
        .filter(|value| value.is_finite());
    value.ok_or_else(|| {
        let (field, value) = match number {
            0 => ("end of file".to_string(), "nothing".to_string()),
            _ => (format!("line {number}"), format!("{text:?}")),
        };
        Error::bad_input(file, field, value, format!("{key} and a number"), EXPORT_AGAIN)
    })
}

fn frame(file: &Path, line_number: usize, line: &str, bvh: &mut Bvh) -> Result<()> {
    let channel_count = bvh.channel_count();
    let start = bvh.values.len();
    for (index, word) in line.split_whitespace().enumerate() {
        let value = word.parse::<f64>().map_err(|_| {
            let field = format!("line {line_number}, value {}", index + 1);
            Error::bad_input(file, field, word, "a number", CORRECT)
        })?;
        bvh.values.push(value);
    }
    let found = bvh.values.len() - start;
    if found != channel_count {
        let field = format!("line {line_number}");
        let expected = format!("{channel_count}, one per channel");
        let value = format!("{found} numbers");
        return Err(Error::bad_input(file, field, value, expected, EXPORT_AGAIN));
    }
    Ok(())
}
