//! Clips against servos: where, by how much, and how fast a clip may be played at most.
//!
//! In:  clips as they were imported, the servos of a calibration.
//! Out: a [`ClipCheck`] a clip, to `host-trainer check`.
//!
//! Why here: what a clip asks for beyond a limit, a model learns and a servo stage has to refuse. Pulses come from
//! core's own record; speed and acceleration are differences of neighbouring poses, as a servo would be told them.

use karakuri::{Pose, ServoMap};
use serde::Serialize;

use crate::calibration::Servo;
use crate::clip::{Clip, ClipSet};

/// What a clip asks of the servos.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClipCheck {
    /// Its name.
    pub clip: String,
    /// How much faster than recorded it may be played within speed and acceleration; none where it leaves a range,
    /// which no rate can mend, or where nothing moves.
    pub rate_max: Option<f64>,
    /// Worst place of every limit that it exceeds.
    pub excesses: Vec<Excess>,
}

/// One limit of one servo, exceeded.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Excess {
    /// Name of the servo.
    pub servo: String,
    /// Which limit.
    pub limit: Limit,
    /// Where in the clip it is worst.
    pub at_s: f64,
    /// What the clip asks for: µs, µs/s or µs/s².
    pub asked: f64,
    /// What the servo may do: the end of the range that is passed, or the limit.
    pub allowed: f64,
}

/// What a servo may not exceed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Limit {
    /// Shortest or longest pulse.
    Range,
    /// Change of the pulse a second.
    Speed,
    /// Change of the speed a second.
    Acceleration,
}

impl Limit {
    /// Name and unit.
    pub const fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Range => ("range", "us"),
            Self::Speed => ("speed", "us/s"),
            Self::Acceleration => ("acceleration", "us/s2"),
        }
    }
}

/// Every clip, in their order.
pub fn check(clip_set: &ClipSet, servos: &[Servo]) -> Vec<ClipCheck> {
    clip_set.clips.iter().map(|clip| check_clip(clip_set, clip, servos)).collect()
}

fn check_clip(clip_set: &ClipSet, clip: &Clip, servos: &[Servo]) -> ClipCheck {
    let channel_count = clip_set.layout.channel_count().max(1);
    let poses: Vec<Pose> = clip.poses.chunks_exact(channel_count).map(pose).collect();
    let (mut excesses, mut rate_max) = (Vec::new(), f64::INFINITY);
    for servo in servos {
        let course = Course::new(&poses, &servo.map, clip_set.rate_hz);
        let limits = servo.map.limits();
        let speed_max = f64::from(limits.pulse_us_per_s_max);
        let acceleration_max = f64::from(limits.pulse_us_per_s2_max);
        let (speed, acceleration) = (course.fastest(), course.hardest());
        rate_max = rate_max.min(speed_max / speed.value);
        rate_max = rate_max.min((acceleration_max / acceleration.value).sqrt());
        let mut note = |limit, worst: Worst, allowed| {
            let servo = servo.name.clone();
            excesses.push(Excess { servo, limit, at_s: worst.at_s, asked: worst.value, allowed });
        };
        if let Some((worst, end_us)) = course.farthest_out(&servo.map) {
            note(Limit::Range, worst, end_us);
        }
        if speed.value > speed_max {
            note(Limit::Speed, speed, speed_max);
        }
        if acceleration.value > acceleration_max {
            note(Limit::Acceleration, acceleration, acceleration_max);
        }
    }
    let is_in_range = excesses.iter().all(|excess| excess.limit != Limit::Range);
    let rate_max = (is_in_range && rate_max.is_finite()).then_some(rate_max);
    ClipCheck { clip: clip.name.clone(), rate_max, excesses }
}

/// As a decoder would give it: Q15.16, nearest.
fn pose(channels: &[f32]) -> Pose {
    channels.iter().map(|&channel| (f64::from(channel) * 65_536.0).round() as i32).collect()
}

/// The pulses that one servo is asked for.
struct Course {
    pulses_us: Vec<f64>,
    rate_hz: f64,
}

/// The largest of many values, and when it is.
#[derive(Clone, Copy)]
struct Worst {
    value: f64,
    at_s: f64,
}

impl Course {
    fn new(poses: &[Pose], map: &ServoMap, rate_hz: f64) -> Self {
        let asked = poses.iter().filter_map(|pose| map.asked_q16(pose));
        Self { pulses_us: asked.map(|pulse_q16| pulse_q16 as f64 / 65_536.0).collect(), rate_hz }
    }

    fn worst(&self, values: impl Iterator<Item = f64>) -> Worst {
        let start = Worst { value: 0.0, at_s: 0.0 };
        values.enumerate().fold(start, |worst, (frame, value)| match value > worst.value {
            true => Worst { value, at_s: frame as f64 / self.rate_hz },
            false => worst,
        })
    }

    /// At the later of two poses.
    fn fastest(&self) -> Worst {
        let speed = |pair: &[f64]| (pair[1] - pair[0]).abs() * self.rate_hz;
        self.worst(std::iter::once(0.0).chain(self.pulses_us.windows(2).map(speed)))
    }

    /// At the middle one of three poses.
    fn hardest(&self) -> Worst {
        let bend = |three: &[f64]| (three[2] - 2.0 * three[1] + three[0]).abs();
        let bends = self.pulses_us.windows(3).map(|three| bend(three) * self.rate_hz.powi(2));
        self.worst(std::iter::once(0.0).chain(bends))
    }

    /// The pulse farthest out of the range, and the end that it passes.
    fn farthest_out(&self, map: &ServoMap) -> Option<(Worst, f64)> {
        let [min_us, _, max_us] = map.pulses_us().map(f64::from);
        let out_us = |pulse_us: &f64| (min_us - pulse_us).max(pulse_us - max_us);
        let worst = self.worst(self.pulses_us.iter().map(out_us));
        let frame = (worst.at_s * self.rate_hz).round() as usize;
        let pulse_us = *self.pulses_us.get(frame)?;
        let end_us = if pulse_us < min_us { min_us } else { max_us };
        (worst.value > 0.0).then_some((Worst { value: pulse_us, ..worst }, end_us))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::calibration::Calibration;
    use crate::layout::{Group, GroupKind, PoseLayout, Unit};

    const JAW: &str = "[[servo]]\nchannel = \"jaw\"\nmin_us = 1000\nneutral_us = 1500\n\
        max_us = 2000\nus_per_degree = 10\nspeed_us_per_s = 2000\nacceleration_us_per_s2 = 20000\n";

    /// One clip of a jaw at 50 poses a second, in degrees.
    fn checked(degrees: &[f32]) -> ClipCheck {
        let jaw = Group { name: "jaw".to_owned(), kind: GroupKind::Scalar, unit: Unit::Degree };
        let clip = Clip {
            name: "bite".to_owned(),
            action: String::new(),
            source: "memory".into(),
            poses: degrees.to_vec(),
        };
        let clip_set = ClipSet {
            layout: PoseLayout { groups: vec![jaw] },
            rate_hz: 50.0,
            skeleton: None,
            clips: vec![clip],
            remarks: Vec::new(),
        };
        let calibration = Calibration::parse(JAW, Path::new("own.toml")).unwrap();
        let servos = calibration.servos(&clip_set.layout).unwrap();
        check(&clip_set, &servos).remove(0)
    }

    #[test]
    fn built_in_character_stays_within_its_own_servos() {
        let clip_set = crate::character::clip_set(7, 4);
        let servos = crate::character::calibration().servos(&clip_set.layout).unwrap();
        for clip in check(&clip_set, &servos) {
            assert!(clip.excesses.is_empty() && clip.rate_max >= Some(1.0), "{clip:?}");
        }
    }

    #[test]
    fn clip_beyond_the_range_is_named_with_its_worst_place_and_no_rate() {
        let found = checked(&[48.0, 50.5, 53.0, 52.0]);
        assert_eq!(found.rate_max, None);
        let range = &found.excesses[0];
        assert_eq!((range.servo.as_str(), range.limit), ("jaw", Limit::Range));
        assert_eq!((range.at_s, range.asked, range.allowed), (0.04, 2030.0, 2000.0));
    }

    #[test]
    fn clip_that_is_too_fast_says_at_which_rate_it_is_not() {
        // 40 µs a pose: 2000 µs/s; then 50: 2500 µs/s.
        let found = checked(&[0.0, 4.0, 8.0, 13.0, 18.0]);
        let [speed, acceleration] = &found.excesses[..] else { panic!("{found:?}") };
        assert_eq!((speed.limit, speed.asked, speed.at_s), (Limit::Speed, 2500.0, 0.06));
        assert_eq!((acceleration.limit, acceleration.asked), (Limit::Acceleration, 25_000.0));
        assert!((found.rate_max.unwrap() - 0.8).abs() < 1e-9);
    }

    #[test]
    fn clip_within_the_limits_has_nothing_to_say_but_its_rate() {
        let found = checked(&[0.0, 0.1, 0.3, 0.4]);
        assert!(found.excesses.is_empty());
        assert!((found.rate_max.unwrap() - 8.0f64.sqrt()).abs() < 1e-3, "{found:?}");
        assert_eq!(checked(&[1.0, 1.0, 1.0]).rate_max, None);
    }
}
