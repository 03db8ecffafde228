//! Random streams of a run, addressed by (seed, purpose, index).
//!
//! Why here: a step's numbers depend on nothing but the seed and the step's own index, so a resumed run goes on with
//! the same numbers and no generator state has to be saved.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// What a stream is for; streams of different purposes never overlap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Start weights of the decoder.
    Weights,
    /// Order of the clips in a pass.
    ClipOrder,
    /// Frames and noise of a step.
    Step,
    /// Inputs of `host-trainer bench`.
    Bench,
    /// Choice of the held-out clips of an action.
    HoldOut,
    /// Initial hidden state of the action classifier, one index a motion.
    HiddenStart,
    /// Which motions an evaluation scores, or a classifier learns from, and which frames of them.
    Crop,
    /// Pairs of motions whose distance an evaluation takes.
    Pairs,
}

/// The generator of one purpose and index.
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8] = purpose as u8;
    let mut rng = ChaCha8Rng::from_seed(key);
    rng.set_stream(index);
    rng
}
