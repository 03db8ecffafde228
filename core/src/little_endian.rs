//! Numbers read in place from flash, at any alignment of the blob.
//!
//! Why here: a slice from `include_bytes!` may start anywhere; LDM and LDRD fault on odd addresses, byte reads do not.

/// The `i16`s of a tensor.
pub(crate) fn i16s(bytes: &[u8]) -> impl ExactSizeIterator<Item = i16> + '_ {
    bytes.chunks_exact(2).map(|pair| match *pair {
        [low, high] => i16::from_le_bytes([low, high]),
        _ => 0,
    })
}

/// The `u16`s of a tensor.
pub(crate) fn u16s(bytes: &[u8]) -> impl ExactSizeIterator<Item = u16> + '_ {
    i16s(bytes).map(i16::cast_unsigned)
}

/// The `i32`s of a tensor.
pub(crate) fn i32s(bytes: &[u8]) -> impl ExactSizeIterator<Item = i32> + '_ {
    bytes.chunks_exact(4).map(|quad| match *quad {
        [a, b, c, d] => i32::from_le_bytes([a, b, c, d]),
        _ => 0,
    })
}

/// The `u32`s of a tensor.
pub(crate) fn u32s(bytes: &[u8]) -> impl ExactSizeIterator<Item = u32> + '_ {
    i32s(bytes).map(i32::cast_unsigned)
}

/// The `i8`s of a tensor.
pub(crate) fn i8s(bytes: &[u8]) -> impl ExactSizeIterator<Item = i8> + '_ {
    bytes.iter().map(|&byte| byte.cast_signed())
}
