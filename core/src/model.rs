//! Station 7: a checked, borrowed view of a blob. Weights stay where they are, in flash.
//!
//! In:  bytes, at any alignment.
//! Out: layers and tables to `decoder.rs` and `sampler.rs`; names and units to the application.
//!
//! Why here: everything that can be wrong is found once, in `Model::from_bytes`; decoding cannot fail afterwards.

use crate::blob::{Envelope, aligned};
use crate::code::Code;
use crate::error::{BlobError, SampleError};
use crate::layer::{Layer, Order};
use crate::limits::LAYERS_MAX;
use crate::little_endian::i16s;
use crate::manifest::{
    CODE_LAYER, Group, Joint, LayerShape, Manifest, NumberFormat, Provenance, TIME_LAYER,
    TensorKind, tensor_plan,
};
use crate::manifest_check;
use crate::sampler::Sampler;
use crate::time_embedding::FramePosition;

/// Index of an action; the order of [`Model::actions`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ActionId(pub u16);

/// A checked model. Copies nothing of the blob but its manifest (a few hundred bytes).
#[derive(Clone, Debug)]
pub struct Model<'a> {
    manifest: Manifest<'a>,
    /// Postcard of groups, action names and joints.
    names: &'a [u8],
    pub(crate) frequencies: &'a [u8],
    /// i16. // (frame, out)
    time_table: &'a [u8],
    pub(crate) sampler: Sampler<'a>,
    /// Code half of layer 1, time half of layer 1, then the others.
    pub(crate) layers: heapless::Vec<Layer<'a>, LAYERS_MAX>,
}

impl<'a> Model<'a> {
    /// Checks a blob completely.
    ///
    /// # Errors
    /// A [`BlobError`] that names what is wrong; see its variants for what to do.
    ///
    /// # Cost
    /// Reads every byte about twice: CRC-32, then the accumulator certificate of each row.
    pub fn from_bytes(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let envelope = Envelope::parse(bytes)?;
        let (manifest, names) = postcard::take_from_bytes::<Manifest<'a>>(envelope.descriptions)
            .map_err(|_| BlobError::BadField { field: "manifest", value: 0 })?;
        manifest_check::check(&manifest, bytes)?;
        let mut model = Self::slice_tensors(&envelope, manifest, names)?;
        model.check_names()?;
        model.sampler.check()?;
        let format = model.manifest.number_format;
        let hidden = TIME_LAYER..model.layers.len().saturating_sub(1);
        for (index, layer) in model.layers.iter_mut().enumerate() {
            layer.check(index, format)?;
            if format != NumberFormat::F16 && hidden.contains(&index) && !layer.is_narrow() {
                return Err(BlobError::BadField {
                    field: "row scale of layer",
                    value: index as u32,
                });
            }
        }
        model.check_time_table()?;
        Ok(model)
    }

    /// Stored products must not reach beyond what the time half's own could: its room was measured by those.
    fn check_time_table(&self) -> Result<(), BlobError> {
        let room = self.layers.get(TIME_LAYER).map_or(0, Layer::room);
        let products_max = i64::from(i32::MAX - room);
        let shift = self.manifest.time_table_shift & 15;
        let too_large = |entry: i16| i64::from(entry).abs() << shift > products_max;
        match i16s(self.time_table).position(too_large) {
            Some(index) => Err(BlobError::BadField { field: "time table", value: index as u32 }),
            None => Ok(()),
        }
    }

    /// Cuts the blob into tensors by the manifest's plan; the plan must end exactly where the blob ends.
    fn slice_tensors(
        envelope: &Envelope<'a>,
        manifest: Manifest<'a>,
        names: &'a [u8],
    ) -> Result<Self, BlobError> {
        let found = envelope.bytes.len();
        let (mut frequencies, mut time_table) = (&[][..], &[][..]);
        let mut sampler = Sampler::new(&manifest);
        let (packing, format) = (manifest.packing, manifest.number_format);
        let mut layers = heapless::Vec::<Layer<'a>, LAYERS_MAX>::new();
        for (index, &shape) in manifest.layers.iter().enumerate() {
            // As many fit as the manifest can name; `collect` would panic beyond.
            let _ = layers.push(Layer::new(shape, packing, format, index));
        }
        let mut end = envelope.tensors_start();
        for (kind, length) in tensor_plan(&manifest) {
            let start = aligned(end);
            end = start + length;
            let expected = usize::try_from(end).unwrap_or(usize::MAX);
            let tensor = usize::try_from(start)
                .ok()
                .and_then(|start| envelope.bytes.get(start..expected))
                .ok_or(BlobError::WrongLength { found, expected })?;
            match kind {
                TensorKind::Frequencies => frequencies = tensor,
                TensorKind::TimeTable => time_table = tensor,
                TensorKind::Weights(index)
                | TensorKind::GroupScales(index)
                | TensorKind::Bias(index)
                | TensorKind::Scales(index) => {
                    if let Some(layer) = layers.get_mut(index) {
                        layer.set_tensor(kind, tensor);
                    }
                }
                _ => sampler.set_tensor(kind, tensor),
            }
        }
        if end != found as u64 {
            let expected = usize::try_from(end).unwrap_or(usize::MAX);
            return Err(BlobError::WrongLength { found, expected });
        }
        Ok(Self { manifest, names, frequencies, time_table, sampler, layers })
    }

    /// Walks all names once, so that the iterators below cannot meet a broken one later.
    fn check_names(&self) -> Result<(), BlobError> {
        let bad = |field, value: usize| BlobError::BadField { field, value: value as u32 };
        let channels: usize = self.groups().map(|group| group.kind.channel_count()).sum();
        if self.groups().count() != usize::from(self.manifest.group_count) {
            return Err(bad("groups", self.groups().count()));
        }
        if channels != self.channel_count() {
            return Err(bad("channels of the layout", channels));
        }
        if self.actions().count() != usize::from(self.manifest.action_count) {
            return Err(bad("actions", self.actions().count()));
        }
        if self.joints().count() != usize::from(self.manifest.joint_count) {
            return Err(bad("joints", self.joints().count()));
        }
        let parent_follows = |(index, joint): (usize, Joint<'_>)| match joint.parent {
            Some(parent) => usize::from(parent) >= index,
            None => index != 0,
        };
        match self.joints().enumerate().position(parent_follows) {
            Some(index) => Err(bad("joint parent", index)),
            None if self.joint_stream().trailing().is_empty() => Ok(()),
            None => Err(bad("bytes after the names", self.joint_stream().trailing().len())),
        }
    }

    /// Groups of the layout, in channel order.
    pub fn groups(&self) -> impl Iterator<Item = Group<'a>> + use<'a> {
        self.group_stream()
    }

    /// Names of the actions, in the order of [`ActionId`].
    pub fn actions(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.action_stream()
    }

    /// Joints of the skeleton; none when the model has no skeleton.
    pub fn joints(&self) -> impl Iterator<Item = Joint<'a>> + use<'a> {
        self.joint_stream()
    }

    fn group_stream(&self) -> Names<'a, Group<'a>> {
        Names::new(self.names, self.manifest.group_count)
    }

    fn action_stream(&self) -> Names<'a, &'a str> {
        Names::new(self.group_stream().trailing(), self.manifest.action_count)
    }

    fn joint_stream(&self) -> Names<'a, Joint<'a>> {
        Names::new(self.action_stream().trailing(), self.manifest.joint_count)
    }

    /// The action with this name.
    pub fn action_by_name(&self, name: &str) -> Option<ActionId> {
        let index = self.actions().position(|action| action == name)?;
        u16::try_from(index).ok().map(ActionId)
    }

    /// Shortest and longest trained motion of an action, in frames; both 0 when there is no such action.
    pub fn trained_frames(&self, action: ActionId) -> core::ops::RangeInclusive<u32> {
        self.sampler.trained_frames(action)
    }

    /// Draws the code of a new motion. Any generator serves: `&mut || rng.next_u32()`.
    ///
    /// # Errors
    /// [`SampleError`]: no such action, or a length that was never trained.
    pub fn sample(
        &self,
        action: ActionId,
        frames: u32,
        random: &mut impl FnMut() -> u32,
    ) -> Result<Code, SampleError> {
        self.sampler.sample(action, frames, random)
    }

    /// A code from floats (β then α), rounded to nearest, saturated; numbers beyond the model's are dropped, missing
    /// ones are 0. For hosts: the device draws its codes with [`sample`](Self::sample).
    pub fn code_from_f32(&self, values: &[f32]) -> Code {
        let one = (1u32 << self.manifest.code_fraction_bits) as f32;
        let given = values.iter().copied().chain(core::iter::repeat(0.0));
        let round = |value: f32| {
            let scaled = value * one;
            (if scaled < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as i16
        };
        Code::default().append(given.take(self.code_count()).map(round))
    }

    /// The numbers of a code (β then α) as floats, exact.
    pub fn code_to_f32(&self, code: &Code) -> impl Iterator<Item = f32> {
        let one = (1u32 << self.manifest.code_fraction_bits) as f32;
        code.values.clone().into_iter().map(move |value| f32::from(value) / one)
    }

    /// Everything of fixed size that the blob says about itself.
    pub fn manifest(&self) -> &Manifest<'a> {
        &self.manifest
    }

    /// How weights and activations are stored.
    pub fn number_format(&self) -> NumberFormat {
        self.manifest.number_format
    }

    /// Poses per 1000 s.
    pub fn rate_millihz(&self) -> u32 {
        self.manifest.rate_millihz
    }

    /// Where the model comes from.
    pub fn provenance(&self) -> Provenance {
        self.manifest.provenance
    }

    /// Channels of a pose.
    pub fn channel_count(&self) -> usize {
        self.manifest.layers.last().map_or(0, |shape| usize::from(shape.output_count))
    }

    /// Numbers of a code, β and α together.
    pub fn code_count(&self) -> usize {
        usize::from(self.manifest.sequence_code_count)
            + usize::from(self.manifest.action_code_count)
    }

    /// Width of the [`Workspace`](crate::Workspace) that the model needs.
    pub fn workspace_width(&self) -> usize {
        let widths = self.manifest.layers.iter().enumerate().map(|(index, shape)| {
            let codes_need_room = index != CODE_LAYER || self.number_format() != NumberFormat::F16;
            let columns = if codes_need_room { shape.columns_filled() } else { 0 };
            columns.max(shape.rows_filled())
        });
        widths.max().unwrap_or(0)
    }

    pub(crate) fn check_width(&self, width: usize) -> Result<(), BlobError> {
        let needed = self.workspace_width();
        if width < needed {
            return Err(BlobError::WorkspaceTooSmall { width, needed });
        }
        Ok(())
    }

    /// Products of the time half at a position, i16 a row, where the blob's time table holds them.
    pub(crate) fn time_table_row(&self, position: FramePosition) -> Option<&'a [u8]> {
        let frame = position.whole_frame()?;
        if frame >= u32::from(self.manifest.time_table_frames) {
            return None;
        }
        let bytes = 2 * self.manifest.layers.get(TIME_LAYER)?.rows_filled();
        let start = usize::try_from(frame).ok()?.checked_mul(bytes)?;
        self.time_table.get(start..)?.get(..bytes)
    }

    /// What the integer kernels need for two frames in one pass: tiles of 8-bit weights in every layer.
    pub(crate) fn has_pair_kernels(&self) -> bool {
        self.layers.iter().all(|layer| matches!(layer.order, Order::Bytes | Order::Halfwords))
    }

    /// Multiply-accumulates to begin a motion (the code half of layer 1).
    pub fn multiply_accumulates_per_motion(&self) -> u64 {
        self.manifest.layers.get(CODE_LAYER).map_or(0, multiply_accumulates)
    }

    /// Multiply-accumulates of one pose.
    pub fn multiply_accumulates_per_pose(&self) -> u64 {
        self.manifest.layers.iter().skip(TIME_LAYER).map(multiply_accumulates).sum()
    }
}

fn multiply_accumulates(shape: &LayerShape) -> u64 {
    u64::from(shape.input_count) * u64::from(shape.output_count)
}

/// Postcard values that lie one after another; ends early at a broken one.
struct Names<'a, Item> {
    bytes: &'a [u8],
    remaining: u16,
    item: core::marker::PhantomData<Item>,
}

impl<'a, Item: serde::Deserialize<'a>> Names<'a, Item> {
    fn new(bytes: &'a [u8], count: u16) -> Self {
        Self { bytes, remaining: count, item: core::marker::PhantomData }
    }

    /// The bytes after the last item.
    fn trailing(mut self) -> &'a [u8] {
        while self.next().is_some() {}
        self.bytes
    }
}

impl<'a, Item: serde::Deserialize<'a>> Iterator for Names<'a, Item> {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        self.remaining = self.remaining.checked_sub(1)?;
        let (item, rest) = postcard::take_from_bytes(self.bytes).ok()?;
        self.bytes = rest;
        Some(item)
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::blob::{HEADER_BYTES, VERSION};
    use crate::manifest::SamplerKind;
    use crate::specimen::specimen;

    /// How many bytes apart blobs are damaged: Miri is slow.
    const STRIDE: usize = if cfg!(miri) { 101 } else { 1 };

    fn w8a16() -> Vec<u8> {
        specimen(NumberFormat::W8A16, SamplerKind::ClipCodes)
    }

    #[test]
    fn blob_cut_at_every_length_is_rejected() {
        let blob = w8a16();
        for length in (0..blob.len()).step_by(STRIDE) {
            assert!(Model::from_bytes(&blob[..length]).is_err(), "{length} bytes were accepted");
        }
    }

    #[test]
    fn blob_with_any_single_byte_changed_is_rejected() {
        for format in NumberFormat::ALL {
            let mut blob = specimen(format, SamplerKind::DiagonalMixture);
            for index in (0..blob.len()).step_by(STRIDE) {
                for flip in [1u8, 0x80, 0xFF] {
                    blob[index] ^= flip;
                    assert!(Model::from_bytes(&blob).is_err(), "byte {index} ^ {flip}");
                    blob[index] ^= flip;
                }
            }
        }
    }

    #[test]
    fn blob_with_trailing_bytes_is_rejected() {
        let mut blob = w8a16();
        blob.push(0);
        assert!(matches!(Model::from_bytes(&blob), Err(BlobError::WrongLength { .. })));
    }

    /// Says something only in builds that lack a format; `.ci/test` makes one.
    #[test]
    fn format_that_is_not_built_is_rejected_by_name() {
        for format in NumberFormat::ALL {
            let blob = specimen(format, SamplerKind::ClipCodes);
            let refusal = Model::from_bytes(&blob).err();
            let expected = (!format.is_built()).then_some(BlobError::FormatNotBuilt(format));
            assert_eq!(refusal, expected, "{}", format.name());
        }
    }

    #[test]
    fn blob_of_a_newer_version_is_named() {
        let mut blob = w8a16();
        blob[4..6].copy_from_slice(&(VERSION + 1).to_le_bytes());
        let error = Model::from_bytes(&blob).unwrap_err();
        assert_eq!(error, BlobError::NewerVersion { found: VERSION + 1, newest: VERSION });
        assert!(error.to_string().contains("newer"));
    }

    #[test]
    fn blob_loads_at_every_alignment() {
        let blob = w8a16();
        for offset in 0..16 {
            let mut shifted = std::vec![0; offset];
            shifted.extend(&blob);
            assert!(Model::from_bytes(&shifted[offset..]).is_ok(), "offset {offset}");
        }
    }

    #[test]
    fn blob_describes_itself() {
        let blob = w8a16();
        let model = Model::from_bytes(&blob).unwrap();
        assert_eq!(model.actions().collect::<Vec<_>>(), ["nod", "walk"]);
        assert_eq!(model.groups().map(|group| group.name).collect::<Vec<_>>(), ["root", "jaw"]);
        assert_eq!(model.joints().map(|joint| joint.parent).collect::<Vec<_>>(), [None, Some(0)]);
        assert_eq!(model.action_by_name("walk"), Some(ActionId(1)));
        assert_eq!(model.action_by_name("fly"), None);
        assert_eq!(model.trained_frames(ActionId(0)), 10..=30);
        assert_eq!((model.channel_count(), model.code_count(), model.workspace_width()), (4, 5, 8));
        assert_eq!(model.multiply_accumulates_per_motion(), 30);
        assert_eq!(model.multiply_accumulates_per_pose(), 48 + 42 + 28);
    }

    #[test]
    fn code_survives_the_way_through_floats() {
        let blob = w8a16();
        let model = Model::from_bytes(&blob).unwrap();
        let code = model.sample(ActionId(1), 45, &mut || 0x1234_5678).unwrap();
        let floats: Vec<f32> = model.code_to_f32(&code).collect();
        assert_eq!(model.code_from_f32(&floats), code);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let _ = Model::from_bytes(&bytes);
        }

        /// Past the checksum every field is still checked: damage the inside and seal it again.
        #[test]
        fn sealed_damage_never_panics(index in HEADER_BYTES..400usize, value: u8, seed: u32) {
            let mut blob = w8a16();
            let index = index % blob.len();
            blob[index] = value;
            crate::blob::seal_again(&mut blob);
            if let Ok(model) = Model::from_bytes(&blob) {
                for action in 0..3 {
                    let action = ActionId(action);
                    let frames = *model.trained_frames(action).start();
                    let _ = model.sample(action, frames, &mut || seed);
                }
                let mut workspace = crate::Workspace::<64>::new();
                if let Ok(mut decoder) = crate::Decoder::new(&model, &mut workspace) {
                    decoder.start(&crate::Code::default());
                    decoder.decode(crate::FramePosition::from_bits(seed), &mut crate::Pose::new());
                }
            }
        }
    }
}
