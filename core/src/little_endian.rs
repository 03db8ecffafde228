//! Numbers read in place from flash, at any alignment of the blob.
//!
//! Why here: a slice from `include_bytes!` may start anywhere; LDM and LDRD fault on odd addresses, byte reads do not.
//! `as_chunks` and not `chunks_exact`: the latter keeps its size in a variable and may divide by it, with a panic for
//! 0.

/// The `i16`s of a tensor.
pub(crate) fn i16s(bytes: &[u8]) -> impl ExactSizeIterator<Item = i16> + '_ {
    bytes.as_chunks().0.iter().map(|&pair| i16::from_le_bytes(pair))
}

/// The `u16`s of a tensor.
pub(crate) fn u16s(bytes: &[u8]) -> impl ExactSizeIterator<Item = u16> + '_ {
    i16s(bytes).map(i16::cast_unsigned)
}

/// The `i32`s of a tensor.
pub(crate) fn i32s(bytes: &[u8]) -> impl ExactSizeIterator<Item = i32> + '_ {
    bytes.as_chunks().0.iter().map(|&quad| i32::from_le_bytes(quad))
}

/// The `u32`s of a tensor.
pub(crate) fn u32s(bytes: &[u8]) -> impl ExactSizeIterator<Item = u32> + '_ {
    i32s(bytes).map(i32::cast_unsigned)
}
