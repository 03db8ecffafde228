//! Fields that no quantiser writes: each is refused by its name, however well the checksum fits.
//!
//! Why here: `blob_rejection.rs` damages bytes blindly; this changes one meaning at a time in real blobs, as a mistake
//! in a writer would.

use karakuri::blob::{ALIGNMENT, BlobParts, HEADER_BYTES};
use karakuri::manifest::{
    Group, Joint, Manifest, NumberFormat, Packing, SamplerKind, TIME_LAYER, TensorKind,
    WeightFormat, tensor_plan,
};
use karakuri::{BlobError, Model};
use tests::{FLOAT_FORMAT, FORMATS, golden_blob, seal};

/// A blob taken apart.
struct Parts<'a> {
    manifest: Manifest<'a>,
    groups: Vec<Group<'a>>,
    actions: Vec<&'a str>,
    joints: Vec<Joint<'a>>,
    tensors: Vec<(TensorKind, Vec<u8>)>,
}

impl<'a> Parts<'a> {
    fn of(blob: &'a [u8]) -> Self {
        let model = Model::from_bytes(blob).expect("a committed blob loads");
        let manifest = model.manifest().clone();
        let descriptions: [u8; 4] = blob[16..20].try_into().expect("four bytes");
        let mut end = HEADER_BYTES + u32::from_le_bytes(descriptions) as usize;
        let cut = |(kind, length): (TensorKind, u64)| {
            let start = end.next_multiple_of(ALIGNMENT);
            end = start + length as usize;
            (kind, blob[start..end].to_vec())
        };
        Self {
            tensors: tensor_plan(&manifest).map(cut).collect(),
            groups: model.groups().collect(),
            actions: model.actions().collect(),
            joints: model.joints().collect(),
            manifest,
        }
    }

    fn tensor(&mut self, kind: TensorKind) -> &mut Vec<u8> {
        let found = self.tensors.iter_mut().find(|(known, _)| *known == kind);
        &mut found.expect("a tensor of the plan").1
    }

    /// Replaces the number that ends `from_end` bytes before the end of a tensor.
    fn set<const BYTES: usize>(&mut self, kind: TensorKind, from_end: usize, number: [u8; BYTES]) {
        let tensor = self.tensor(kind);
        let start = tensor.len() - from_end - BYTES;
        tensor[start..start + BYTES].copy_from_slice(&number);
    }

    /// Every tensor as long as the manifest promises, filled with zeros.
    fn assemble(mut self) -> Vec<u8> {
        let manifest = self.manifest.clone();
        for (kind, length) in tensor_plan(&manifest) {
            self.tensor(kind).resize(length as usize, 0);
        }
        let tensors: Vec<_> =
            self.tensors.iter().map(|(kind, bytes)| (*kind, &bytes[..])).collect();
        let parts = BlobParts {
            manifest: &self.manifest,
            groups: &self.groups,
            actions: &self.actions,
            joints: &self.joints,
            tensors: &tensors,
        };
        let mut blob = vec![0; 1 << 20];
        let length = parts.emit(&mut blob).expect("a planned blob");
        blob.truncate(length);
        blob
    }
}

/// The committed blob of a format after a change.
fn forged(format: &str, change: impl FnOnce(&mut Parts<'_>)) -> Vec<u8> {
    let blob = golden_blob(format);
    let mut parts = Parts::of(&blob);
    change(&mut parts);
    parts.assemble()
}

/// What loading says to it.
fn refusal(format: &str, change: impl FnOnce(&mut Parts<'_>)) -> Option<BlobError> {
    Model::from_bytes(&forged(format, change)).err()
}

fn bad(field: &'static str, value: usize) -> Option<BlobError> {
    Some(BlobError::BadField { field, value: value as u32 })
}

fn integer_formats() -> impl Iterator<Item = &'static str> {
    FORMATS.into_iter().filter(|format| *format != FLOAT_FORMAT)
}

fn layer_count(format: &str) -> usize {
    Parts::of(&golden_blob(format)).manifest.layers.len()
}

#[test]
fn blob_taken_apart_and_assembled_is_the_same_bytes() {
    for format in FORMATS {
        assert!(forged(format, |_| ()) == golden_blob(format), "{format}");
    }
}

/// Number format, packing, weight format, sampler: a variant that this version does not know.
#[test]
fn unknown_variant_is_refused() {
    for format in FORMATS {
        let other =
            |change: fn(&mut Manifest<'_>)| forged(format, |parts| change(&mut parts.manifest));
        let formats: fn(&mut Manifest<'_>) = |manifest| {
            let is_first = manifest.number_format == NumberFormat::ALL[0];
            manifest.number_format = NumberFormat::ALL[usize::from(is_first)];
        };
        let weights: fn(&mut Manifest<'_>) = |manifest| {
            let shape = &mut manifest.layers[0];
            let is_i8 = shape.weights == WeightFormat::I8;
            shape.weights = if is_i8 { WeightFormat::Half } else { WeightFormat::I8 };
        };
        let changes: [fn(&mut Manifest<'_>); 4] = [
            formats,
            |manifest| manifest.packing = Packing::Rows,
            weights,
            |manifest| manifest.sampler.kind = SamplerKind::DiagonalMixture,
        ];
        for (index, changed) in changes.map(other).into_iter().enumerate() {
            let mut blob = golden_blob(format);
            let place = (HEADER_BYTES..).find(|&place| blob[place] != changed[place]);
            for variant in [4, 0x7f] {
                blob[place.expect("a change")] = variant;
                seal(&mut blob);
                let error = Model::from_bytes(&blob).err();
                assert_eq!(error, bad("manifest", 0), "{format}, change {index}, {variant}");
            }
        }
    }
}

#[test]
fn weights_that_the_number_format_does_not_allow_are_refused() {
    for (format, known) in FORMATS.into_iter().zip(NumberFormat::ALL) {
        let all = [WeightFormat::I8, WeightFormat::I4, WeightFormat::Half];
        for weights in all.into_iter().filter(|&weights| !known.allows(weights)) {
            for index in 0..layer_count(format) {
                let error = refusal(format, |parts| parts.manifest.layers[index].weights = weights);
                assert_eq!(error, bad("weight format of layer", index), "{format}, {weights:?}");
            }
        }
    }
}

#[test]
fn group_scale_beyond_15_bits_is_refused() {
    let format = "w4a8";
    let blob = golden_blob(format);
    let layers = Parts::of(&blob).manifest.layers.into_iter().enumerate();
    let nibbles = layers.filter(|(_, shape)| shape.weights == WeightFormat::I4);
    let nibbles: Vec<usize> = nibbles.map(|(index, _)| index).collect();
    assert!(!nibbles.is_empty(), "no layer has 4-bit weights");
    for index in nibbles {
        let kind = TensorKind::GroupScales(index);
        let scale_count = Parts::of(&blob).tensor(kind).len() / 2;
        for (scale, place) in [(32_768u16, 0), (u16::MAX, scale_count - 1)] {
            let error = refusal(format, |parts| parts.set(kind, 2 * place, scale.to_le_bytes()));
            assert_eq!(error, bad("group scale of layer", index), "scale {scale}");
        }
    }
}

#[test]
fn row_scale_with_a_bad_word_is_refused() {
    for format in integer_formats() {
        for index in 0..layer_count(format) {
            for word in [0u32, 1 << 30, 1 << 30 | 63, 1 << 31 | 40, u32::MAX] {
                let kind = TensorKind::Scales(index);
                let error = refusal(format, |parts| parts.set(kind, 0, word.to_le_bytes()));
                assert_eq!(error, bad("row scale of layer", index), "{format}, {word:#x}");
            }
        }
    }
}

/// Layers with an ELU requantise with the upper half of the product alone.
#[test]
fn row_scale_that_hidden_layers_cannot_shift_is_refused_there_and_only_there() {
    const SHIFT_MAX_REFUSED: u32 = 32;
    for format in integer_formats() {
        let last = layer_count(format) - 1;
        for index in 0..=last {
            let word = (1u32 << 30 | SHIFT_MAX_REFUSED).to_le_bytes();
            let error = refusal(format, |parts| parts.set(TensorKind::Scales(index), 0, word));
            let is_hidden = (TIME_LAYER..last).contains(&index);
            let expected = if is_hidden { bad("row scale of layer", index) } else { None };
            assert_eq!(error, expected, "{format}");
        }
    }
}

#[test]
fn activation_scale_that_would_overflow_is_refused() {
    for format in integer_formats() {
        for index in 0..layer_count(format) {
            for field in 0..5 {
                let error = refusal(format, |parts| {
                    let activation = &mut parts.manifest.layers[index].activation;
                    match field {
                        0 => activation.power_step = 0,
                        1 => activation.one = 1 << 15,
                        2 => activation.one_shift = 31,
                        3 => activation.zero_point = i16::MIN,
                        _ => activation.fraction_bits = 9,
                    }
                });
                assert_eq!(error, bad("activation scale of layer", index), "{format}, {field}");
            }
        }
    }
}

#[test]
fn bias_beyond_the_certificate_is_refused_with_its_row() {
    for format in integer_formats() {
        for layer in (0..layer_count(format)).filter(|&layer| layer != TIME_LAYER) {
            let kind = TensorKind::Bias(layer);
            let row_count = Parts::of(&golden_blob(format)).tensor(kind).len() / 4;
            for (bias, row) in [(i32::MAX, 0), (i32::MIN, row_count - 1)] {
                let from_end = 4 * (row_count - 1 - row);
                let error = refusal(format, |parts| {
                    // A row that only fills the block has no products.
                    parts.tensor(TensorKind::Weights(layer)).fill(1);
                    parts.set(kind, from_end, bias.to_le_bytes());
                });
                let expected = BlobError::AccumulatorOverflow { layer, row };
                assert_eq!(error, Some(expected), "{format}, {bias}");
            }
        }
    }
}

#[test]
fn time_table_that_is_shifted_too_far_is_refused() {
    for format in FORMATS {
        for value in [16, u8::MAX] {
            let error = refusal(format, |parts| parts.manifest.time_table_shift = value);
            let expected =
                BlobError::OverLimit { field: "time table shift", value: value.into(), max: 15 };
            assert_eq!(error, Some(expected), "{format}");
        }
    }
}

/// A table entry stands for products that the certificate has proved to fit beside any folded code.
#[test]
fn time_table_entry_beyond_the_certificate_is_refused() {
    for format in integer_formats() {
        for entry in [i16::MAX, i16::MIN] {
            let mut last = 0;
            let error = refusal(format, |parts| {
                parts.manifest.time_table_frames = 2;
                parts.manifest.time_table_shift = 15;
                let rows = parts.manifest.layers[TIME_LAYER].rows_filled();
                last = 2 * rows - 1;
                parts.tensor(TensorKind::TimeTable).resize(4 * rows, 0);
                parts.set(TensorKind::TimeTable, 0, entry.to_le_bytes());
            });
            assert_eq!(error, bad("time table", last), "{format}, {entry}");
        }
    }
}
