//! What a performer is told, and when; and the loop that tells it, tick by tick.
//!
//! In:  cues in order of time, from `script.rs`; on the chip from flash.
//! Out: a servo command a tick, by one and the same loop on host and device.
//!
//! Why here: a file that both sides compile (see `case.rs`), so that an hour on the chip and an hour on the host are
//! told the same things at the same ticks.

use karakuri::{
    ActionId, BlobError, Decoder, Dials, Intent, Model, Overlay, OverlayKind, PlayError, Player,
    ServoCommand, ServoError, ServoStage, Workspace,
};

/// One thing to tell the performer before a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cue {
    /// The tick, counted from 0.
    pub tick: u32,
    /// What to tell.
    pub deed: Deed,
}

/// Everything that can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The words are those of `Player`.
pub enum Deed {
    Wake,
    Play {
        action: u16,
        duration_ms: u32,
        seed: u32,
        transition_ms: u16,
    },
    Then {
        action: u16,
        duration_ms: u32,
        seed: u32,
        transition_ms: u16,
    },
    /// Idle with the actions whose bits are set.
    Idle {
        actions: u64,
    },
    Hold,
    Resume,
    SoftStop,
    Relax,
    ClearFault,
    Dials(Dials),
    /// Lay a breath over one channel: crest in Q15.16 channel units.
    Breathe {
        channel: u16,
        crest_q16: i32,
        period_ms: u16,
    },
    /// The tick comes so much later than it should.
    Late {
        by_us: u32,
    },
    /// The supply fails: all state is lost, and everything begins anew with servos off.
    BrownOut,
    /// The commands of so many ticks are lost on the bus: a fault of the world, which the performer does not see.
    Lose {
        ticks: u32,
    },
}

impl Cue {
    /// Bytes of a stored cue: tick, kind, three numbers of 16, 32 and 32 bits, one of 16; little-endian.
    pub const BYTES: usize = 18;

    /// The stored form.
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let (kind, a, b, c, d): (u16, u16, u32, u32, u16) = match self.deed {
            Deed::Wake => (0, 0, 0, 0, 0),
            Deed::Play { action, duration_ms, seed, transition_ms } => {
                (1, action, duration_ms, seed, transition_ms)
            }
            Deed::Then { action, duration_ms, seed, transition_ms } => {
                (2, action, duration_ms, seed, transition_ms)
            }
            Deed::Idle { actions } => (3, 0, actions as u32, (actions >> 32) as u32, 0),
            Deed::Hold => (4, 0, 0, 0, 0),
            Deed::Resume => (5, 0, 0, 0, 0),
            Deed::SoftStop => (6, 0, 0, 0, 0),
            Deed::Relax => (7, 0, 0, 0, 0),
            Deed::ClearFault => (8, 0, 0, 0, 0),
            Deed::Dials(Dials { intensity_q12, rate_q12, stillness_q12, variety_q12 }) => {
                (9, intensity_q12, rate_q12.into(), stillness_q12.into(), variety_q12)
            }
            Deed::Breathe { channel, crest_q16, period_ms } => {
                (10, channel, crest_q16.cast_unsigned(), 0, period_ms)
            }
            Deed::Late { by_us } => (11, 0, by_us, 0, 0),
            Deed::BrownOut => (12, 0, 0, 0, 0),
            Deed::Lose { ticks } => (13, 0, ticks, 0, 0),
        };
        let mut bytes = [0; Self::BYTES];
        bytes[0..4].copy_from_slice(&self.tick.to_le_bytes());
        bytes[4..6].copy_from_slice(&kind.to_le_bytes());
        bytes[6..8].copy_from_slice(&a.to_le_bytes());
        bytes[8..12].copy_from_slice(&b.to_le_bytes());
        bytes[12..16].copy_from_slice(&c.to_le_bytes());
        bytes[16..18].copy_from_slice(&d.to_le_bytes());
        bytes
    }

    /// Reads the stored form back; an unknown kind is a [`Deed::Hold`].
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let half = |start: usize| u16::from_le_bytes([bytes[start], bytes[start + 1]]);
        let word = |start: usize| u32::from(half(start)) | u32::from(half(start + 2)) << 16;
        let (kind, a, b, c, d) = (half(4), half(6), word(8), word(12), half(16));
        let deed = match kind {
            0 => Deed::Wake,
            1 => Deed::Play { action: a, duration_ms: b, seed: c, transition_ms: d },
            2 => Deed::Then { action: a, duration_ms: b, seed: c, transition_ms: d },
            3 => Deed::Idle { actions: u64::from(b) | u64::from(c) << 32 },
            5 => Deed::Resume,
            6 => Deed::SoftStop,
            7 => Deed::Relax,
            8 => Deed::ClearFault,
            9 => Deed::Dials(Dials {
                intensity_q12: a,
                rate_q12: b as u16,
                stillness_q12: c as u16,
                variety_q12: d,
            }),
            10 => Deed::Breathe { channel: a, crest_q16: b.cast_signed(), period_ms: d },
            11 => Deed::Late { by_us: b },
            12 => Deed::BrownOut,
            13 => Deed::Lose { ticks: b },
            _ => Deed::Hold,
        };
        Self { tick: word(0), deed }
    }
}

/// How long and how fast to perform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stint {
    /// Ticks in all.
    pub tick_count: u32,
    /// Time between two ticks, µs.
    pub tick_us: u32,
    /// Frames of the model between two decoded poses.
    pub frames_per_key: u8,
    /// Seed of the idling.
    pub seed: u64,
}

impl Stint {
    /// Bytes of the stored form: ticks, µs, frames a key and seed, little-endian.
    pub const BYTES: usize = 20;

    /// The stored form.
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[0..4].copy_from_slice(&self.tick_count.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.tick_us.to_le_bytes());
        bytes[8] = self.frames_per_key;
        bytes[12..20].copy_from_slice(&self.seed.to_le_bytes());
        bytes
    }

    /// Reads the stored form back.
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let [a, b, c, d, e, f, g, h, frames_per_key, _, _, _, seed @ ..] = *bytes;
        Self {
            tick_count: u32::from_le_bytes([a, b, c, d]),
            tick_us: u32::from_le_bytes([e, f, g, h]),
            frames_per_key,
            seed: u64::from_le_bytes(seed),
        }
    }
}

/// Numbers of a command, for comparison: which servos were limited, then every pulse, 0 where released.
pub fn numbers(command: &ServoCommand) -> impl Iterator<Item = i32> {
    let pulses = command.pulses_us().iter();
    let pulses =
        pulses.map(|pulse_us| if command.is_released() { 0 } else { i32::from(*pulse_us) });
    core::iter::once(command.limited_servos().cast_signed()).chain(pulses)
}

/// Why there is no performance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The workspace does not fit the model.
    Blob(BlobError),
    /// The servos cannot be driven.
    Servo(ServoError),
    /// A motion that the model does not know, or too many channels; and the tick of its cue.
    Play(u32, PlayError),
}

/// Performs: before every tick its cues; then `on_tick` gets number, elapsed time and player, and has to tick it.
///
/// # Errors
/// [`Refusal`]; ticks before it have been handed over.
pub fn perform<const CHANNELS: usize, const WIDTH: usize>(
    model: &Model<'_>,
    workspace: &mut Workspace<WIDTH>,
    stint: Stint,
    cues: impl Iterator<Item = Cue>,
    mut on_tick: impl FnMut(u32, u32, &mut Player<'_, '_, CHANNELS>),
) -> Result<(), Refusal> {
    let mut cues = cues.peekable();
    let mut tick = 0;
    // One life after another, until the supply fails.
    while tick < stint.tick_count {
        let decoder = Decoder::new(model, workspace).map_err(Refusal::Blob)?;
        let stage = ServoStage::from_maps(model.servos()).map_err(Refusal::Servo)?;
        let player = Player::<CHANNELS>::new(
            model,
            decoder,
            stint.frames_per_key,
            stage,
            // Another life idles otherwise.
            stint.seed.wrapping_add(u64::from(tick)),
        );
        let mut player = player.map_err(|error| Refusal::Play(tick, error))?;
        'life: while tick < stint.tick_count {
            let mut elapsed_us = stint.tick_us;
            while let Some(cue) = cues.next_if(|cue| cue.tick <= tick) {
                match cue.deed {
                    Deed::Late { by_us } => elapsed_us = elapsed_us.saturating_add(by_us),
                    Deed::BrownOut => break 'life,
                    deed => tell(&mut player, deed).map_err(|error| Refusal::Play(tick, error))?,
                }
            }
            on_tick(tick, elapsed_us, &mut player);
            tick += 1;
        }
    }
    Ok(())
}

fn tell<const CHANNELS: usize>(
    player: &mut Player<'_, '_, CHANNELS>,
    deed: Deed,
) -> Result<(), PlayError> {
    let intent = |action, duration_ms, seed: u32, transition_ms| {
        Intent::new(ActionId(action), duration_ms, u64::from(seed)).over_ms(transition_ms)
    };
    match deed {
        Deed::Wake => player.wake(),
        Deed::Play { action, duration_ms, seed, transition_ms } => {
            player.play(intent(action, duration_ms, seed, transition_ms))?;
        }
        Deed::Then { action, duration_ms, seed, transition_ms } => {
            player.then(intent(action, duration_ms, seed, transition_ms))?;
        }
        Deed::Idle { actions } => {
            player.idle((0..64).filter(|bit| actions >> bit & 1 == 1).map(ActionId));
        }
        Deed::Hold => player.hold(),
        Deed::Resume => player.resume(),
        Deed::SoftStop => player.soft_stop(),
        Deed::Relax => player.relax(),
        Deed::ClearFault => player.clear_fault(),
        Deed::Dials(dials) => player.set_dials(dials),
        Deed::Breathe { channel, crest_q16, period_ms } => {
            let mut breath = Overlay::new(OverlayKind::Breathe { period_ms }, &[channel])?;
            breath.aim(&[crest_q16], 0);
            breath.fade(1 << 16, 3000);
            player.lay_over(breath)?;
        }
        Deed::Late { .. } | Deed::BrownOut | Deed::Lose { .. } => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_stint_is_read_back() {
        let stint = Stint {
            tick_count: 0x0102_0304,
            tick_us: 0x0506_0708,
            frames_per_key: 9,
            seed: u64::MAX - 5,
        };
        assert_eq!(Stint::from_bytes(&stint.to_bytes()), stint);
    }

    #[test]
    fn stored_cue_is_read_back() {
        let motion = (0x0102, 0x0304_0506, 0x0708_090a, 0x0b0c);
        let (action, duration_ms, seed, transition_ms) = motion;
        let deeds = [
            Deed::Wake,
            Deed::Play { action, duration_ms, seed, transition_ms },
            Deed::Then { action, duration_ms, seed, transition_ms },
            Deed::Idle { actions: 0x0102_0304_0506_0708 },
            Deed::Hold,
            Deed::Resume,
            Deed::SoftStop,
            Deed::Relax,
            Deed::ClearFault,
            Deed::Dials(Dials {
                intensity_q12: 1,
                rate_q12: 2,
                stillness_q12: 3,
                variety_q12: 0xffff,
            }),
            Deed::Breathe { channel: 7, crest_q16: -5, period_ms: 4000 },
            Deed::Late { by_us: 123_456 },
            Deed::BrownOut,
            Deed::Lose { ticks: 7 },
        ];
        for deed in deeds {
            let cue = Cue { tick: 0x0a0b_0c0d, deed };
            assert_eq!(Cue::from_bytes(&cue.to_bytes()), cue);
        }
    }
}
