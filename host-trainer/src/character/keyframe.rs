//! Keyframes as overlapping minimum-jerk strokes.
//!
//! In:  keys of an action (`score.rs`).
//! Out: the goal of one joint at any time, to `follow_through.rs`.
//!
//! Why here: a key that starts before the last one has arrived adds its stroke to it. The sum stays
//! smooth to the second derivative, which is what makes chains of gestures flow into each other
//! instead of stopping at each key.
//! Source: Flash & Hogan 1985 (minimum jerk); Flash & Henis 1991 (superposition of strokes).

/// Progress of a movement from rest to rest with the least jerk: 0 → 0, 1 → 1, flat to the second
/// derivative at both.
pub fn minimum_jerk(progress: f64) -> f64 {
    let s = progress.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// Peak of the derivative of [`minimum_jerk`], at its middle.
const PEAK_SPEED: f64 = 1.875;

/// One smooth change of a joint's goal.
#[derive(Clone, Copy, Debug)]
pub struct Stroke {
    /// When it begins.
    pub start_s: f64,
    /// From rest to rest.
    pub duration_s: f64,
    /// By how much the goal is other afterwards.
    pub delta_deg: f64,
    /// Above 0 it starts fast and arrives slowly, below 0 the reverse; within ±0.9.
    pub attack: f64,
}

impl Stroke {
    fn value_deg(&self, time_s: f64) -> f64 {
        let s = ((time_s - self.start_s) / self.duration_s).clamp(0.0, 1.0);
        self.delta_deg * minimum_jerk(s + self.attack * s * (1.0 - s))
    }

    /// Shortest duration at which a stroke stays below a speed. An attack raises the peak by less
    /// than 0.62 of its square.
    pub fn shortest_s(delta_deg: f64, attack: f64, speed_deg_per_s: f64) -> f64 {
        delta_deg.abs() * PEAK_SPEED * (1.0 + 0.62 * attack * attack) / speed_deg_per_s
    }
}

/// All strokes of one joint.
#[derive(Clone, Debug, Default)]
pub struct Track {
    strokes: Vec<Stroke>,
    goal_deg: f64,
}

impl Track {
    /// Where the joint will be when every stroke is done.
    pub fn goal_deg(&self) -> f64 {
        self.goal_deg
    }

    /// When the last stroke is done.
    pub fn end_s(&self) -> f64 {
        let ends = self.strokes.iter().map(|s| s.start_s + s.duration_s);
        ends.fold(0.0, f64::max)
    }

    /// Adds a stroke to whatever else is going on.
    pub fn add(&mut self, stroke: Stroke) {
        self.goal_deg += stroke.delta_deg;
        self.strokes.push(stroke);
    }

    /// Moves everything in time: what happened at 1 s happens at `factor` s.
    pub fn stretch(&mut self, factor: f64) {
        for stroke in &mut self.strokes {
            stroke.start_s *= factor;
            stroke.duration_s *= factor;
        }
    }

    /// The goal at a time.
    pub fn value_deg(&self, time_s: f64) -> f64 {
        self.strokes.iter().map(|s| s.value_deg(time_s)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STROKE: Stroke = Stroke { start_s: 1.0, duration_s: 0.5, delta_deg: 20.0, attack: 0.0 };

    #[test]
    fn minimum_jerk_stays_at_its_ends_outside_the_movement() {
        assert_eq!(minimum_jerk(-3.0), 0.0);
        assert_eq!(minimum_jerk(7.0), 1.0);
    }

    #[test]
    fn minimum_jerk_starts_and_ends_at_rest_and_peaks_in_the_middle() {
        let step = 1e-4;
        let speed = |s: f64| (minimum_jerk(s + step) - minimum_jerk(s - step)) / (2.0 * step);
        assert!(speed(0.0).abs() < 1e-6);
        assert!(speed(1.0).abs() < 1e-6);
        assert!((speed(0.5) - PEAK_SPEED).abs() < 1e-6);
        assert_eq!(minimum_jerk(0.5), 0.5);
    }

    #[test]
    fn overlapping_strokes_add_up_to_the_goal() {
        let mut track = Track::default();
        track.add(STROKE);
        track.add(Stroke { start_s: 1.2, delta_deg: -5.0, ..STROKE });
        assert_eq!(track.goal_deg(), 15.0);
        assert_eq!(track.end_s(), 1.7);
        assert_eq!(track.value_deg(1.0), 0.0);
        assert_eq!(track.value_deg(1.7), 15.0);
    }

    #[test]
    fn the_shortest_stroke_keeps_its_speed_limit_at_any_attack() {
        for tenths in -9..=9 {
            let attack = f64::from(tenths) / 10.0;
            let stroke =
                Stroke { duration_s: Stroke::shortest_s(20.0, attack, 100.0), attack, ..STROKE };
            let values = (0..2_000).map(|i| stroke.value_deg(1.0 + f64::from(i) * 0.001));
            let values = values.collect::<Vec<_>>();
            let fastest = values.windows(2).map(|pair| (pair[1] - pair[0]) * 1e3);
            let fastest = fastest.fold(0.0, f64::max);
            assert!((90.0..=100.5).contains(&fastest), "{attack}: {fastest}");
        }
    }
}
