//! Which pulse goes to which output: servos stand in the order of their calibration, outputs in that of the wiring.

use crate::servo_map::ServoMap;

/// Puts the pulse of every servo at the number of its output; outputs without a servo get no pulse, and servos whose
/// output is beyond the last one are left out. `servos` and `pulses_us` are in the same order, that of
/// `Model::servos`.
pub fn arrange(
    servos: impl IntoIterator<Item = ServoMap>,
    pulses_us: &[u16],
    outputs_us: &mut [u16],
) {
    outputs_us.fill(0);
    for (servo, &pulse_us) in servos.into_iter().zip(pulses_us) {
        if let Some(output_us) = outputs_us.get_mut(usize::from(servo.output())) {
            *output_us = pulse_us;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo_map::ServoLimits;

    #[test]
    fn pulses_go_where_their_servos_are_wired() {
        let limits = ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };
        let map = ServoMap::new(0, [500, 1500, 2500], 10 << 16, limits).unwrap();
        let servos = [3, 0, 9].map(|output| map.on_output(output));
        let mut outputs_us = [7; 4];
        arrange(servos, &[1001, 1002, 1003], &mut outputs_us);
        assert_eq!(outputs_us, [1002, 0, 0, 1001]);
    }
}
