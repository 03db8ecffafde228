//! How alike the two most alike moments of a performance are.
//!
//! In:  courses of the channels that servos follow, from the start of a motion to its end.
//! Out: the least distance between any two windows of it, and where.
//!
//! Why here: "never the same twice" is a claim that can be measured. Rest is like rest, so only motion counts, and only
//! windows in which something moves; pairs that overlap are left out.

use serde::Serialize;

/// Seconds of a window.
pub const WINDOW_S: f64 = 2.0;
/// Windows begin so far apart, s.
const STRIDE_S: f64 = 0.5;
/// Instants of a window that are compared.
const INSTANTS: usize = 20;
/// A window moves when its channels leave their mean by so much of what they do over the whole, root mean square.
const MOVES_SHARE: f64 = 0.25;

/// The two windows that are most alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NearestRepeat {
    /// Root mean square over instants and channels, channel units.
    pub distance: f64,
    /// Start of the earlier one, s.
    pub first_s: f64,
    /// Start of the later one, s.
    pub second_s: f64,
    /// Moving windows that were compared, each with each.
    pub window_count: usize,
    /// Median over the windows of the distance to their nearest other one, channel units.
    pub median: f64,
}

/// A course without rest. // (tick, channel)
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Where in the performance it begins, s.
    pub start_s: f64,
    /// Channel values, in channel units. // (tick, channel)
    pub ticks: Vec<Vec<f32>>,
}

struct Window {
    start_s: f64,
    /// Which recording it is part of.
    source: usize,
    values: Vec<f32>,
}

/// The nearest two windows of all courses, each of `tick_hz`; `None` with fewer than two that move.
pub fn nearest_repeat(courses: &[Course], tick_hz: f64) -> Option<NearestRepeat> {
    let channel_count = courses.iter().flat_map(|course| &course.ticks).next().map_or(1, Vec::len);
    let all: Vec<f32> = courses.iter().flat_map(|course| course.ticks.concat()).collect();
    let moves = MOVES_SHARE * spread(&all, channel_count.max(1));
    let windows =
        courses.iter().enumerate().flat_map(|(source, course)| windows(source, course, tick_hz));
    let windows: Vec<Window> =
        windows.filter(|window| spread(&window.values, channel_count.max(1)) > moves).collect();
    let mut nearest = vec![(f32::INFINITY, 0); windows.len()];
    for later in 1..windows.len() {
        for earlier in 0..later {
            let (a, b) = (&windows[earlier], &windows[later]);
            if a.source == b.source && (b.start_s - a.start_s).abs() < WINDOW_S {
                continue;
            }
            let limit = nearest[earlier].0.max(nearest[later].0);
            let squares = squares(&a.values, &b.values, limit);
            for (place, other) in [(earlier, later), (later, earlier)] {
                if squares < nearest[place].0 {
                    nearest[place] = (squares, other);
                }
            }
        }
    }
    let of = |squares: f32, index: usize| {
        (f64::from(squares) / windows[index].values.len() as f64).sqrt()
    };
    let mut distances: Vec<f64> =
        nearest.iter().enumerate().map(|(index, (squares, _))| of(*squares, index)).collect();
    let best = (0..windows.len()).min_by(|a, b| distances[*a].total_cmp(&distances[*b]))?;
    let distance = distances[best];
    if !distance.is_finite() {
        return None;
    }
    let other = nearest[best].1;
    distances.sort_by(f64::total_cmp);
    Some(NearestRepeat {
        distance,
        first_s: windows[best.min(other)].start_s,
        second_s: windows[best.max(other)].start_s,
        window_count: windows.len(),
        median: distances[distances.len() / 2],
    })
}

/// The windows of a course.
fn windows(source: usize, course: &Course, tick_hz: f64) -> Vec<Window> {
    let length = (WINDOW_S * tick_hz).round() as usize;
    let stride = ((STRIDE_S * tick_hz).round() as usize).max(1);
    let starts = (0..).step_by(stride).take_while(|start| start + length <= course.ticks.len());
    let window = |start: usize| {
        let instants =
            (0..INSTANTS).map(|instant| &course.ticks[start + instant * length / INSTANTS]);
        let values = instants.flatten().copied().collect();
        Window { start_s: course.start_s + start as f64 / tick_hz, source, values }
    };
    starts.map(window).collect()
}

/// Root mean square distance of the channels from their means.
fn spread(values: &[f32], channel_count: usize) -> f64 {
    let mut squares = 0.0;
    for channel in 0..channel_count.min(values.len()) {
        let of_channel =
            || values[channel..].iter().step_by(channel_count).map(|value| f64::from(*value));
        let mean = of_channel().sum::<f64>() / of_channel().count() as f64;
        squares += of_channel().map(|value| (value - mean).powi(2)).sum::<f64>();
    }
    (squares / values.len().max(1) as f64).sqrt()
}

/// Sum of squared differences, or any number from `limit` on once it is known to be no less.
fn squares(a: &[f32], b: &[f32], limit: f32) -> f32 {
    let mut sum = 0.0;
    for (a, b) in a.chunks(32).zip(b.chunks(32)) {
        sum += a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
        if sum >= limit {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(seconds: usize, of: impl Fn(f64) -> f64) -> Course {
        let tick = |tick| vec![200.0 * of(tick as f64 / 50.0) as f32, 7.0];
        Course { start_s: 0.0, ticks: (0..seconds * 50).map(tick).collect() }
    }

    #[test]
    fn body_that_never_moves_has_no_repeat() {
        assert_eq!(nearest_repeat(&[wave(100, |_| 0.0)], 50.0), None);
    }

    #[test]
    fn loop_is_found_out() {
        let course = wave(30, |time_s| ((time_s % 7.0) * 2.0).sin() + (time_s % 7.0) * 0.1);
        let repeat = nearest_repeat(&[course], 50.0).unwrap();
        assert_eq!(repeat.distance, 0.0);
        assert!((repeat.second_s - repeat.first_s - 7.0).abs() < 1e-9, "{repeat:?}");
    }

    #[test]
    fn motion_that_only_resembles_itself_has_its_distance() {
        // A slow drift of one unit per second in one of two channels: windows 2 s apart are 2 / √2 from each other.
        let course = wave(20, |time_s| (time_s * core::f64::consts::PI).sin() + time_s / 200.0);
        let repeat = nearest_repeat(&[course], 50.0).unwrap();
        assert!((repeat.distance - 2.0 / 2f64.sqrt()).abs() < 0.01, "{repeat:?}");
    }
}
