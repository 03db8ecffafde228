//! What is to be known of a performance, in a dozen numbers.
//!
//! In:  a [`Performance`].
//! Out: a [`Summary`] for people and scripts.

use serde::Serialize;

use super::repeat::{Course, NearestRepeat, nearest_repeat};
use super::{Performance, Tick, Violation};

/// A servo moves when its pulse changed by so much within [`ACTIVE_WITHIN_S`], µs.
const ACTIVE_US: u16 = 5;
/// See [`ACTIVE_US`].
const ACTIVE_WITHIN_S: f64 = 0.2;

/// The dozen numbers; keys are those that scripts read.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Simulated minutes.
    pub minutes: f64,
    /// Ticks.
    pub ticks: usize,
    /// Pulses sent: ticks times servos, released ones left out.
    pub commands: usize,
    /// Commands that broke a limit, as an independent judge sees them.
    pub violations: usize,
    /// The first of them.
    pub first_violation: Option<Violation>,
    /// How often a limit began to hold a servo back, a minute.
    pub interventions_per_minute: f64,
    /// Share of the ticks in which a limit held any servo back.
    pub limited_fraction: f64,
    /// Share of the ticks in which any servo moved.
    pub active_fraction: f64,
    /// Share of the ticks in which a motion was under way.
    pub in_motion_fraction: f64,
    /// Root mean square of the horns' jerk while the body was active, µs/s³.
    pub horn_jerk_rms: f64,
    /// The two most alike moments.
    pub nearest_repeat: Option<NearestRepeat>,
    /// The two most alike moments of the clips that the blob was made of, where it still knows them.
    pub nearest_among_clips: Option<NearestRepeat>,
}

/// Works the numbers out; `clips` as [`clip_courses`](super::clip_courses).
pub fn summarize(performance: &Performance, clips: &[Course]) -> Summary {
    let ticks = &performance.ticks;
    let tick_hz = 1e6 / f64::from(performance.stint.tick_us);
    let minutes = ticks.last().map_or(0.0, |tick| tick.time_s) / 60.0;
    let share = |count: usize| count as f64 / ticks.len().max(1) as f64;
    let active = active_ticks(ticks, (ACTIVE_WITHIN_S * tick_hz).round() as usize);
    let horns: Vec<Vec<f64>> = ticks.iter().map(|tick| tick.horns_us.clone()).collect();
    Summary {
        minutes,
        ticks: ticks.len(),
        commands: ticks.iter().flat_map(|tick| &tick.pulses_us).flatten().count(),
        violations: performance.violations.len(),
        first_violation: performance.violations.first().cloned(),
        interventions_per_minute: onsets(ticks) as f64 / minutes.max(f64::MIN_POSITIVE),
        limited_fraction: share(ticks.iter().filter(|tick| tick.limited != 0).count()),
        active_fraction: share(active.iter().filter(|active| **active).count()),
        in_motion_fraction: share(ticks.iter().filter(|tick| tick.in_motion).count()),
        horn_jerk_rms: jerk_rms(&horns, &active, tick_hz),
        nearest_repeat: nearest_repeat(&motions(ticks), tick_hz),
        nearest_among_clips: nearest_repeat(clips, tick_hz),
    }
}

/// The stretches in which a motion was under way.
fn motions(ticks: &[Tick]) -> Vec<Course> {
    let stretches = ticks.chunk_by(|one, next| one.in_motion == next.in_motion);
    let moving = stretches.filter(|stretch| stretch[0].in_motion);
    moving
        .map(|stretch| Course {
            start_s: stretch[0].time_s,
            ticks: stretch.iter().map(|tick| tick.channels.clone()).collect(),
        })
        .collect()
}

/// How often a servo that was free is held back.
fn onsets(ticks: &[Tick]) -> u32 {
    let before = std::iter::once(0).chain(ticks.iter().map(|tick| tick.limited));
    before.zip(ticks).map(|(before, tick)| (tick.limited & !before).count_ones()).sum()
}

fn active_ticks(ticks: &[Tick], within: usize) -> Vec<bool> {
    let moved = |from: &Tick, to: &Tick| {
        from.pulses_us.iter().zip(&to.pulses_us).any(|pair| match pair {
            (Some(from), Some(to)) => from.abs_diff(*to) >= ACTIVE_US,
            _ => false,
        })
    };
    let active = |(index, tick): (usize, &Tick)| moved(&ticks[index.saturating_sub(within)], tick);
    ticks.iter().enumerate().map(active).collect()
}

/// Third differences of the horns' positions over ticks of nominal length.
fn jerk_rms(horns: &[Vec<f64>], active: &[bool], tick_hz: f64) -> f64 {
    let (mut squares, mut count) = (0.0, 0usize);
    for (four, active) in horns.windows(4).zip(&active[3.min(active.len())..]) {
        let [a, b, c, d] = four else { continue };
        let servos = a.iter().zip(b).zip(c.iter().zip(d)).filter(|_| *active);
        for ((a, b), (c, d)) in servos {
            squares += ((d - 3.0 * c + 3.0 * b - a) * tick_hz.powi(3)).powi(2);
            count += 1;
        }
    }
    (squares / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tick(pulse_us: u16, limited: u32) -> Tick {
        Tick {
            time_s: 0.0,
            elapsed_us: 20_000,
            pulses_us: vec![Some(pulse_us)],
            limited,
            begins_motion: false,
            in_motion: false,
            horns_us: vec![f64::from(pulse_us)],
            channels: Vec::new(),
        }
    }

    #[test]
    fn interventions_are_counted_where_they_begin() {
        let ticks: Vec<Tick> = [0, 1, 1, 3, 0, 2].map(|limited| tick(1500, limited)).into();
        assert_eq!(onsets(&ticks), 3);
    }

    #[test]
    fn servo_that_creeps_is_not_active() {
        let creeping: Vec<Tick> = (0..50).map(|index| tick(1500 + index / 4, 0)).collect();
        assert!(active_ticks(&creeping, 10).iter().all(|active| !active));
        let moving: Vec<Tick> = (0..50).map(|index| tick(1500 + index, 0)).collect();
        assert_eq!(active_ticks(&moving, 10).iter().filter(|active| **active).count(), 45);
    }

    #[test]
    fn jerk_of_a_cubic_is_its_sixth_part_of_the_third_derivative() {
        let horns: Vec<Vec<f64>> =
            (0..100).map(|tick| vec![(f64::from(tick) / 50.0).powi(3)]).collect();
        assert!((jerk_rms(&horns, &[true; 100], 50.0) - 6.0).abs() < 1e-6);
    }
}
