//! The built-in character: **Chako**, a tea-serving desk creature about the size of its own teapot.
//!
//! In:  a seed.
//! Out: [`ClipSet`] with labelled clips, as if an importer had read them; `commands/character.rs`
//! writes them as files.
//!
//! Why here: the project ships only data that it made, and made data that moves like sine waves
//! would teach and show nothing. Each clip is played, not drawn: an `Actor` with a temperament
//! writes strokes of an action into a `Score`, life adds breath and blinks, and a body of springs
//! performs it.
//!
//! The same seed gives the same bits on every machine: arithmetic is `+ − × ÷` and `floor` on f64
//! only, because the standard library's transcendental functions differ between platforms.

mod dice;
mod joint;
mod keyframe;
mod score;
mod actor;
mod life;
mod actions;
mod follow_through;

use std::path::PathBuf;

use crate::calibration::Calibration;
use crate::clip::{Clip, ClipSet};

use actions::{ACTIONS, Action};
use actor::Actor;
use dice::Dice;
pub use joint::{JOINT_COUNT, Joint, JointSpec};

/// The character's name, 茶子, "tea child".
pub const NAME: &str = "Chako";

/// Its servos, a hobby servo for every joint: what `demo` puts into its blobs, and an example of a calibration file.
pub const CALIBRATION: &str = include_str!("../calibrations/chako.toml");

/// [`CALIBRATION`], read.
pub fn calibration() -> Calibration {
    let source = std::path::Path::new("the built-in calibration");
    Calibration::parse(CALIBRATION, source).unwrap_or_else(|error| unreachable!("{error}"))
}

/// Raised whenever the same seed would give other clips.
pub const GENERATOR_VERSION: u32 = 1;

/// Poses per second.
pub const RATE_HZ: f64 = 50.0;

/// Seed of the built-in data.
pub const DEFAULT_SEED: u64 = 1;

/// Clips of each action in the built-in data.
pub const DEFAULT_CLIPS_PER_ACTION: usize = 16;

/// Most clips of each action; the limit keeps a slip of the finger from filling the disk.
pub const CLIPS_PER_ACTION_MAX: usize = 1000;

/// Shortest and longest clip: 1 s and 6 s.
const FRAME_COUNT_MIN: usize = 50;
const FRAME_COUNT_MAX: usize = 300;

/// Longest action; leaves time within the longest clip for loose parts to come to rest.
const PERFORMANCE_S_MAX: f64 = 5.4;

/// Every action's label, sorted.
pub fn action_labels() -> impl Iterator<Item = &'static str> {
    ACTIONS.iter().map(|action| action.label)
}

/// Plays `clips_per_action` clips of every action. A clip depends on seed, action and its own
/// number only: asking for more clips changes none of the first.
pub fn clip_set(seed: u64, clips_per_action: usize) -> ClipSet {
    let mut clips = ACTIONS
        .iter()
        .flat_map(|action| (0..clips_per_action).map(move |index| clip(seed, action, index)))
        .collect::<Vec<_>>();
    clips.sort_by(|a, b| a.name.cmp(&b.name));
    ClipSet {
        layout: joint::layout(),
        rate_hz: RATE_HZ,
        skeleton: None,
        clips,
        remarks: Vec::new(),
    }
}

fn clip(seed: u64, action: &Action, index: usize) -> Clip {
    let mut actor = Actor::new(Dice::new(seed, action.label, index as u64));
    let mut score = actor.empty_score();
    (action.perform)(&mut score, &mut actor);
    score.fit_into(PERFORMANCE_S_MAX);
    let end_s = score.end_s() + actor.dice.between(-0.3, 0.2);
    if action.breath_deg > 0.0 {
        life::breathe(&mut score, &mut actor, end_s, action.breath_deg);
    }
    if action.blinks {
        life::blink_now_and_then(&mut score, &mut actor, end_s);
    }
    let frame_count_min = ((end_s * RATE_HZ) as usize).max(FRAME_COUNT_MIN);
    let label = action.label;
    Clip {
        name: format!("{label}_{index:02}"),
        action: label.to_owned(),
        source: PathBuf::from(format!("{NAME}, seed {seed}, {label} {index}")),
        poses: follow_through::play(&score, frame_count_min, FRAME_COUNT_MAX),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::OnceLock;

    use sha2::{Digest, Sha256};

    use super::*;

    const SEEDS: [u64; 6] = [0, 1, 2, 42, 0xDEAD_BEEF, u64::MAX];
    const STEP_S: f64 = 1.0 / RATE_HZ;

    fn column(clip: &Clip, joint: Joint) -> Vec<f64> {
        let angle = |pose: &[f32]| f64::from(pose[joint.index()]);
        clip.poses.chunks(JOINT_COUNT).map(angle).collect()
    }

    fn speeds(angles: &[f64]) -> Vec<f64> {
        let speed = |pair: &[f64]| (pair[1] - pair[0]) / STEP_S;
        angles.windows(2).map(speed).collect()
    }

    /// Eight clips of every action for several seeds.
    fn sets() -> &'static [ClipSet] {
        static SETS: OnceLock<Vec<ClipSet>> = OnceLock::new();
        SETS.get_or_init(|| SEEDS.map(|seed| clip_set(seed, 8)).to_vec())
    }

    fn for_each_column(check: impl Fn(&Clip, Joint, &[f64])) {
        for clip in sets().iter().flat_map(|set| &set.clips) {
            for joint in Joint::ALL {
                check(clip, joint, &column(clip, joint));
            }
        }
    }

    fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
        let count = values.len().max(1) as f64;
        values.sum::<f64>() / count
    }

    #[test]
    fn no_clips_asked_for_gives_an_empty_set_with_a_layout() {
        let set = clip_set(1, 0);
        assert!(set.clips.is_empty());
        assert_eq!(set.layout.channel_count(), JOINT_COUNT);
    }

    #[test]
    fn every_action_has_its_clips_in_name_order() {
        let set = clip_set(3, 4);
        assert_eq!(set.clips.len(), 4 * action_labels().count());
        assert!(set.clips.is_sorted_by(|a, b| a.name < b.name));
        assert!(action_labels().is_sorted_by(|a, b| a < b));
        for clip in &set.clips {
            assert!(clip.name.starts_with(&clip.action), "{}", clip.name);
        }
    }

    #[test]
    fn every_clip_lasts_one_to_six_seconds_and_lengths_vary() {
        for set in sets() {
            let mut lengths = BTreeMap::<&str, Vec<usize>>::new();
            for clip in &set.clips {
                let frame_count = clip.frame_count(&set.layout);
                let possible = FRAME_COUNT_MIN..=FRAME_COUNT_MAX;
                assert!(possible.contains(&frame_count), "{}", clip.name);
                lengths.entry(&clip.action).or_default().push(frame_count);
            }
            for (action, mut counts) in lengths {
                counts.sort_unstable();
                assert!(counts[0] + 20 < counts[7], "{action}: {counts:?}");
            }
        }
    }

    #[test]
    fn every_angle_is_inside_its_mechanical_range() {
        for_each_column(|clip, joint, angles| {
            let spec = joint.spec();
            for angle in angles {
                let inside = spec.min_deg < *angle && *angle < spec.max_deg;
                assert!(inside, "{} {}: {angle}", clip.source.display(), spec.name);
            }
        });
    }

    #[test]
    fn no_servo_is_outrun() {
        for_each_column(|clip, joint, angles| {
            let spec = joint.spec();
            assert!(spec.speed_deg_per_s_max <= 400.0);
            for speed in speeds(angles) {
                let possible = speed.abs() <= spec.speed_deg_per_s_max;
                assert!(possible, "{} {}: {speed}", clip.source.display(), spec.name);
            }
        });
    }

    #[test]
    fn no_speed_jumps() {
        const LIGHT_DEG_PER_S2: f64 = 15_000.0;
        const HEAVY_DEG_PER_S2: f64 = 9_000.0;
        const LIGHT: [Joint; 4] = [Joint::Eyelid, Joint::Brow, Joint::Jaw, Joint::Whisk];
        for_each_column(|clip, joint, angles| {
            let is_light = LIGHT.contains(&joint);
            let limit = if is_light { LIGHT_DEG_PER_S2 } else { HEAVY_DEG_PER_S2 };
            for pair in speeds(angles).windows(2) {
                let acceleration = (pair[1] - pair[0]).abs() / STEP_S;
                let name = joint.spec().name;
                assert!(acceleration < limit, "{} {name}: {acceleration}", clip.name);
            }
        });
    }

    #[test]
    fn every_clip_starts_and_ends_at_rest_near_the_rest_pose() {
        for_each_column(|clip, joint, angles| {
            let (name, spec) = (clip.source.display(), joint.spec());
            let speeds = speeds(angles);
            for (angle, speed) in
                [(angles[0], speeds[0]), (angles[angles.len() - 1], speeds[speeds.len() - 1])]
            {
                assert!((angle - spec.rest_deg).abs() < 6.0, "{name} {}: {angle}", spec.name);
                assert!(speed.abs() < 12.0, "{name} {}: {speed}", spec.name);
            }
        });
    }

    #[test]
    fn every_angle_survives_a_csv_file_exactly() {
        for_each_column(|clip, _, angles| {
            for angle in angles {
                let text = format!("{angle:.2}");
                assert_eq!(text.parse::<f32>().ok(), Some(*angle as f32), "{}", clip.name);
                assert!(!text.starts_with("-0.00"), "{}", clip.name);
            }
        });
    }

    #[test]
    fn clips_hold_still_and_move_in_turn() {
        for set in sets() {
            for clip in &set.clips {
                let mut moving = vec![false; clip.poses.len() / JOINT_COUNT - 1];
                for joint in Joint::ALL {
                    let column_speeds = speeds(&column(clip, joint));
                    for (moves, speed) in moving.iter_mut().zip(column_speeds) {
                        *moves |= speed.abs() > 5.0;
                    }
                }
                let active = mean(moving.iter().map(|&moves| f64::from(moves)));
                assert!((0.2..0.99).contains(&active), "{}: {active}", clip.name);
            }
        }
    }

    #[test]
    fn clips_of_one_action_differ_visibly() {
        const VISIBLE_DEG: f64 = 3.0;
        let set = clip_set(DEFAULT_SEED, DEFAULT_CLIPS_PER_ACTION);
        for (index, a) in set.clips.iter().enumerate() {
            let same_action = |b: &&Clip| b.action == a.action;
            for b in set.clips[index + 1..].iter().filter(same_action) {
                let difference_deg = Joint::ALL
                    .iter()
                    .map(|&joint| {
                        let pairs = column(a, joint).into_iter().zip(column(b, joint));
                        let squares = pairs.map(|(a, b)| (a - b) * (a - b)).collect::<Vec<_>>();
                        mean(squares.into_iter()).sqrt()
                    })
                    .fold(0.0, f64::max);
                assert!(difference_deg > VISIBLE_DEG, "{} {}: {difference_deg}", a.name, b.name);
            }
        }
    }

    /// Per joint mean, lowest and highest angle, path length in degrees; then the length of the
    /// clip in seconds.
    fn features(clip: &Clip) -> Vec<f64> {
        let of_joint = |joint: Joint| {
            let angles = column(clip, joint);
            let low = angles.iter().copied().fold(f64::MAX, f64::min);
            let high = angles.iter().copied().fold(f64::MIN, f64::max);
            let path = speeds(&angles).iter().map(|s| s.abs() * STEP_S).sum();
            [mean(angles.iter().copied()), low, high, path]
        };
        let mut features = Joint::ALL.map(of_joint).concat();
        features.push(clip.poses.len() as f64 / JOINT_COUNT as f64 * STEP_S);
        features
    }

    #[test]
    fn the_nearest_centroid_names_the_action_of_clips_it_has_never_seen() {
        let known = clip_set(DEFAULT_SEED, DEFAULT_CLIPS_PER_ACTION).clips;
        let table = known.iter().map(features).collect::<Vec<_>>();
        let width = table[0].len();
        let center = |rows: &[&Vec<f64>], k: usize| mean(rows.iter().map(|row| row[k]));
        let all = table.iter().collect::<Vec<_>>();
        let scale = (0..width).map(|k| {
            let middle = center(&all, k);
            mean(all.iter().map(|row| (row[k] - middle) * (row[k] - middle))).sqrt() + 1e-9
        });
        let scale = scale.collect::<Vec<_>>();
        let centroids = action_labels().map(|label| {
            let of_action = known.iter().zip(&table).filter(|(clip, _)| clip.action == label);
            let rows = of_action.map(|(_, row)| row).collect::<Vec<_>>();
            let centroid = (0..width).map(|k| center(&rows, k)).collect::<Vec<_>>();
            (label, centroid)
        });
        let centroids = centroids.collect::<Vec<_>>();

        let unseen = clip_set(DEFAULT_SEED + 1, DEFAULT_CLIPS_PER_ACTION).clips;
        let distance = |row: &[f64], centroid: &[f64]| {
            let terms = row.iter().zip(centroid).zip(&scale);
            terms.map(|((a, b), s)| ((a - b) / s) * ((a - b) / s)).sum::<f64>()
        };
        let right = unseen.iter().filter(|clip| {
            let row = features(clip);
            let nearest = centroids
                .iter()
                .min_by(|(_, a), (_, b)| distance(&row, a).total_cmp(&distance(&row, b)));
            nearest.is_some_and(|(label, _)| *label == clip.action)
        });
        let accuracy = right.count() as f64 / unseen.len() as f64;
        println!("nearest centroid: {accuracy:.3}");
        assert!(accuracy > 0.9, "{accuracy}");
    }

    #[test]
    fn asking_for_more_clips_changes_none_of_the_first() {
        let few = clip_set(9, 2).clips;
        let many = clip_set(9, 5).clips;
        for clip in few {
            assert!(many.contains(&clip), "{}", clip.name);
        }
    }

    #[test]
    fn another_seed_gives_other_clips() {
        let (a, b) = (clip_set(1, 2).clips, clip_set(2, 2).clips);
        assert!(a.iter().zip(&b).all(|(a, b)| a.poses != b.poses));
    }

    /// A failure means that users' clips change: raise [`GENERATOR_VERSION`] and paste the new
    /// hash.
    #[test]
    fn the_built_in_clips_are_the_same_bits_on_every_machine() {
        let mut hash = Sha256::new();
        for clip in clip_set(DEFAULT_SEED, DEFAULT_CLIPS_PER_ACTION).clips {
            hash.update(clip.name.as_bytes());
            clip.poses.iter().for_each(|angle| hash.update(angle.to_le_bytes()));
        }
        let hex = hash.finalize().into_iter().map(|byte| format!("{byte:02x}"));
        assert_eq!(hex.collect::<String>(), GOLDEN_SHA256);
    }

    const GOLDEN_SHA256: &str = "f946bee1ff40edcc628d7f9ca9f39e47ed6b466087fd49d7af222068f561d92d";
}
