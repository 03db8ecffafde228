//! Every maximum of the device side, in one place.
//!
//! Why here: no heap means that somebody chose the sizes. A blob that needs more is refused by name at load.

/// Layers of a decoder, the code half and the time half of layer 1 counted apart.
pub const LAYERS_MAX: usize = 10;

/// Channels of one pose; a [`Pose`](crate::Pose) takes 4 bytes for each.
pub const CHANNELS_MAX: usize = 256;

/// Servos of one robot; a [`ServoStage`](crate::ServoStage) takes 88 bytes for each. Two PCA9685 (16 outputs
/// each, 4.9 µs a step at 50 Hz) side by side on one I²C bus; a desk creature has about a dozen.
pub const SERVOS_MAX: usize = 32;

/// Channels of one [`Overlay`](crate::Overlay): a gaze has three or four, a breath about as many.
pub const OVERLAY_CHANNELS_MAX: usize = 8;

/// Overlays of one [`Player`](crate::Player), 160 bytes each: breath, gaze, lids and jaw.
pub const OVERLAYS_MAX: usize = 4;

/// Motions that wait in a [`Player`](crate::Player), 56 bytes each.
pub const QUEUE_MAX: usize = 4;

/// Markers of one motion, 8 bytes each.
pub const MARKERS_MAX: usize = 4;

/// Events of a [`Player`](crate::Player) that nobody has taken yet; more push the oldest out.
pub const EVENTS_MAX: usize = 8;

/// Numbers of one code, sequence part and action part together; a [`Code`](crate::Code) takes 2 bytes for each.
pub const CODE_MAX: usize = 512;

/// Sinusoids of the time embedding (two per frequency).
pub const SINUSOIDS_MAX: usize = 512;

/// Inputs or outputs of any one layer.
pub const WIDTH_MAX: usize = 4096;

/// Groups of a layout, actions, and joints of a skeleton: none is stored in RAM, the limit only rejects nonsense.
pub const NAMES_MAX: usize = 1024;

// The time half of layer 1 must be able to leave room for the folded code half in a 32-bit accumulator.
const _: () = assert!(127 * SINUSOIDS_MAX as i64 * 32_767 < i32::MAX as i64);
