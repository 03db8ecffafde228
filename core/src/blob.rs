//! Station 6: the bytes that cross from host to device, in both directions.
//!
//! ```text
//! 0   magic "KRKR"         4   format version u16   6   header length u16 (32)
//! 8   length of all u32    12  CRC-32 u32 of everything but these four bytes
//! 16  length of the descriptions u32
//! 20  version 3: length of the servos u32           24  zeros up to 32
//! 32  descriptions: postcard of Manifest, then every Group, action name and Joint
//! …   tensors in the order of `tensor_plan`, each at a multiple of 16 from the start, little-endian
//! …   servos, see `servo_records.rs`
//! ```
//!
//! Why here: offsets exist in this file only; writer and reader share `tensor_plan`.
//! Source: postcard wire format 1.0; CRC-32 of IEEE 802.3.

use crate::crc32::crc32;
use crate::error::BlobError;
use crate::manifest::{Group, Joint, Manifest, TensorKind, tensor_plan};

/// First four bytes.
pub const MAGIC: [u8; 4] = *b"KRKR";
/// Newest format that this crate writes and reads; blobs without servos are written in the one before, which is the
/// same.
pub const VERSION: u16 = 3;
const VERSION_WITHOUT_SERVOS: u16 = 2;
/// Oldest format that this crate reads: version 1 knew one order of weights, which no kernel of today reads.
pub const VERSION_OLDEST: u16 = 2;
/// Bytes of the header.
pub const HEADER_BYTES: usize = 32;
/// Tensors start at multiples of this many bytes.
pub const ALIGNMENT: usize = 16;

mod field {
    use core::ops::Range;
    pub const MAGIC: Range<usize> = 0..4;
    pub const VERSION: Range<usize> = 4..6;
    pub const HEADER_LENGTH: Range<usize> = 6..8;
    pub const LENGTH: Range<usize> = 8..12;
    pub const CRC: Range<usize> = 12..16;
    pub const DESCRIPTIONS_LENGTH: Range<usize> = 16..20;
    pub const SERVOS_LENGTH: Range<usize> = 20..24;
    pub const RESERVED: Range<usize> = 24..32;
}

/// The checked outside of a blob: header and descriptions, tensors still in one piece.
pub(crate) struct Envelope<'a> {
    /// Postcard stream.
    pub descriptions: &'a [u8],
    /// Everything up to the servos, header included: tensor offsets count from the start.
    pub bytes: &'a [u8],
    /// See `servo_records.rs`.
    pub servos: &'a [u8],
}

impl<'a> Envelope<'a> {
    /// Checks length, magic, version and checksum, in the order in which a user can act on them.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let too_short = BlobError::WrongLength { found: bytes.len(), expected: HEADER_BYTES };
        if bytes.get(field::MAGIC).ok_or(too_short)? != MAGIC {
            return Err(BlobError::WrongMagic);
        }
        let version = u16_at(bytes, field::VERSION).ok_or(too_short)?;
        if version > VERSION {
            return Err(BlobError::NewerVersion { found: version, newest: VERSION });
        }
        if version < VERSION_OLDEST {
            return Err(BlobError::OlderVersion { found: version, oldest: VERSION_OLDEST });
        }
        let length = u32_at(bytes, field::LENGTH).ok_or(too_short)?;
        if bytes.len() != length as usize || bytes.len() < HEADER_BYTES {
            let expected = (length as usize).max(HEADER_BYTES);
            return Err(BlobError::WrongLength { found: bytes.len(), expected });
        }
        let stored = u32_at(bytes, field::CRC).ok_or(too_short)?;
        let computed = checksum(bytes);
        if stored != computed {
            return Err(BlobError::WrongChecksum { stored, computed });
        }
        Self::parse_checked(bytes, version)
    }

    fn parse_checked(bytes: &'a [u8], version: u16) -> Result<Self, BlobError> {
        let bad = |field, value| BlobError::BadField { field, value };
        let header_length = u16_at(bytes, field::HEADER_LENGTH).unwrap_or(0);
        if usize::from(header_length) != HEADER_BYTES {
            return Err(bad("header length", u32::from(header_length)));
        }
        if bytes.get(field::RESERVED).is_none_or(|reserved| reserved.iter().any(|&byte| byte != 0))
        {
            return Err(bad("reserved header bytes", 0));
        }
        let servos_length = u32_at(bytes, field::SERVOS_LENGTH).unwrap_or(u32::MAX);
        match (version, servos_length) {
            (VERSION_WITHOUT_SERVOS, 0) => {}
            (VERSION_WITHOUT_SERVOS, _) => return Err(bad("reserved header bytes", 0)),
            (_, 0) => return Err(bad("bytes of servos", 0)),
            _ => {}
        }
        let (bytes, servos) = bytes
            .len()
            .checked_sub(servos_length as usize)
            .and_then(|end| bytes.split_at_checked(end))
            .ok_or(bad("bytes of servos", servos_length))?;
        let length = u32_at(bytes, field::DESCRIPTIONS_LENGTH).unwrap_or(u32::MAX);
        let descriptions = bytes
            .get(HEADER_BYTES..)
            .and_then(|rest| rest.get(..length as usize))
            .ok_or(bad("descriptions length", length))?;
        Ok(Self { descriptions, bytes, servos })
    }

    /// Offset of the first tensor.
    pub fn tensors_start(&self) -> u64 {
        aligned((HEADER_BYTES + self.descriptions.len()) as u64)
    }
}

/// The next multiple of [`ALIGNMENT`].
pub(crate) const fn aligned(offset: u64) -> u64 {
    offset.next_multiple_of(ALIGNMENT as u64)
}

fn checksum(bytes: &[u8]) -> u32 {
    let before = bytes.get(..field::CRC.start).unwrap_or_default();
    let after = bytes.get(field::CRC.end..).unwrap_or_default();
    crc32([before, after])
}

/// The checksum that a blob states about itself: names exactly this blob in what is made from it. `None` where the
/// bytes end before it.
pub fn stored_crc(bytes: &[u8]) -> Option<u32> {
    u32_at(bytes, field::CRC)
}

fn u16_at(bytes: &[u8], range: core::ops::Range<usize>) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(range)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], range: core::ops::Range<usize>) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(range)?.try_into().ok()?))
}

/// Everything that a blob is made of, for [`emit`](Self::emit).
#[derive(Clone, Copy, Debug)]
pub struct BlobParts<'a> {
    /// Its counts must equal the lengths of the slices below.
    pub manifest: &'a Manifest<'a>,
    /// The layout.
    pub groups: &'a [Group<'a>],
    /// Names of the actions.
    pub actions: &'a [&'a str],
    /// The skeleton, may be empty.
    pub joints: &'a [Joint<'a>],
    /// Little-endian bytes of every tensor that [`tensor_plan`] gives a length; order does not matter.
    pub tensors: &'a [(TensorKind, &'a [u8])],
}

impl BlobParts<'_> {
    /// Writes the blob to the front of `output` and returns its length in bytes.
    ///
    /// # Errors
    /// * [`BlobError::WrongLength`] when `output` is too small.
    /// * [`BlobError::BadField`] when a tensor is missing or not as long as planned.
    ///
    /// The result still has to pass `Model::from_bytes`, which checks everything else.
    pub fn emit(&self, output: &mut [u8]) -> Result<usize, BlobError> {
        let space = output.len();
        let descriptions_end =
            self.emit_descriptions(output).ok_or(too_small(space, HEADER_BYTES))?;
        let mut end = descriptions_end;
        for (kind, length) in tensor_plan(self.manifest) {
            let start = aligned(end as u64) as usize;
            let tensor = self.tensor(kind, length)?;
            let needed = start + tensor.len();
            let gap = output.get_mut(end..needed).ok_or(too_small(space, needed))?;
            gap.fill(0);
            if let Some(place) = gap.get_mut(start - end..) {
                place.copy_from_slice(tensor);
            }
            end = needed;
        }
        let end = self.seal(output, descriptions_end, end);
        end.ok_or(too_small(space, HEADER_BYTES))
    }

    fn tensor(&self, kind: TensorKind, length: u64) -> Result<&[u8], BlobError> {
        let tensor =
            self.tensors.iter().find(|(found, _)| *found == kind).map_or(&[][..], |found| found.1);
        if tensor.len() as u64 == length {
            return Ok(tensor);
        }
        Err(BlobError::BadField { field: kind.part(), value: tensor.len() as u32 })
    }

    fn emit_descriptions(&self, output: &mut [u8]) -> Option<usize> {
        let mut end = HEADER_BYTES;
        end += postcard::to_slice(self.manifest, output.get_mut(end..)?).ok()?.len();
        for group in self.groups {
            end += postcard::to_slice(group, output.get_mut(end..)?).ok()?.len();
        }
        for action in self.actions {
            end += postcard::to_slice(action, output.get_mut(end..)?).ok()?.len();
        }
        for joint in self.joints {
            end += postcard::to_slice(joint, output.get_mut(end..)?).ok()?.len();
        }
        Some(end)
    }

    fn seal(&self, output: &mut [u8], descriptions_end: usize, end: usize) -> Option<usize> {
        let blob = output.get_mut(..end)?;
        let descriptions_length = (descriptions_end - HEADER_BYTES) as u32;
        blob.get_mut(field::MAGIC)?.copy_from_slice(&MAGIC);
        blob.get_mut(field::VERSION)?.copy_from_slice(&VERSION_WITHOUT_SERVOS.to_le_bytes());
        blob.get_mut(field::HEADER_LENGTH)?.copy_from_slice(&(HEADER_BYTES as u16).to_le_bytes());
        blob.get_mut(field::DESCRIPTIONS_LENGTH)?
            .copy_from_slice(&descriptions_length.to_le_bytes());
        blob.get_mut(field::SERVOS_LENGTH)?.fill(0);
        blob.get_mut(field::RESERVED)?.fill(0);
        seal(blob)?;
        Some(end)
    }
}

/// Writes length and checksum.
fn seal(blob: &mut [u8]) -> Option<()> {
    let length = blob.len() as u32;
    blob.get_mut(field::LENGTH)?.copy_from_slice(&length.to_le_bytes());
    let crc = checksum(blob);
    blob.get_mut(field::CRC)?.copy_from_slice(&crc.to_le_bytes());
    Some(())
}

/// Makes a blob whose last bytes have become its servos one of version 3.
pub(crate) fn seal_with_servos(blob: &mut [u8], servos_bytes: usize) -> Option<()> {
    blob.get_mut(field::VERSION)?.copy_from_slice(&VERSION.to_le_bytes());
    blob.get_mut(field::SERVOS_LENGTH)?.copy_from_slice(&(servos_bytes as u32).to_le_bytes());
    seal(blob)
}

fn too_small(found: usize, expected: usize) -> BlobError {
    BlobError::WrongLength { found, expected }
}

/// Makes a damaged blob's checksum fit, so that tests reach what lies behind it.
#[cfg(test)]
pub(crate) fn seal_again(blob: &mut [u8]) {
    let crc = checksum(blob);
    blob[field::CRC].copy_from_slice(&crc.to_le_bytes());
}
