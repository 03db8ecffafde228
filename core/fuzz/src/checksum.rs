//! The blob's checksum, for whoever changes bytes behind it: the fuzz targets and the tests of hostile blobs.

use std::ops::Range;

/// Where the checksum is.
pub const CHECKSUM_FIELD: Range<usize> = 12..16;

/// CRC-32 of IEEE 802.3, written anew so that a mistake in `core` is no mistake here.
fn crc32(bytes: impl Iterator<Item = u8>) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut index = 0;
        while index < table.len() {
            let (mut value, mut bit) = (index as u32, 0);
            while bit < 8 {
                value = if value & 1 == 1 { value >> 1 ^ 0xedb8_8320 } else { value >> 1 };
                bit += 1;
            }
            table[index] = value;
            index += 1;
        }
        table
    };
    !bytes.fold(u32::MAX, |crc, byte| crc >> 8 ^ TABLE[usize::from(crc as u8 ^ byte)])
}

/// Makes the checksum fit, as a forger would, so that loading reaches what lies behind it.
pub fn seal(blob: &mut [u8]) {
    let (before, after) = (&blob[..CHECKSUM_FIELD.start], &blob[CHECKSUM_FIELD.end..]);
    let crc = crc32(before.iter().chain(after).copied());
    blob[CHECKSUM_FIELD].copy_from_slice(&crc.to_le_bytes());
}
