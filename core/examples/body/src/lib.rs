//! The body that all examples move: a model, its servos, and a player that does as it likes.
//!
//! Why here: this is the same on every chip. Put your own blob and your own servos here, and nothing else changes.

#![no_std]

use karakuri::{ActionId, Decoder, Model, Player, ServoLimits, ServoMap, ServoStage, Workspace};

/// Servos, and channels of the pose: one a joint.
pub const JOINTS: usize = 11;

/// Microseconds from one tick to the next: 50 a second, as fast as analogue servos listen.
pub const TICK_US: u32 = 20_000;

/// A player of this body.
pub type Body<'m, 'w> = Player<'m, 'w, JOINTS>;

/// What decoding writes to: as wide as `host-trainer inspect` says that the model is.
pub type Space = Workspace<96>;

/// The kernels in assembly load whole words.
#[repr(align(16))]
struct Aligned<Bytes: ?Sized>(Bytes);

/// From `host-trainer quantize`.
static BLOB: &Aligned<[u8]> =
    &Aligned(*include_bytes!("../../../../tests/golden/creature-tiny-w8a16.kara"));

/// The model, checked.
///
/// # Panics
/// Where the blob above is wrong: at the first start, not later.
pub fn model() -> Model<'static> {
    Model::from_bytes(&BLOB.0).expect("a blob of this version")
}

/// The body, released: no servo gets a pulse before `wake`.
///
/// # Panics
/// Where the sizes or the calibration above are wrong: at the first start, not later.
pub fn body<'m, 'w>(model: &'m Model<'m>, space: &'w mut Space, seed: u64) -> Body<'m, 'w> {
    let decoder = Decoder::new(model, space).expect("a workspace as wide as the model");
    let limits = ServoLimits { pulse_us_per_s_max: 4_000, pulse_us_per_s2_max: 40_000 };
    // 10 µs a degree about 1500 µs: measure your own.
    let servo = |channel| ServoMap::new(channel, [700, 1500, 2300], 10 << 16, limits);
    let servos = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10].map(|joint| servo(joint).expect("in order"));
    let stage = ServoStage::new(&servos).expect("as many servos as fit");
    let mut body = Player::new(model, decoder, 2, stage, seed).expect("as many channels as joints");
    body.idle((0..model.manifest().action_count).map(ActionId));
    body
}
