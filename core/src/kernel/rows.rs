//! Kernels for weights that lie row after row: safe Rust in the shape that LLVM turns into vector instructions.
//!
//! Why here: Armv8.1-M's VMLADAVA and the SIMD of hosts sum along a row, and need no packing.

/// `sums[r] += Σ w[r][c] · x[c]` over four rows of i8 weights.
///
/// # Shapes
/// `rows` (4, columns) · `activations` (columns)
pub fn w8a16(rows: &[u8], activations: &[i16], sums: &mut [i32; 4]) {
    for (row, sum) in rows.chunks_exact((rows.len() / 4).max(1)).zip(sums) {
        let products = row.iter().zip(activations);
        *sum = products
            .map(|(&w, &x)| i32::from(w.cast_signed()) * i32::from(x))
            .fold(*sum, i32::wrapping_add);
    }
}

/// `sums[r] += 256 · Σ w[r][c] · x[c]` over four rows of i8 weights: the scale of the packed `w8a8`.
///
/// # Shapes
/// `rows` (4, columns) · `activations` (columns)
pub fn w8a8(rows: &[u8], activations: &[i8], sums: &mut [i32; 4]) {
    for (row, sum) in rows.chunks_exact((rows.len() / 4).max(1)).zip(sums) {
        let products = row.iter().zip(activations);
        let dot = products
            .map(|(&w, &x)| i32::from(w.cast_signed()) * i32::from(x))
            .fold(0, i32::wrapping_add);
        *sum = sum.wrapping_add(dot << 8);
    }
}
