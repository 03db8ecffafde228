//! What a tick of the servo loop costs between two poses: player and servo stage.
//!
//! In:  channels, servos.
//! Out: instructions and RAM, to `plan.rs`.
//!
//! Why here: the one place for these numbers. They follow counts of ticks in a motion that need no pose:
//!
//! ```text
//! firmware-sim perform MODEL --script FILE --minutes 0.16 --tick-hz 100 --target cortex-m4 --count
//! ```
//!
//! with the script `0 wake; 0.2 idle all; 0.3 dial stillness 0.3; 2 play nod 2 seed 7 over 300; 5 play greet 3 seed
//! 9 over 400`, of the golden `w8a16` with 1 and 11 servos, of a model with 72 channels (idling only), and at 50
//! ticks a second with `--frames-per-key 2`. Player and stage are portable integer code, so the M7 and M33 are as
//! the M4. RAM is what the types take.

use karakuri::Player;

use super::core_cost::Core;

/// Steps a second of each servo, whatever the rate of ticks.
const STEPS_HZ: u64 = 200;

/// RAM of a player a channel more; asserted in core, beside the player.
const PLAYER_BYTES_PER_CHANNEL: usize = 24;

/// Instructions of player and servo stage, without poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickCost {
    /// Of every tick.
    pub per_tick: u64,
    /// Of a second, for the steps of all servos.
    pub per_s: u64,
}

impl TickCost {
    /// Of a model with so many channels and a body with so many servos.
    pub fn new(core: Core, channels: usize, servos: usize) -> Self {
        let [always, per_channel, per_servo, per_step, per_servo_step] = counts(core);
        let (channels, servos) = (channels as u64, servos as u64);
        Self {
            per_tick: always + per_channel * channels + per_servo * servos,
            per_s: STEPS_HZ * (per_step + per_servo_step * servos),
        }
    }

    /// Instructions of a tick, so many a second.
    pub fn instructions_at(&self, tick_hz: u64) -> u64 {
        self.per_tick + self.per_s / tick_hz.max(1)
    }
}

/// Instructions of one tick: always, a channel, a servo; of one step: always, a servo.
const fn counts(core: Core) -> [u64; 5] {
    match core {
        // 64-bit products are calls there.
        Core::CortexM0Plus => [2064, 296, 325, 224, 499],
        Core::CortexM4 | Core::CortexM7 | Core::CortexM33 => [726, 100, 115, 58, 211],
    }
}

/// RAM of a player with its servo stage, poses and codes, as laid out on this host: a little more than on a chip.
pub fn player_ram_bytes(channels: usize) -> usize {
    size_of::<Player<'static, 'static, 1>>() + PLAYER_BYTES_PER_CHANNEL * channels.saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What was counted: core, channels, servos, ticks a second, instructions.
    const COUNTED: [(Core, usize, usize, u64, u64); 14] = [
        (Core::CortexM4, 11, 1, 100, 2484),
        (Core::CortexM4, 11, 6, 100, 5071),
        (Core::CortexM4, 11, 11, 100, 7853),
        (Core::CortexM4, 11, 1, 50, 3021),
        (Core::CortexM4, 11, 11, 50, 12_608),
        (Core::CortexM4, 72, 11, 100, 13_979),
        // Another model of another calibration.
        (Core::CortexM4, 11, 11, 50, 12_795),
        (Core::CortexM0Plus, 11, 1, 100, 7089),
        (Core::CortexM0Plus, 11, 6, 100, 13_161),
        (Core::CortexM0Plus, 11, 11, 100, 20_324),
        (Core::CortexM0Plus, 11, 1, 50, 8536),
        (Core::CortexM0Plus, 11, 11, 50, 31_752),
        (Core::CortexM0Plus, 72, 11, 100, 38_398),
        (Core::CortexM0Plus, 11, 11, 50, 31_048),
    ];

    #[test]
    fn ticks_are_those_counted_within_five_percent() {
        for (core, channels, servos, tick_hz, counted) in COUNTED {
            let modelled = TickCost::new(core, channels, servos).instructions_at(tick_hz);
            let share = (modelled as f64 / counted as f64 - 1.0).abs();
            assert!(share < 0.05, "{channels}, {servos}, {tick_hz}: {modelled}, counted {counted}");
        }
    }
}
