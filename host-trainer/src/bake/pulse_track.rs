//! A motion → the pulses of its servos, inside their ranges, and every word that has to be said about that.
//!
//! In:  a [`Motion`], the [`Servo`]s.
//! Out: [`PulseTrack`] to the formats that hold pulses.
//!
//! Why here: exporters that drop what is out of range leave a servo where it was and say nothing. Here such a pulse is
//! moved to the end of the range, and the user hears which servo, how often, where first and by how much.

use crate::bake::servo::{asked_us, pose_of, pulses_us, us_per_s_max};
use crate::calibration::Servo;
use crate::export::Motion;

/// Pulses of one motion.
#[derive(Clone, Debug)]
pub struct PulseTrack<'a> {
    /// Where it comes from.
    pub motion: &'a Motion,
    /// One a column.
    pub servos: &'a [Servo],
    pulses_us: Vec<f64>, // (frame, servo)
}

impl<'a> PulseTrack<'a> {
    /// Asks every servo for its pulse in every frame and keeps it inside the servo's range.
    pub fn new(motion: &'a Motion, servos: &'a [Servo], remarks: &mut Vec<String>) -> Self {
        let asked = motion.frames().flat_map(|values| {
            let pose = pose_of(values);
            servos.iter().map(move |servo| asked_us(servo, &pose))
        });
        let mut track = Self { motion, servos, pulses_us: asked.collect() };
        remarks.extend(track.keep_in_range());
        remarks.extend(track.too_fast());
        track
    }

    /// Frames. // (servo)
    pub fn frames(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.pulses_us.chunks_exact(self.servos.len())
    }

    /// One servo's pulses, µs. // (frame)
    pub fn servo_us(&self, servo: usize) -> Vec<f64> {
        self.frames().map(|frame| frame[servo]).collect()
    }

    /// Pulses to nearest whole µs, ties away from zero. // (frame, servo)
    pub fn whole_us(&self) -> Vec<Vec<u16>> {
        self.frames()
            .map(|frame| frame.iter().map(|pulse_us| pulse_us.round() as u16).collect())
            .collect()
    }

    /// Largest step of a servo from one frame to the next, µs; 0 where there is none.
    pub fn step_us_max(&self, servo: usize) -> f64 {
        let pulses_us = self.servo_us(servo);
        pulses_us.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
    }

    fn keep_in_range(&mut self) -> Vec<String> {
        let count = self.servos.len();
        let mut remarks = Vec::new();
        for (index, servo) in self.servos.iter().enumerate() {
            let [min, _, max] = pulses_us(servo);
            let (mut clamped, mut first, mut worst) = (0, 0, 0.0f64);
            for (frame, pulse_us) in
                self.pulses_us.iter_mut().skip(index).step_by(count).enumerate()
            {
                let beyond = (min - *pulse_us).max(*pulse_us - max);
                if beyond > 0.0 {
                    first = if clamped == 0 { frame } else { first };
                    clamped += 1;
                    worst = worst.max(beyond);
                    *pulse_us = pulse_us.clamp(min, max);
                }
            }
            if clamped > 0 {
                let at_s = first as f64 / self.motion.rate_hz;
                remarks.push(format!(
                    "seed {}: {} is asked beyond {min:.0} to {max:.0} µs in {clamped} frames, first at {at_s:.2} s, \
                     by up to {worst:.0} µs; kept at the end of its range",
                    self.motion.seed, servo.name
                ));
            }
        }
        remarks
    }

    fn too_fast(&self) -> Vec<String> {
        let rate_hz = self.motion.rate_hz;
        let remark = |(index, servo): (usize, &Servo)| {
            let speed = self.step_us_max(index) * rate_hz;
            (speed > us_per_s_max(servo)).then(|| {
                format!(
                    "seed {}: {} is asked for {speed:.0} µs/s, its limit is {:.0}; it will lag behind",
                    self.motion.seed,
                    servo.name,
                    us_per_s_max(servo)
                )
            })
        };
        self.servos.iter().enumerate().filter_map(remark).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;

    #[test]
    fn pulse_beyond_the_range_stops_at_its_end_and_is_said() {
        let motion = specimen::motion_of(&[0.0, 95.0, 130.0, -20.0]);
        let servos = specimen::servos(&motion);
        let mut remarks = Vec::new();
        let track = PulseTrack::new(&motion, &servos, &mut remarks);
        assert_eq!(track.servo_us(0), [1500.0, 2450.0, 2500.0, 1300.0]);
        assert!(
            remarks[0].contains("in 1 frames, first at 0.04 s, by up to 300 µs"),
            "{remarks:?}"
        );
    }

    #[test]
    fn motion_that_is_faster_than_its_servo_is_said() {
        let motion = specimen::motion_of(&[0.0, 20.0]);
        let mut remarks = Vec::new();
        PulseTrack::new(&motion, &specimen::servos(&motion), &mut remarks);
        assert_eq!(remarks.len(), 1);
        assert!(remarks[0].contains("10000 µs/s, its limit is 6000"), "{remarks:?}");
    }
}
