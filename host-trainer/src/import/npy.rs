//! Station 1: NumPy arrays → clips; one array a file, (frames, joints, 3) or (frames, channels), f32 or f64.
//!
//! Source: NEP 1, "A Simple File Format for NumPy Arrays"; the `npyz` crate decodes it. Its header parser recurses and
//! multiplies without bounds, so headers that no array of poses needs are refused before it sees them.

use std::path::Path;

use npyz::{DType, NpyFile, NpyHeader, Order, TypeChar};

use super::files::ClipFile;
use super::{ImportOptions, Recordings, check_poses, with_progress};
use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};

/// One array in C order.
#[derive(Debug, PartialEq)]
struct Array {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// Reads every file; all must have the shape of the first except for the number of frames.
pub(crate) fn read(files: &[ClipFile], options: &ImportOptions) -> Result<Recordings> {
    let first = &files[0].path;
    let Some(rate_hz) = options.rate_hz else {
        let expected = "a rate: .npy files do not name one";
        return Err(Error::bad_input(
            first,
            "rate",
            "unknown",
            expected,
            "add --fps RATE",
        ));
    };
    let mut layout: Option<(PoseLayout, Vec<usize>)> = None;
    let mut poses = Vec::with_capacity(files.len());
    for file in with_progress(files) {
        let bytes = std::fs::read(&file.path).map_err(Error::io("read", &file.path))?;
        let mut array = parse(&file.path, &bytes)?;
        if let Some(scale) = options.scale {
            let scaled = |value: &mut f32| *value = (f64::from(*value) * scale) as f32;
            array.values.iter_mut().for_each(scaled);
        }
        let pose_shape = array.shape[1..].to_vec();
        let (layout, first_shape) = match &mut layout {
            Some(layout) => layout,
            None => layout.insert((
                layout_of(&file.path, &pose_shape, options)?,
                pose_shape.clone(),
            )),
        };
        if *first_shape != pose_shape {
            let expected = format!("(frames, {}) as in {}", list(first_shape), first.display());
            let remedy = "import clips of different bodies separately";
            let value = shape_text(&array.shape);
            return Err(Error::bad_input(
                &file.path, "shape", value, expected, remedy,
            ));
        }
        check_poses(&file.path, layout, &array.values, options)?;
        poses.push(array.values);
    }
    Ok(Recordings {
        layout: layout.map(|(layout, _)| layout).unwrap_or_default(),
        rate_hz,
        skeleton: None,
        poses,
    })
}

fn layout_of(file: &Path, pose_shape: &[usize], options: &ImportOptions) -> Result<PoseLayout> {
    let (count, kind, word, unit) = match *pose_shape {
        [joint_count, _] => (joint_count, GroupKind::Position, "joint", Unit::Metre),
        _ => (pose_shape[0], GroupKind::Scalar, "channel", Unit::One),
    };
    if !options.names.is_empty() && options.names.len() != count {
        let value = format!("{} names", options.names.len());
        let expected = format!("{count}, one per {word} of {}", file.display());
        return Err(Error::bad_input(
            "--names",
            "count",
            value,
            expected,
            "correct the list",
        ));
    }
    let name = |index: usize| match options.names.get(index) {
        Some(name) => name.clone(),
        None => format!("{word}{index:02}"),
    };
    let group = |index| Group {
        name: name(index),
        kind,
        unit: options.unit.unwrap_or(unit),
    };
    Ok(PoseLayout {
        groups: (0..count).map(group).collect(),
    })
}

/// Decodes one file; checks everything except the values.
fn parse(file: &Path, bytes: &[u8]) -> Result<Array> {
    let refused = |field, value: String, expected, remedy| {
        Err(Error::bad_input(file, field, value, expected, remedy))
    };
    if bytes.is_empty() {
        return refused("length", "0 bytes".into(), "a NumPy array", EXPORT_AGAIN);
    }
    if !bytes.starts_with(MAGIC) {
        return refused("first bytes", "unknown".into(), "\\x93NUMPY", EXPORT_AGAIN);
    }
    match header_text(bytes) {
        None => return refused("header", "cut short".into(), "a whole one", EXPORT_AGAIN),
        Some(text) if !is_tame(text) => {
            let value = String::from_utf8_lossy(&text[..text.len().min(80)]).into_owned();
            return refused(
                "header",
                value,
                "that of a plain array of f4 or f8",
                EXPORT_AGAIN,
            );
        }
        Some(_) => (),
    }
    let mut data = bytes;
    let header = match NpyHeader::from_reader(&mut data) {
        Ok(header) => header,
        Err(error) => return refused("header", error.to_string(), "a NumPy array", EXPORT_AGAIN),
    };
    let Some(value_len_bytes) = float_len_bytes(&header.dtype()) else {
        let remedy = "convert with array.astype(numpy.float32)";
        return refused("dtype", header.dtype().descr(), "f4 or f8", remedy);
    };
    let shape: Vec<usize> = header
        .shape()
        .iter()
        .map(|&extent| extent as usize)
        .collect();
    if !matches!(shape[..], [_, (1..)] | [_, (1..), 3]) {
        let expected = "(frames, joints, 3) or (frames, channels)";
        return refused("shape", shape_text(&shape), expected, "reshape the array");
    }
    let len_bytes = shape.iter().product::<usize>() * value_len_bytes;
    if data.len() != len_bytes {
        let value = format!("{} bytes of values", data.len());
        let expected = format!("{len_bytes} for shape {}", shape_text(&shape));
        return Err(Error::bad_input(
            file,
            "length",
            value,
            expected,
            EXPORT_AGAIN,
        ));
    }
    let strides: Vec<usize> = header
        .strides()
        .iter()
        .map(|&stride| stride as usize)
        .collect();
    let order = header.order();
    let npy = NpyFile::with_header(header, data);
    let values = match value_len_bytes {
        4 => npy.into_vec::<f32>(),
        _ => npy
            .into_vec::<f64>()
            .map(|values| values.iter().map(|&value| value as f32).collect()),
    };
    let values = values.map_err(Error::io("decode", file))?;
    Ok(match order {
        Order::C => Array { shape, values },
        Order::Fortran => in_c_order(shape, &strides, &values),
    })
}

const MAGIC: &[u8] = b"\x93NUMPY";
const EXPORT_AGAIN: &str = "export the clip again with numpy.save";

/// Whether the header is one that `npyz` parses without unbounded recursion or overflow.
///
/// 18 digits in all keep the product of the extents below 2^63; eight brackets are more than a plain array has.
fn is_tame(header: &[u8]) -> bool {
    let count = |is_counted: fn(u8) -> bool| header.iter().filter(|&&b| is_counted(b)).count();
    header.len() <= 1024
        && count(|byte| byte.is_ascii_digit()) <= 18
        && count(|byte| b"([{".contains(&byte)) <= 8
        && count(|byte| b"+xX".contains(&byte)) == 0
}

/// The text between the magic bytes and the values; `None` if the file ends before it does.
fn header_text(bytes: &[u8]) -> Option<&[u8]> {
    let (start, len_bytes) = match *bytes {
        [_, _, _, _, _, _, 1, _, a, b, ..] => (10, usize::from(u16::from_le_bytes([a, b]))),
        [_, _, _, _, _, _, _, _, a, b, c, d, ..] => (12, u32::from_le_bytes([a, b, c, d]) as usize),
        _ => return None,
    };
    bytes.get(start..start + len_bytes)
}

fn float_len_bytes(dtype: &DType) -> Option<usize> {
    match dtype {
        DType::Plain(plain) if plain.type_char() == TypeChar::Float => plain
            .num_bytes()
            .filter(|len_bytes| matches!(len_bytes, 4 | 8)),
        _ => None,
    }
}

/// Reorders values whose first index runs fastest.
fn in_c_order(shape: Vec<usize>, strides: &[usize], stored: &[f32]) -> Array {
    let mut values = Vec::with_capacity(stored.len());
    let mut index = vec![0; shape.len()];
    for _ in 0..stored.len() {
        let offset: usize = index
            .iter()
            .zip(strides)
            .map(|(i, stride)| i * stride)
            .sum();
        values.push(stored[offset]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            if index[axis] < shape[axis] {
                break;
            }
            index[axis] = 0;
        }
    }
    Array { shape, values }
}

fn shape_text(shape: &[usize]) -> String {
    format!("({})", list(shape))
}

fn list(extents: &[usize]) -> String {
    let texts: Vec<String> = extents.iter().map(usize::to_string).collect();
    texts.join(", ")
}
