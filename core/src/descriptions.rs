//! The descriptions of a blob, read back field by field.
//!
//! In:  postcard bytes, through `blob.rs`.
//! Out: the manifest, groups, names and joints to `model.rs`.
//!
//! Why here: `serde` writes the descriptions on the host. Its reader would cost a device 5 KB, for a dozen kinds of
//! field; this one is a tenth of that and fills the manifest where it lies.
//! Source: postcard wire format 1.0.

use crate::manifest::{
    ActivationScale, Group, Joint, LayerShape, Manifest, NumberFormat, Packing, SamplerKind,
    SamplerShape, WeightFormat,
};
use crate::pose_layout::{GroupKind, Unit};

/// Bytes of the longest number.
const VARINT_BYTES_MAX: usize = 10;

/// Reads values one after another. A value that is broken, and every one after it, is zero or empty: who reads asks
/// [`is_broken`](Self::is_broken) at the end.
#[derive(Clone, Debug)]
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    is_broken: bool,
}

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, is_broken: false }
    }

    pub fn is_broken(&self) -> bool {
        self.is_broken
    }

    /// What has not been read.
    pub fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    fn fail(&mut self) {
        *self = Self { bytes: &[], is_broken: true };
    }

    #[inline(never)]
    fn take(&mut self, length: usize) -> &'a [u8] {
        let Some((taken, rest)) = self.bytes.split_at_checked(length) else {
            self.fail();
            return &[];
        };
        self.bytes = rest;
        taken
    }

    fn byte(&mut self) -> u8 {
        self.take(1).first().copied().unwrap_or(0)
    }

    /// Seven bits a byte, the lowest first; the highest bit says that another byte follows.
    #[inline(never)]
    pub fn varint(&mut self) -> u64 {
        let length = self.bytes.iter().position(|&byte| byte < 0x80).unwrap_or(VARINT_BYTES_MAX);
        if length >= VARINT_BYTES_MAX {
            self.fail();
        }
        let bytes = self.take((length + 1).min(self.bytes.len())).iter();
        bytes.rev().fold(0, |value, &byte| value << 7 | u64::from(byte & 0x7F))
    }

    #[inline(never)]
    pub fn u32(&mut self) -> u32 {
        u32::try_from(self.varint()).unwrap_or_else(|_| {
            self.fail();
            0
        })
    }

    #[inline(never)]
    pub fn u16(&mut self) -> u16 {
        u16::try_from(self.u32()).unwrap_or_else(|_| {
            self.fail();
            0
        })
    }

    fn i16(&mut self) -> i16 {
        let zigzag = self.u16();
        (zigzag >> 1).cast_signed() ^ (zigzag & 1).cast_signed().wrapping_neg()
    }

    /// Which of `count` variants, 0 where it is none.
    #[inline(never)]
    pub fn variant(&mut self, count: u16) -> u16 {
        let index = self.u16();
        if index < count {
            return index;
        }
        self.fail();
        0
    }

    /// Bytes, their number first.
    pub fn bytes(&mut self) -> &'a [u8] {
        let length = self.u32() as usize;
        self.take(length)
    }

    /// A name.
    #[inline(never)]
    pub fn text(&mut self) -> &'a str {
        core::str::from_utf8(self.bytes()).unwrap_or_else(|_| {
            self.fail();
            ""
        })
    }

    /// One group of channels.
    #[inline(never)]
    pub fn group(&mut self) -> Group<'a> {
        let name = self.text();
        let kind = match self.variant(4) {
            0 => GroupKind::Scalar,
            1 => GroupKind::Rotation6d,
            2 => GroupKind::Translation,
            _ => GroupKind::Position,
        };
        let unit = match self.variant(7) {
            0 => Unit::One,
            1 => Unit::Radian,
            2 => Unit::Degree,
            3 => Unit::Metre,
            4 => Unit::Centimetre,
            5 => Unit::Millimetre,
            _ => Unit::Microsecond,
        };
        Group { name, kind, unit }
    }

    /// One joint of the skeleton.
    pub fn joint(&mut self) -> Joint<'a> {
        let name = self.text();
        let parent = if self.variant(2) == 0 { None } else { Some(self.u16()) };
        let mut coordinate = || {
            let bits = self.take(4).first_chunk().copied().unwrap_or_default();
            f32::from_le_bytes(bits)
        };
        Joint { name, parent, offset: [coordinate(), coordinate(), coordinate()] }
    }

    /// Fills in a manifest that is [`Manifest::empty`].
    pub fn manifest(&mut self, manifest: &mut Manifest<'a>) {
        manifest.name = self.text();
        manifest.number_format = self.number_format();
        manifest.packing = if self.variant(2) == 0 { Packing::Rows } else { Packing::Tiles };
        manifest.rate_millihz = self.u32();
        manifest.group_count = self.u16();
        manifest.action_count = self.u16();
        manifest.joint_count = self.u16();
        manifest.sequence_code_count = self.u16();
        manifest.action_code_count = self.u16();
        manifest.code_fraction_bits = self.byte();
        manifest.frequency_count = self.u16();
        for _ in 0..self.u32() {
            let shape = self.layer();
            if self.is_broken || manifest.layers.push(shape).is_err() {
                return self.fail();
            }
        }
        manifest.sampler = self.sampler();
        manifest.time_table_frames = self.u16();
        manifest.time_table_shift = self.byte();
        manifest.provenance.config_hash.iter_mut().for_each(|byte| *byte = self.byte());
        manifest.provenance.seed = self.varint();
    }

    fn number_format(&mut self) -> NumberFormat {
        match self.variant(4) {
            0 => NumberFormat::W8A16,
            1 => NumberFormat::W8A8,
            2 => NumberFormat::W4A8,
            _ => NumberFormat::F16,
        }
    }

    fn layer(&mut self) -> LayerShape {
        LayerShape {
            input_count: self.u16(),
            output_count: self.u16(),
            weights: match self.variant(3) {
                0 => WeightFormat::I8,
                1 => WeightFormat::I4,
                _ => WeightFormat::Half,
            },
            activation: ActivationScale {
                power_step: self.u32(),
                one: self.u16(),
                one_shift: self.byte(),
                zero_point: self.i16(),
                fraction_bits: self.byte(),
            },
        }
    }

    fn sampler(&mut self) -> SamplerShape {
        let kind = match self.variant(3) {
            0 => SamplerKind::ClipCodes,
            1 => SamplerKind::DiagonalMixture,
            _ => SamplerKind::NearestClips { clip_count: self.u16(), row_bytes: self.u16() },
        };
        SamplerShape {
            kind,
            component_count: self.u32(),
            member_count: self.u32(),
            interval_count: self.u16(),
            step_max_q16: self.u32(),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::blob::HEADER_BYTES;
    use crate::specimen::{KINDS, specimen};

    #[test]
    fn number_that_never_ends_is_broken() {
        let mut reader = Reader::new(&[0xFF; 30]);
        assert_eq!((reader.varint(), reader.is_broken()), (0, true));
    }

    #[test]
    fn value_after_a_broken_one_is_zero() {
        let mut reader = Reader::new(&[9, b'a', 1, 1]);
        assert_eq!((reader.text(), reader.u16(), reader.byte()), ("", 0, 0));
        assert!(reader.is_broken());
    }

    #[test]
    fn manifest_is_what_was_written() {
        for (format, kind) in NumberFormat::ALL.into_iter().zip(KINDS.into_iter().cycle()) {
            let blob = specimen(format, kind);
            let mut reader = Reader::new(&blob[HEADER_BYTES..]);
            let mut manifest = Manifest::empty();
            reader.manifest(&mut manifest);
            let mut buffer = [0; 1024];
            let written = postcard::to_slice(&manifest, &mut buffer).unwrap();
            assert!(!reader.is_broken() && blob[HEADER_BYTES..].starts_with(written));
        }
    }

    proptest! {
        #[test]
        fn numbers_are_what_was_written(small: u16, signed: i16, large: u32, huge: u64) {
            let mut buffer = [0; 64];
            let values = (small, signed, large, huge);
            let mut reader = Reader::new(postcard::to_slice(&values, &mut buffer).unwrap());
            let read = (reader.u16(), reader.i16(), reader.u32(), reader.varint());
            prop_assert_eq!(read, (small, signed, large, huge));
            prop_assert!(!reader.is_broken() && reader.rest().is_empty());
        }
    }
}
