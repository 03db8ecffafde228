//! What a tick of the servo loop costs between two poses: player and servo stage.
//!
//! In:  channels, servos.
//! Out: instructions and RAM, to `plan.rs`.
//!
//! Why here: the one place for these numbers. **Instructions are rough estimates from the arithmetic, not counts**, and
//! every report says so while [`IS_MEASURED`] is false. RAM is what the types take.

use karakuri::Player;

use super::core_cost::Core;

/// Whether the numbers below were counted.
pub const IS_MEASURED: bool = false;

/// RAM of a player a channel more; asserted in core, beside the player.
const PLAYER_BYTES_PER_CHANNEL: usize = 24;

/// Instructions of one tick: always, a channel, a servo.
const fn instructions(core: Core) -> [u64; 3] {
    match core {
        // 64-bit products and quotients are calls there.
        Core::CortexM0Plus => [500, 150, 900],
        Core::CortexM4 | Core::CortexM7 | Core::CortexM33 => [300, 50, 300],
    }
}

/// Instructions of one tick.
pub fn tick_instructions(core: Core, channels: usize, servos: usize) -> u64 {
    let [always, per_channel, per_servo] = instructions(core);
    always + per_channel * channels as u64 + per_servo * servos as u64
}

/// RAM of a player with its servo stage, poses and codes, as laid out on this host: a little more than on a chip.
pub fn player_ram_bytes(channels: usize) -> usize {
    size_of::<Player<'static, 'static, 1>>() + PLAYER_BYTES_PER_CHANNEL * channels.saturating_sub(1)
}
