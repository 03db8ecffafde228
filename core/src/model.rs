//! Station 7: a checked, borrowed view of a blob. Weights stay where they are, in flash.
//!
//! In:  bytes; word-aligned where the kernels are assembly.
//! Out: layers and tables to `decoder.rs` and `sampler.rs`; names and units to the application.
//!
//! Why here: everything that can be wrong is found once, in `Model::from_bytes`; decoding cannot fail afterwards.

mod codes;

use crate::blob::{Envelope, aligned};
use crate::descriptions::Reader;
use crate::error::BlobError;
use crate::layer::{Inputs, Layer, Order};
use crate::limits::LAYERS_MAX;
use crate::little_endian::i16s;
use crate::manifest::{
    CODE_LAYER, Group, Joint, LayerShape, Manifest, NumberFormat, Provenance, TIME_LAYER,
    TensorKind, tensor_plan,
};
use crate::manifest_check;
use crate::sampler::Sampler;
use crate::servo_records::ServoRecords;
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
    /// Code half of layer 1, time half of layer 1, then the others: what begins with the layer's weights.
    layers: heapless::Vec<&'a [u8], LAYERS_MAX>,
    pub(crate) servos: ServoRecords<'a>,
    /// Largest magnitude that the products of a row of the time half can reach together.
    time_products_max: i32,
}

impl<'a> Model<'a> {
    /// A model of nothing, to be filled by [`load`](Self::load): it has no actions and no channels.
    // Not `const`: a constant would lie in flash, to be copied from there.
    pub fn empty() -> Self {
        Self {
            manifest: Manifest::empty(),
            names: &[],
            frequencies: &[],
            time_table: &[],
            sampler: Sampler::empty(),
            layers: heapless::Vec::new(),
            servos: ServoRecords::default(),
            time_products_max: 0,
        }
    }

    /// Checks a blob completely.
    ///
    /// # Errors
    /// A [`BlobError`] that names what is wrong; see its variants for what to do.
    ///
    /// # Cost
    /// Reads every byte about twice: CRC-32, then the accumulator certificate of each row.
    pub fn from_bytes(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let mut model = Self::empty();
        model.load(bytes)?;
        Ok(model)
    }

    /// [`from_bytes`](Self::from_bytes) into a model that lies where it is needed, [`empty`](Self::empty) before: half
    /// of the stack, because nothing has to be moved. After an error the model is empty.
    ///
    /// # Errors
    /// As [`from_bytes`](Self::from_bytes).
    pub fn load(&mut self, bytes: &'a [u8]) -> Result<(), BlobError> {
        self.clear();
        let result = self.fill(bytes);
        if result.is_err() {
            self.clear();
        }
        result
    }

    /// Whatever is left over, nobody can reach it.
    #[inline(never)]
    fn clear(&mut self) {
        self.layers.clear();
        self.sampler.action_count = 0;
        self.manifest.layers.clear();
        self.manifest.group_count = 0;
        self.manifest.action_count = 0;
        self.manifest.joint_count = 0;
        self.servos = ServoRecords::default();
    }

    #[inline(never)]
    fn fill(&mut self, bytes: &'a [u8]) -> Result<(), BlobError> {
        let envelope = Envelope::parse(bytes)?;
        self.read_manifest(envelope.descriptions)?;
        manifest_check::check(&self.manifest, bytes)?;
        self.slice_tensors(&envelope)?;
        self.check_names()?;
        self.sampler.check()?;
        for index in 0..self.manifest.layers.len() {
            let Some(layer) = self.layer(index) else { continue };
            let products_max = layer.check(&self.manifest, index)?;
            if index == TIME_LAYER {
                self.time_products_max = products_max;
            }
        }
        self.check_time_table()?;
        self.servos = ServoRecords::load(envelope.servos, self.channel_count())?;
        Ok(())
    }

    fn read_manifest(&mut self, descriptions: &'a [u8]) -> Result<(), BlobError> {
        let mut reader = Reader::new(descriptions);
        reader.manifest(&mut self.manifest);
        self.names = reader.rest();
        if reader.is_broken() {
            return Err(BlobError::BadField { field: "manifest", value: 0 });
        }
        Ok(())
    }

    /// Stored products must not reach beyond what the time half's own could: its room was measured by those.
    fn check_time_table(&self) -> Result<(), BlobError> {
        let shift = self.manifest.time_table_shift & 15;
        let products_max = self.time_products_max >> shift;
        let too_large = |entry: i16| i32::from(entry).abs() > products_max;
        match i16s(self.time_table).position(too_large) {
            Some(index) => Err(BlobError::BadField { field: "time table", value: index as u32 }),
            None => Ok(()),
        }
    }

    /// Cuts the blob into tensors by the manifest's plan; the plan must end exactly where the blob ends.
    fn slice_tensors(&mut self, envelope: &Envelope<'a>) -> Result<(), BlobError> {
        let found = envelope.bytes.len();
        let wrong_length = |end: u64| {
            let expected = usize::try_from(end).unwrap_or(usize::MAX);
            Err(BlobError::WrongLength { found, expected })
        };
        self.sampler = Sampler::new(&self.manifest);
        let mut end = envelope.tensors_start();
        for (kind, length) in tensor_plan(&self.manifest) {
            let start = aligned(end);
            end = start + length;
            if end > found as u64 {
                return wrong_length(end);
            }
            let tensor = envelope.bytes.get(start as usize..end as usize).unwrap_or_default();
            match kind {
                TensorKind::Frequencies => self.frequencies = tensor,
                TensorKind::TimeTable => self.time_table = tensor,
                TensorKind::Weights(_) => {
                    // As many fit as the manifest can name.
                    let _ =
                        self.layers.push(envelope.bytes.get(start as usize..).unwrap_or_default());
                }
                TensorKind::GroupScales(_) | TensorKind::Bias(_) | TensorKind::Scales(_) => {}
                _ => self.sampler.set_tensor(kind, tensor),
            }
        }
        if end == found as u64 { Ok(()) } else { wrong_length(end) }
    }

    /// Walks all names once, so that the iterators below cannot meet a broken one later.
    fn check_names(&self) -> Result<(), BlobError> {
        let bad = |field, value: usize| Err(BlobError::BadField { field, value: value as u32 });
        let mut names = Reader::new(self.names);
        let mut channels = 0;
        for index in 0..self.manifest.group_count {
            channels += names.group().kind.channel_count();
            if names.is_broken() {
                return bad("groups", index.into());
            }
        }
        if channels != self.channel_count() {
            return bad("channels of the layout", channels);
        }
        for index in 0..self.manifest.action_count {
            names.text();
            if names.is_broken() {
                return bad("actions", index.into());
            }
        }
        self.check_joints(&mut names)?;
        if names.rest().is_empty() {
            return Ok(());
        }
        bad("bytes after the names", names.rest().len())
    }

    /// Parents must precede their children; only the first joint has none.
    fn check_joints(&self, names: &mut Reader<'a>) -> Result<(), BlobError> {
        let bad = |field, value| Err(BlobError::BadField { field, value });
        let mut misplaced = None;
        for index in 0..self.manifest.joint_count {
            let joint = names.joint();
            if names.is_broken() {
                return bad("joints", index.into());
            }
            let is_misplaced = joint.parent.map_or(index != 0, |parent| parent >= index);
            if is_misplaced && misplaced.is_none() {
                misplaced = Some(index);
            }
        }
        match misplaced {
            Some(index) => bad("joint parent", index.into()),
            None => Ok(()),
        }
    }

    /// Groups of the layout, in channel order.
    pub fn groups(&self) -> impl Iterator<Item = Group<'a>> + use<'a> {
        let mut names = Reader::new(self.names);
        (0..self.manifest.group_count).map(move |_| names.group())
    }

    /// Names of the actions, in the order of [`ActionId`].
    pub fn actions(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let mut names = self.names_after_groups();
        (0..self.manifest.action_count).map(move |_| names.text())
    }

    /// Joints of the skeleton; none when the model has no skeleton.
    pub fn joints(&self) -> impl Iterator<Item = Joint<'a>> + use<'a> {
        let mut names = self.names_after_groups();
        (0..self.manifest.action_count).for_each(|_| _ = names.text());
        (0..self.manifest.joint_count).map(move |_| names.joint())
    }

    fn names_after_groups(&self) -> Reader<'a> {
        let mut names = Reader::new(self.names);
        (0..self.manifest.group_count).for_each(|_| _ = names.group());
        names
    }

    /// The action with this name.
    pub fn action_by_name(&self, name: &str) -> Option<ActionId> {
        let index = self.actions().position(|action| action == name)?;
        u16::try_from(index).ok().map(ActionId)
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
        let order_suits = |index| {
            matches!(Order::of(&self.manifest, index), Some(Order::Bytes | Order::Halfwords))
        };
        (0..self.layers.len()).all(order_suits)
    }

    /// A layer, counted as in [`Manifest::layers`].
    #[inline(never)]
    pub(crate) fn layer(&self, index: usize) -> Option<Layer<'_>> {
        Layer::new(&self.manifest, index, self.layers.get(index)?)
    }

    /// How the activations that a layer reads are stored.
    pub(crate) fn inputs(&self, index: usize) -> Option<Inputs> {
        let quads = self.manifest.layers.get(index)?.columns_filled() / 4;
        Some(Inputs { order: Order::of(&self.manifest, index)?, quads })
    }

    /// Largest magnitude at which a sum of the time half can start without ever overflowing.
    pub(crate) fn time_room(&self) -> i32 {
        i32::MAX - self.time_products_max
    }

    /// Multiply-accumulates to begin a motion (the code half of layer 1, and the gates).
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
    fn model_is_empty_after_a_blob_that_was_rejected() {
        let good = w8a16();
        let mut bad = good.clone();
        *bad.last_mut().unwrap() ^= 1;
        let mut unchecked = good.clone();
        unchecked[HEADER_BYTES + 9] ^= 0xFF;
        crate::blob::seal_again(&mut unchecked);
        let mut model = Model::empty();
        for blob in [&bad, &unchecked] {
            assert!(model.load(&good).is_ok());
            assert!(model.load(blob).is_err());
            assert!(model.sample(ActionId(0), 20, &mut || 0).is_err());
            assert_eq!((model.actions().count(), model.channel_count()), (0, 0));
            let mut workspace = crate::Workspace::<16>::new();
            let mut pose = crate::Pose::new();
            if let Ok(mut decoder) = crate::Decoder::new(&model, &mut workspace) {
                decoder.start(&crate::Code::new());
                decoder.decode(crate::FramePosition::from_bits(0), &mut pose);
            }
            assert!(pose.channels().is_empty());
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
