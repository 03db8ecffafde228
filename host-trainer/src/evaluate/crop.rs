//! The papers' rule that makes motions of all lengths comparable: equally many poses, starting at the origin.
//!
//! In:  a motion's length and a random stream; then the poses of the window.
//! Out: [`Crops`], to the classifier and to every distance between motions.
//!
//! Why here: a window is drawn before anything is decoded, so a decoder with random access computes no pose that the
//! rule throws away.
//!
//! Source: Guo et al., Action2Motion, ACM MM 2020, and its public code: a random window of a longer motion; the last
//! pose repeated when it is shorter; minus the root of the first kept frame.

use rand::{Rng, RngExt};

use crate::classifier::example::Input;

/// The frames of a motion that are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// The first of them.
    pub first: usize,
    /// How many; less than those of a crop when the motion is shorter.
    pub count: usize,
}

impl Window {
    /// Any window of `frame_count` poses with equal chance; the whole motion when it is shorter.
    pub fn draw<R: Rng + ?Sized>(
        motion_frame_count: usize,
        frame_count: usize,
        rng: &mut R,
    ) -> Self {
        match motion_frame_count.checked_sub(frame_count) {
            Some(last) => Self { first: rng.random_range(0..=last), count: frame_count },
            None => Self { first: 0, count: motion_frame_count },
        }
    }
}

/// Motions of equally many poses; of bodies each minus its first root.
#[derive(Clone, Debug, PartialEq)]
pub struct Crops {
    /// Poses of every crop.
    pub frame_count: usize,
    /// Numbers of a pose: joints times 3.
    pub channel_count: usize,
    /// Whether the first three numbers of a pose are a root that crops start at.
    pub input: Input,
    /// Joints' x, y and z in metres, or channels. // (motion, frame, channel)
    pub positions: Vec<f32>,
    /// Where each was taken; poses beyond `count` repeat the last. // (motion)
    pub windows: Vec<Window>,
}

impl Crops {
    /// No motions yet.
    pub fn new(frame_count: usize, channel_count: usize, input: Input) -> Self {
        Self { frame_count, channel_count, input, positions: Vec::new(), windows: Vec::new() }
    }

    /// Appends the poses of a window, at least one; the root is joint 0. // poses: (frame of the window, channel)
    pub fn push(&mut self, window: Window, poses: &[f32]) {
        if poses.is_empty() {
            return;
        }
        let root: &[f32] = match self.input {
            Input::Joints => &poses[..3],
            Input::Channels => &[0.0],
        };
        let start = self.positions.len();
        self.positions
            .extend(poses.iter().zip(root.iter().cycle()).map(|(value, root)| value - root));
        let end = start + self.frame_count * self.channel_count;
        while self.positions.len() < end {
            let last = self.positions.len() - self.channel_count;
            self.positions.extend_from_within(last..);
        }
        self.windows.push(window);
    }

    /// Numbers of one motion.
    pub fn motion_len(&self) -> usize {
        self.frame_count * self.channel_count
    }

    /// Number of motions.
    pub fn motion_count(&self) -> usize {
        self.windows.len()
    }

    /// One motion. // (frame, channel)
    pub fn motion(&self, index: usize) -> &[f32] {
        &self.positions[index * self.motion_len()..][..self.motion_len()]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn short_motion_is_whole_and_repeats_its_last_pose() {
        let mut crops = Crops::new(4, 6, Input::Joints);
        let window = Window::draw(2, 4, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(window, Window { first: 0, count: 2 });
        let poses = [1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 2.0, 2.0, 3.0, 9.0, 9.0, 9.0];
        crops.push(window, &poses);
        let first = [0.0, 0.0, 0.0, 3.0, 4.0, 5.0];
        let last = [1.0, 0.0, 0.0, 8.0, 7.0, 6.0];
        assert_eq!(crops.motion(0), [first, last, last, last].concat());
    }

    #[test]
    fn servos_keep_their_angles() {
        let mut crops = Crops::new(2, 2, Input::Channels);
        crops.push(Window { first: 0, count: 2 }, &[5.0, 6.0, 7.0, 8.0]);
        assert_eq!(crops.motion(0), [5.0, 6.0, 7.0, 8.0]);
    }

    #[test]
    fn every_window_of_a_long_motion_is_drawn_the_last_one_too() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut counts = [0; 6];
        for _ in 0..600 {
            let window = Window::draw(65, 60, &mut rng);
            assert_eq!(window.count, 60);
            counts[window.first] += 1;
        }
        assert!(counts.iter().all(|&count| (60..150).contains(&count)), "{counts:?}");
    }

    proptest! {
        #[test]
        fn crop_starts_at_the_origin_wherever_the_motion_stands(
            motion_frame_count in 1_usize..90,
            offset in -3.0_f32..3.0,
            seed: u64,
        ) {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let window = Window::draw(motion_frame_count, 30, &mut rng);
            prop_assert!(window.first + window.count <= motion_frame_count);
            let value = |index: usize| (index as f32 * 0.7).sin() + offset;
            let poses: Vec<f32> = (0..window.count * 6).map(value).collect();
            let mut crops = Crops::new(30, 6, Input::Joints);
            crops.push(window, &poses);
            prop_assert_eq!(crops.positions.len(), 30 * 6);
            prop_assert_eq!(&crops.motion(0)[..3], &[0.0; 3]);
            let between = poses[3] - poses[0];
            prop_assert_eq!(crops.motion(0)[3], between);
        }
    }
}
