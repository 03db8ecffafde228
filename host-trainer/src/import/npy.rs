//! Station 1: NumPy arrays → clips; one array a file, (frames, joints, 3) or (frames, channels),
//! f32 or f64.
//!
//! Source: NEP 1, "A Simple File Format for NumPy Arrays"; the `npyz` crate decodes it. Its header
//! parser recurses and multiplies without bounds, so headers that no array of poses needs are
//! refused before it sees them.

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
        return Err(Error::bad_input(first, "rate", "unknown", expected, "add --fps RATE"));
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
            None => {
                layout.insert((layout_of(&file.path, &pose_shape, options)?, pose_shape.clone()))
            }
        };
        if *first_shape != pose_shape {
            let expected = format!("(frames, {}) as in {}", list(first_shape), first.display());
            let remedy = "import clips of different bodies separately";
            let value = shape_text(&array.shape);
            return Err(Error::bad_input(&file.path, "shape", value, expected, remedy));
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
        return Err(Error::bad_input("--names", "count", value, expected, "correct the list"));
    }
    let name = |index: usize| match options.names.get(index) {
        Some(name) => name.clone(),
        None => format!("{word}{index:02}"),
    };
    let group = |index| Group { name: name(index), kind, unit: options.unit.unwrap_or(unit) };
    Ok(PoseLayout { groups: (0..count).map(group).collect() })
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
            return refused("header", value, "that of a plain array of f4 or f8", EXPORT_AGAIN);
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
    let shape: Vec<usize> = header.shape().iter().map(|&extent| extent as usize).collect();
    if !matches!(shape[..], [_, (1..)] | [_, (1..), 3]) {
        let expected = "(frames, joints, 3) or (frames, channels)";
        return refused("shape", shape_text(&shape), expected, "reshape the array");
    }
    let len_bytes = shape.iter().product::<usize>() * value_len_bytes;
    if data.len() != len_bytes {
        let value = format!("{} bytes of values", data.len());
        let expected = format!("{len_bytes} for shape {}", shape_text(&shape));
        return Err(Error::bad_input(file, "length", value, expected, EXPORT_AGAIN));
    }
    let strides: Vec<usize> = header.strides().iter().map(|&stride| stride as usize).collect();
    let order = header.order();
    let npy = NpyFile::with_header(header, data);
    let values = match value_len_bytes {
        4 => npy.into_vec::<f32>(),
        _ => npy.into_vec::<f64>().map(|values| values.iter().map(|&value| value as f32).collect()),
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
/// 18 digits in all keep the product of the extents below 2^63; eight brackets are more than a
/// plain array has.
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
        DType::Plain(plain) if plain.type_char() == TypeChar::Float => {
            plain.num_bytes().filter(|len_bytes| matches!(len_bytes, 4 | 8))
        }
        _ => None,
    }
}

/// Reorders values whose first index runs fastest.
fn in_c_order(shape: Vec<usize>, strides: &[usize], stored: &[f32]) -> Array {
    let mut values = Vec::with_capacity(stored.len());
    let mut index = vec![0; shape.len()];
    for _ in 0..stored.len() {
        let offset: usize = index.iter().zip(strides).map(|(i, stride)| i * stride).sum();
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::support::{assert_refused, npy, npy_f32};
    use super::super::{read as import, support};
    use super::*;
    use crate::clip::ClipSet;

    fn parsed(bytes: &[u8]) -> Result<Array> {
        parse(Path::new("walk.npy"), bytes)
    }

    fn imported(files: &[(&str, Vec<u8>)], change: impl Fn(&mut ImportOptions)) -> Result<ClipSet> {
        let files: Vec<(&str, &[u8])> =
            files.iter().map(|(name, bytes)| (*name, bytes.as_slice())).collect();
        let folder = support::folder(&files);
        let mut options = ImportOptions { rate_hz: Some(20.0), ..Default::default() };
        options.tolerate_missing_labels = true;
        change(&mut options);
        import(folder.path(), &options)
    }

    #[test]
    fn file_cut_at_any_length_is_refused() {
        let bytes = npy_f32("(2, 1, 3)", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_refused(parsed(&[]), &["walk.npy", "length is 0 bytes"]);
        for length in 0..bytes.len() {
            assert_refused(parsed(&bytes[..length]), &["walk.npy", "numpy.save"]);
        }
        let cut = parsed(&bytes[..bytes.len() - 1]);
        assert_refused(cut, &["23 bytes of values", "24 for shape (2, 1, 3)"]);
    }

    #[test]
    fn file_with_bytes_after_the_values_is_refused() {
        let mut bytes = npy_f32("(2, 1)", &[1.0, 2.0]);
        bytes.push(0);
        assert_refused(parsed(&bytes), &["9 bytes of values", "8 for"]);
    }

    #[test]
    fn file_of_another_kind_is_refused() {
        assert_refused(parsed(b"PK\x03\x04 a zip"), &["first bytes", "NUMPY"]);
    }

    #[test]
    fn wrong_dtype_is_refused_by_name() {
        for dtype in ["<i4", "<c8", "<f2", "|O", "<U8", "|b1", "<f16"] {
            let result = parsed(&npy(dtype, false, "(2, 1)", &[0; 64]));
            assert_refused(result, &["walk.npy", "dtype", dtype, "f4 or f8", "astype"]);
        }
    }

    #[test]
    fn wrong_shape_is_refused() {
        for shape in ["()", "(6,)", "(2, 3, 4)", "(1, 2, 3, 1)", "(2, 0, 3)", "(2, 0)"] {
            let result = parsed(&npy_f32(shape, &[0.0; 6]));
            assert_refused(result, &["shape is", "(frames, joints, 3)"]);
        }
    }

    #[test]
    fn header_that_would_overwhelm_its_parser_is_refused() {
        let nested = format!("({}", "[".repeat(100_000 / 2));
        let huge = "(4294967296, 4294967296, 3)";
        for shape in [&nested[..], huge, "(0xffffffffffffffff, 0xff)", "(1 + 1.0, 2)"] {
            assert_refused(parsed(&npy_f32(shape, &[])), &["walk.npy", "header"]);
        }
    }

    #[test]
    fn missing_rate_is_refused() {
        let result = imported(&[("a.npy", npy_f32("(2, 1)", &[0.0, 1.0]))], |options| {
            options.rate_hz = None;
        });
        assert_refused(result, &["a.npy", "rate", "--fps"]);
    }

    #[test]
    fn one_frame_is_refused() {
        let result = imported(&[("a.npy", npy_f32("(1, 1, 3)", &[0.0; 3]))], |_| ());
        assert_refused(result, &["a.npy", "length is 1 frame", "at least 2 frames"]);
        let result = imported(&[("a.npy", npy_f32("(0, 1, 3)", &[]))], |_| ());
        assert_refused(result, &["a.npy", "length is 0 frames"]);
    }

    #[test]
    fn non_finite_value_is_refused_with_its_place_unless_tolerated() {
        let mut values = [0.0; 12];
        values[10] = f32::NAN;
        let files = [("a.npy", npy_f32("(2, 2, 3)", &values))];
        assert_refused(imported(&files, |_| ()), &["a.npy", "frame 1, joint01_y_m", "NaN"]);
        let set = imported(&files, |options| options.tolerate_non_finite = true).unwrap();
        assert!(set.clips[0].poses[10].is_nan());
    }

    #[test]
    fn value_beyond_f32_is_refused() {
        let bytes = [1.0f64, 1e300].map(f64::to_le_bytes).concat();
        let result = imported(&[("a.npy", npy("<f8", false, "(2, 1)", &bytes))], |_| ());
        assert_refused(result, &["frame 1, channel00_one", "inf"]);
    }

    #[test]
    fn mixed_joint_counts_are_refused() {
        let files = [
            ("a.npy", npy_f32("(2, 1, 3)", &[0.0; 6])),
            ("b.npy", npy_f32("(2, 2, 3)", &[0.0; 12])),
        ];
        let result = imported(&files, |_| ());
        assert_refused(result, &["b.npy", "(2, 2, 3)", "(frames, 1, 3)", "a.npy"]);
        let files =
            [("a.npy", npy_f32("(2, 1, 3)", &[0.0; 6])), ("b.npy", npy_f32("(2, 3)", &[0.0; 6]))];
        assert_refused(imported(&files, |_| ()), &["b.npy", "(2, 3)"]);
    }

    #[test]
    fn wrong_number_of_names_is_refused() {
        let result = imported(&[("a.npy", npy_f32("(2, 2)", &[0.0; 4]))], |options| {
            options.names = vec!["jaw".into()];
        });
        assert_refused(result, &["--names", "1 names", "2, one per channel"]);
    }

    #[test]
    fn floats_of_both_sizes_and_byte_orders_are_read() {
        let expected = Array { shape: vec![2, 1], values: vec![1.5, -2.0] };
        let double = [1.5f64, -2.0].map(f64::to_le_bytes).concat();
        assert_eq!(parsed(&npy("<f8", false, "(2, 1)", &double)).unwrap(), expected);
        let big_endian = [1.5f32, -2.0].map(f32::to_be_bytes).concat();
        assert_eq!(parsed(&npy(">f4", false, "(2, 1)", &big_endian)).unwrap(), expected);
    }

    #[test]
    fn fortran_order_is_brought_to_c_order() {
        // Element (frame, joint, axis) is 100 frame + 10 joint + axis; in Fortran order the frame
        // runs fastest.
        let stored = [0.0f32, 100.0, 10.0, 110.0, 1.0, 101.0, 11.0, 111.0, 2.0, 102.0, 12.0, 112.0];
        let bytes = npy("<f4", true, "(2, 2, 3)", &stored.map(f32::to_le_bytes).concat());
        let expected = [0.0, 1.0, 2.0, 10.0, 11.0, 12.0, 100.0, 101.0, 102.0, 110.0, 111.0, 112.0];
        assert_eq!(parsed(&bytes).unwrap().values, expected);
    }

    #[test]
    fn joints_are_positions_and_channels_are_scalars() {
        let joints = [("a.npy", npy_f32("(2, 1, 3)", &[1.0; 6]))];
        let set = imported(&joints, |options| options.scale = Some(0.05)).unwrap();
        assert_eq!(set.layout.channel_names(), ["joint00_x_m", "joint00_y_m", "joint00_z_m"]);
        assert_eq!((set.rate_hz, set.clips[0].poses[0]), (20.0, 0.05));
        let channels = [("a.npy", npy_f32("(2, 2)", &[1.0; 4]))];
        let set = imported(&channels, |options| {
            options.names = vec!["jaw".into(), "neck".into()];
            options.unit = Some(Unit::Degree);
        });
        assert_eq!(set.unwrap().layout.channel_names(), ["jaw_deg", "neck_deg"]);
    }

    proptest! {
        #[test]
        fn any_array_survives_the_round_trip(
            (joint_count, values) in (1usize..5).prop_flat_map(|joint_count| {
                let value = proptest::num::f32::NORMAL;
                (Just(joint_count), prop::collection::vec(value, 0..20 * joint_count * 3))
            }),
        ) {
            let frame_count = values.len() / (joint_count * 3);
            let values = &values[..frame_count * joint_count * 3];
            let shape = format!("({frame_count}, {joint_count}, 3)");
            let array = parsed(&npy_f32(&shape, values)).unwrap();
            prop_assert_eq!(array.shape, [frame_count, joint_count, 3]);
            prop_assert_eq!(array.values, values);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = parsed(&bytes);
            let _ = parsed(&[MAGIC, &[1, 0], &bytes].concat());
        }

        #[test]
        fn arbitrary_headers_never_panic(dtype in ".{0,8}", shape in "[-(){}\\[\\],0-9a-fxLTrue'+. ]{0,40}") {
            let _ = parsed(&npy(&dtype, true, &shape, &[0; 24]));
        }

        #[test]
        fn damaged_file_never_panics(index in 0usize..100, byte: u8) {
            let mut bytes = npy_f32("(2, 1, 3)", &[0.0; 6]);
            let index = index % bytes.len();
            bytes[index] = byte;
            let _ = parsed(&bytes);
        }
    }
}
