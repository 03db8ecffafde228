//! Sine and cosine of an integer phase, from a table and the tangent at the nearest entry.
//!
//! Why here: libm's `sinf` costs 1,939 instructions on a Cortex-M4, a decoder wants hundreds of
//! sines per pose, and float sines differ between platforms. These give the same bits everywhere.
//! One table over the whole turn needs no cases by quadrant, and what sine and cosine share is
//! computed once.

/// Table steps in a full turn.
const STEPS: usize = 128;

/// The cosine is the sine a quarter turn ahead.
const QUARTER_TURN_STEPS: usize = STEPS / 4;

/// What is cut off the angle beyond an entry, on average: half of 2^10 of phase and half of 2^-19.
const TRUNCATED_RAD: f64 = core::f64::consts::TAU / 8_388_608.0 + 0.5 / 524_288.0;

/// `sin((i + ½)/128 · 2π)` in 1/131,068, so that a quarter of it is the symmetric Q0.15 of the
/// output; raised by 2.5, which makes the two truncations that follow round to nearest.
#[allow(clippy::indexing_slicing, reason = "the compiler evaluates it")]
const SINES_Q17: [i32; STEPS + QUARTER_TURN_STEPS] = {
    let mut table = [0; STEPS + QUARTER_TURN_STEPS];
    let mut index = 0;
    while index < table.len() {
        // Centred on 0, where the series converges fast.
        let turns = (index as f64 + 0.5) / STEPS as f64 - 0.5;
        let angle_rad = core::f64::consts::TAU * turns + TRUNCATED_RAD;
        let exact = -sine_series(angle_rad) * 131_068.0;
        table[index] = (exact + 2.5 + 262_144.5) as i32 - 262_144;
        index += 1;
    }
    table
};

/// Taylor series about 0, exact to 1e-13 for |x| ≤ 3/2 π; only ever evaluated by the compiler.
const fn sine_series(x: f64) -> f64 {
    let (mut sum, mut term, mut n) = (x, x, 1.0);
    while n < 48.0 {
        term = -term * x * x / ((n + 1.0) * (n + 2.0));
        sum += term;
        n += 2.0;
    }
    sum
}

/// Radians per 2^10 of phase, 2π/2^22 in Q35, lowered by 7.5e-5: the least that sin δ = δ errs.
const RAD_PER_PHASE_Q35: i32 = 51_468;

/// `[sin, cos]` of `2π · phase / 2^32` in Q0.15, symmetric: −32767..=32767.
///
/// # Accuracy
/// Against f64, both: 0.87 LSB of 2^-15 max, 0.33 LSB RMS (asserted by `sine_error_over_all_phases`),
/// where rounding alone makes 0.5 and 0.29. Exact at the quarter turns.
///
/// # Cost
/// 21 instructions for both on a Cortex-M4, 41 on an M0+.
pub(crate) fn sine_and_cosine_q15(phase: u32) -> [i32; 2] {
    let index = (phase >> 25) as usize;
    let sine_q17 = SINES_Q17.get(index).copied().unwrap_or(0);
    let cosine_q17 = SINES_Q17.get(index + QUARTER_TURN_STEPS).copied().unwrap_or(0);
    // From the middle of the step, whose top bit becomes a sign: −2^14..2^14, 2^10 of phase each.
    let beyond = ((phase << 7) ^ (1 << 31)) as i32 >> 17;
    // Up to 0.0246 rad: sin δ = δ to 0.02 LSB and cos δ = 1 − δ²/2 to much less.
    let beyond_rad_q19 = (beyond * RAD_PER_PHASE_Q35) >> 16;
    let one_less_cosine_q19 = (beyond_rad_q19 * beyond_rad_q19) >> 20;
    let turned = |from_q17: i32, towards_q17: i32| {
        let change_q36 = towards_q17 * beyond_rad_q19 - from_q17 * one_less_cosine_q19;
        (from_q17 + (change_q36 >> 19)) >> 2
    };
    [turned(sine_q17, cosine_q17), turned(cosine_q17, -sine_q17)]
}

#[cfg(test)]
mod tests {
    use super::sine_and_cosine_q15;
    use crate::deviation::Deviation;

    #[test]
    fn quarter_turns_are_exact() {
        for (quarters, expected) in
            [[0, 32_767], [32_767, 0], [0, -32_767], [-32_767, 0]].iter().enumerate()
        {
            assert_eq!(sine_and_cosine_q15((quarters as u32) << 30), *expected);
        }
    }

    #[test]
    fn sine_is_odd_and_cosine_even_to_one_step() {
        for phase in (1..u32::MAX).step_by(65_521) {
            let [[sine, cosine], [opposite, same]] =
                [phase, phase.wrapping_neg()].map(sine_and_cosine_q15);
            assert!((sine + opposite).abs() <= 1 && (cosine - same).abs() <= 1, "{phase}");
        }
    }

    /// Every one of the 128 steps, at 32,768 places within it.
    #[test]
    fn sine_error_over_all_phases() {
        let mut deviations = [Deviation::default(); 2];
        for index in 0..1u32 << 22 {
            let phase = index * 1024 + index % 1024;
            let angle_rad = f64::from(phase) / 4_294_967_296.0 * core::f64::consts::TAU;
            let exact = [libm::sin(angle_rad), libm::cos(angle_rad)];
            let got = sine_and_cosine_q15(phase);
            for ((deviation, exact), got) in deviations.iter_mut().zip(exact).zip(got) {
                deviation.add(f64::from(got) - exact * 32_767.0);
            }
        }
        for deviation in deviations {
            deviation.assert_at_most(0.87, 0.33);
        }
    }
}
