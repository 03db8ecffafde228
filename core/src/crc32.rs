//! CRC-32 of the blob and of frames of the link (IEEE 802.3, reflected, as in zip and PNG).
//!
//! Why here: a nibble table of 64 bytes costs two look-ups a byte; the usual 1 KiB table is not worth the flash for
//! a check that runs once at start.

const POLYNOMIAL: u32 = 0xEDB8_8320;

#[allow(clippy::indexing_slicing, reason = "the compiler evaluates it")]
const TABLE: [u32; 16] = {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut value = nibble as u32;
        let mut bit = 0;
        while bit < 4 {
            value = if value & 1 == 1 { (value >> 1) ^ POLYNOMIAL } else { value >> 1 };
            bit += 1;
        }
        table[nibble] = value;
        nibble += 1;
    }
    table
};

/// CRC-32 of the concatenation of `parts`.
pub(crate) fn crc32<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> u32 {
    let mut crc = Crc32::new();
    for part in parts {
        for &byte in part {
            crc.update(byte);
        }
    }
    crc.value()
}

/// CRC-32 of bytes that come one by one.
#[derive(Clone, Debug)]
pub(crate) struct Crc32(u32);

impl Crc32 {
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    pub fn update(&mut self, byte: u8) {
        self.0 = nibble(nibble(self.0 ^ u32::from(byte)));
    }

    pub const fn value(&self) -> u32 {
        !self.0
    }
}

fn nibble(crc: u32) -> u32 {
    let entry = TABLE.get((crc & 15) as usize).copied().unwrap_or(0);
    (crc >> 4) ^ entry
}

#[cfg(test)]
mod tests {
    use super::crc32;

    #[test]
    fn crc_of_the_check_string_is_the_standard_value() {
        assert_eq!(crc32([b"1234".as_slice(), b"56789"]), 0xCBF4_3926);
    }

    #[test]
    fn crc_of_nothing_is_zero() {
        assert_eq!(crc32([]), 0);
    }
}
