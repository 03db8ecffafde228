//! The direction of a vector, and the inverse square root that it takes.
//!
//! In:  vectors of i32, any scale (from `rotation.rs` and `arc_tangent.rs`).
//! Out: the same direction with length 1, Q1.15.
//!
//! Why here: lengths are only ever divided by, so the crate's one root is the inverse root: a table
//! with linear interpolation, no division, which an M0+ does not have. Every product fits 32 bits,
//! because an M0+ takes some twenty instructions for one that does not.
//! Source: none; a table instead of Newton's method, which needs a wider product for 16 bits.

/// Fraction bits of a unit vector.
pub(crate) const UNIT_FRACTION_BITS: u32 = 15;

/// Table steps in 1..4.
const STEPS: usize = 192;

/// `1/√x` at `x = 1 + i/64` in Q0.16, less 1 so that it fits; but for the first, which axes need
/// exact, lowered by half the greatest error of the chord that begins there: chords then err as
/// far up as down.
#[allow(clippy::indexing_slicing, reason = "the compiler evaluates it")]
const INVERSE_ROOT_LESS_1: [u16; STEPS + 1] = {
    let mut table = [u16::MAX; STEPS + 1];
    let mut index = 1;
    while index <= STEPS {
        let x = 1.0 + index as f64 / 64.0;
        let exact = 1.0 / square_root(x);
        let curvature = 0.75 * exact / (x * x);
        let centred = exact - curvature / (16.0 * 64.0 * 64.0);
        table[index] = (centred * 65_536.0 - 0.5) as u16;
        index += 1;
    }
    table
};

/// Newton's method, exact to 1e-16 for 1..=4; only ever evaluated by the compiler.
const fn square_root(x: f64) -> f64 {
    let (mut root, mut step) = (x, 0);
    while step < 8 {
        root = 0.5 * (root + x / root);
        step += 1;
    }
    root
}

/// `1/√x` in Q0.16 for x in Q2.30, at least 1 (2^30; less is taken for 1).
///
/// # Accuracy
/// Relative to f64: 3.1e-5 max, 1e-5 RMS (asserted by `inverse_square_root_error`).
fn inverse_square_root_q16(x_q30: u32) -> u32 {
    let index = (x_q30 >> 24).saturating_sub(64) as usize;
    let fraction_q15 = (x_q30 >> 9) & 0x7FFF;
    let low = u32::from(INVERSE_ROOT_LESS_1.get(index).copied().unwrap_or(0));
    let high = u32::from(INVERSE_ROOT_LESS_1.get(index + 1).copied().unwrap_or(0));
    // The root falls: `low` is the greater one, by less than 2^9. Adds the 1 and rounds.
    ((low << 15) + (3 << 14)).wrapping_sub(low.wrapping_sub(high).wrapping_mul(fraction_q15)) >> 15
}

/// The vector at 15 bits and sign: its largest element becomes 2^14..2^15 in magnitude (or −2^15),
/// rounded to nearest; zeros stay zeros.
pub(crate) fn mantissas<const N: usize>(vector: [i32; N]) -> [i32; N] {
    // The ones' complement has no magnitude that does not fit.
    let largest = vector.iter().fold(0, |bits, &element| bits | (element ^ (element >> 31)));
    let shift = largest.leading_zeros() - 1;
    vector.map(|element| ((((element << shift) >> 15) + 1) >> 1).min(32_767))
}

/// `vector / |vector|` in Q1.15, or `None` for the zero vector.
///
/// # Accuracy
/// Any vector but zero, against f64: its direction is off by 6.6e-5 rad (0.004°) max, 1.7e-5 RMS;
/// its length by 5.2e-5 max, 1.4e-5 RMS (asserted by `unit_vector_error_at_every_scale`). Axes are exact.
pub(crate) fn unit_q15<const N: usize>(vector: [i32; N]) -> Option<[i32; N]> {
    let mantissas = mantissas(vector);
    let square = mantissas.iter().fold(0u32, |sum, &m| sum.wrapping_add((m * m) as u32));
    if square == 0 {
        return None;
    }
    // The square lies in 2^28..=N · 2^30: at most one shift by two bits brings it to 2^30.. .
    let pairs = square.leading_zeros() / 2;
    let inverse_q16 = inverse_square_root_q16(square << (2 * pairs)) as i32;
    // Within −2^31..2^31, and with its rounding only after the first shift.
    Some(mantissas.map(|m| (((m * inverse_q16) >> (15 - pairs)) + 1) >> 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deviation::Deviation;
    use crate::random::Pcg32;

    #[test]
    fn zero_vector_has_no_direction() {
        assert_eq!(unit_q15([0; 3]), None);
        assert_eq!(unit_q15([0; 2]), None);
    }

    #[test]
    fn axes_are_exact_at_every_scale() {
        for shift in 0..31 {
            assert_eq!(unit_q15([0, 1 << shift, 0]), Some([0, 32_768, 0]));
            assert_eq!(unit_q15([0, 0, -1 << shift]), Some([0, 0, -32_768]));
        }
        assert_eq!(unit_q15([i32::MIN, 0, 0]), Some([-32_768, 0, 0]));
        assert_eq!(unit_q15([i32::MAX, 0, 0]), Some([32_768, 0, 0]));
    }

    #[test]
    fn inverse_square_root_error() {
        let mut deviation = Deviation::default();
        for x_q30 in (1u32 << 30..=u32::MAX).step_by(1021) {
            let exact = 32_768.0 / libm::sqrt(f64::from(x_q30));
            let got = f64::from(inverse_square_root_q16(x_q30)) / 65_536.0;
            deviation.add(got / exact - 1.0);
        }
        deviation.assert_at_most(3.1e-5, 1e-5);
    }

    #[test]
    fn unit_vector_error_at_every_scale() {
        let (mut directions, mut lengths) = (Deviation::default(), Deviation::default());
        let mut generator = Pcg32::new(5);
        for index in 0..1_000_000 {
            let vector = [(); 3].map(|()| generator.next_u32() as i32 >> (index % 30));
            let Some(unit) = unit_q15(vector) else { continue };
            let [vector, unit] = [vector, unit].map(|v| v.map(f64::from));
            let (exact, got) = (length(vector), length(unit));
            let apart = [0, 1, 2].map(|k| vector[k] / exact - unit[k] / got);
            directions.add(length(apart));
            lengths.add(got / 32_768.0 - 1.0);
        }
        directions.assert_at_most(6.6e-5, 1.7e-5);
        lengths.assert_at_most(5.2e-5, 1.4e-5);
    }

    fn length(v: [f64; 3]) -> f64 {
        libm::sqrt(v.iter().map(|x| x * x).sum())
    }
}
