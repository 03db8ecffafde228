//! Station 11: a character on the host, in virtual time, with servos that are not there.
//!
//! In:  a [`Model`] with the calibration of its servos, cues, [`Options`].
//! Out: a [`Performance`]: every tick, and what is to be known of the hour.
//!
//! Why here: an hour takes seconds, and everything that a builder fears (a limit broken, a loop, a body that never
//! rests) can be counted before there is a body.

mod clips;
mod monitor;
mod on_chip;
mod picture;
mod repeat;
mod summary;
mod tick_counts;

use std::iter;

use indicatif::ProgressBar;
use karakuri::limits::CHANNELS_MAX;
use karakuri::{Event, Model, PlayerState, Pose, ServoMap};

use crate::cue::{Cue, Deed, Refusal, Stint, numbers, perform};
use crate::error::{BLOB, Error, Result};
use crate::host::widest_workspace;
use crate::virtual_servo::{HOBBY_SERVO, VirtualServo};

pub use clips::clip_courses;
pub use monitor::{Monitor, Violation};
pub use on_chip::{COUNTED_TICKS_MAX, ChipPerformance, perform_on_chip, program_input};
pub use picture::draw;
pub use repeat::{Course, NearestRepeat, WINDOW_S, nearest_repeat};
pub use summary::{Summary, summarize};
pub use tick_counts::InstructionsPerTick;

/// One tick of a performance.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Since the first tick, by the clock that the performer does not read, s.
    pub time_s: f64,
    /// What the performer was told had passed, µs.
    pub elapsed_us: u32,
    /// Pulses; `None` where released.
    pub pulses_us: Vec<Option<u16>>,
    /// Bit i: a limit held servo i back.
    pub limited: u32,
    /// Whether a motion was under way, told or of the character's own.
    pub in_motion: bool,
    /// Whether one began within the tick: of the character's own, or one that waited.
    pub begins_motion: bool,
    /// Where the horns are, µs.
    pub horns_us: Vec<f64>,
    /// The pose before the servos' limits: channels that servos follow, in channel units.
    pub channels: Vec<f32>,
}

/// An hour, or any other time.
#[derive(Clone, Debug, PartialEq)]
pub struct Performance {
    /// How long and how fast.
    pub stint: Stint,
    /// First to last.
    pub ticks: Vec<Tick>,
    /// What each tick comes to on any machine, see [`numbers`]. // (tick, number)
    pub numbers: Vec<Vec<i32>>,
    /// Commands that broke a limit.
    pub violations: Vec<Violation>,
}

/// Performs on the host; `progress` counts ticks.
///
/// # Errors
/// [`Error::BadInput`]: a model without servos, or a cue that the performer refuses.
pub fn perform_on_host(
    model: &Model<'_>,
    stint: Stint,
    cues: &[Cue],
    progress: &ProgressBar,
) -> Result<Performance> {
    let maps = servos(model)?;
    let channels = followed_channels(model);
    let mut world = World::new(maps, cues);
    let mut workspace = widest_workspace();
    progress.set_length(stint.tick_count.into());
    let played = perform::<CHANNELS_MAX, _>(
        model,
        &mut workspace,
        stint,
        cues.iter().copied(),
        |tick, elapsed_us, player| {
            while player.take_event().is_some() {}
            let numbers: Vec<i32> = numbers(player.tick(elapsed_us)).collect();
            let begins_motion = iter::from_fn(|| player.take_event())
                .any(|event| matches!(event, Event::Started(_)));
            let in_motion = matches!(player.state(), PlayerState::Moving(_));
            world.take(tick, elapsed_us, numbers);
            if let Some(tick) = world.ticks.last_mut() {
                (tick.in_motion, tick.begins_motion) = (in_motion, begins_motion);
                tick.channels = followed(player.pose(), &channels);
            }
            if tick % 1000 == 0 {
                progress.set_position(tick.into());
            }
        },
    );
    played.map_err(refused)?;
    let World { ticks, numbers, violations, .. } = world;
    Ok(Performance { stint, ticks, numbers, violations })
}

/// The servos that the blob was calibrated for.
///
/// # Errors
/// [`Error::BadInput`]: it was not.
pub fn servos(model: &Model<'_>) -> Result<Vec<ServoMap>> {
    let maps: Vec<ServoMap> = model.servos().collect();
    if maps.is_empty() {
        let remedy = "put the robot's servos into it: \
            `host-trainer calibrate MODEL.kara --calibration FILE --out NEW.kara`";
        return Err(Error::bad_input(BLOB, "number of servos", 0, "a calibrated blob", remedy));
    }
    Ok(maps)
}

/// Names of the groups whose channels the servos follow; several servos of a rotation have numbers behind it.
pub fn servo_names(model: &Model<'_>) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for map in model.servos() {
        let mut first = 0;
        let group = model.groups().find(|group| {
            first += group.kind.channel_count();
            usize::from(map.channel()) < first
        });
        let name = group.map_or("servo", |group| group.name).to_owned();
        let same = names.iter().filter(|other| other.split('.').next() == Some(&name)).count();
        names.push(if same == 0 { name } else { format!("{name}.{}", same + 1) });
    }
    names
}

/// Channels of the groups that servos follow, ascending.
pub(crate) fn followed_channels(model: &Model<'_>) -> Vec<usize> {
    let starts: Vec<usize> = model.servos().map(|map| usize::from(map.channel())).collect();
    let (mut first, mut channels) = (0, Vec::new());
    for group in model.groups() {
        let end = first + group.kind.channel_count();
        if starts.iter().any(|start| (first..end).contains(start)) {
            channels.extend(first..end);
        }
        first = end;
    }
    channels
}

pub(crate) fn followed(pose: &Pose, channels: &[usize]) -> Vec<f32> {
    let value =
        |&channel: &usize| pose.channels().get(channel).map_or(0.0, |&q16| q16 as f32 / 65_536.0);
    channels.iter().map(value).collect()
}

fn refused(refusal: Refusal) -> Error {
    let (field, value) = match refusal {
        Refusal::Blob(error) => return error.into(),
        Refusal::Servo(error) => ("servos".to_owned(), error.to_string()),
        Refusal::Play(tick, error) => (format!("cue of tick {tick}"), error.to_string()),
    };
    Error::bad_input("performance", field, value, "what the performer can do", "change the script")
}

/// What is outside the chip: servos, a bus that loses commands, a judge.
struct World {
    servos: Vec<VirtualServo>,
    monitor: Monitor,
    /// First tick and number of those whose commands are lost.
    losses: Vec<(u32, u32)>,
    sent: Vec<Option<u16>>,
    time_us: u64,
    ticks: Vec<Tick>,
    numbers: Vec<Vec<i32>>,
    violations: Vec<Violation>,
}

impl World {
    fn new(maps: Vec<ServoMap>, cues: &[Cue]) -> Self {
        let losses = cues.iter().filter_map(|cue| match cue.deed {
            Deed::Lose { ticks } => Some((cue.tick, ticks)),
            _ => None,
        });
        let parked = |map: &ServoMap| VirtualServo::new(HOBBY_SERVO, map.pulse_us_park().into());
        Self {
            servos: maps.iter().map(parked).collect(),
            sent: vec![None; maps.len()],
            monitor: Monitor::new(maps),
            losses: losses.collect(),
            time_us: 0,
            ticks: Vec::new(),
            numbers: Vec::new(),
            violations: Vec::new(),
        }
    }

    fn take(&mut self, tick: u32, elapsed_us: u32, numbers: Vec<i32>) {
        self.time_us += u64::from(elapsed_us);
        let pulse = |number: &i32| u16::try_from(*number).ok().filter(|pulse_us| *pulse_us > 0);
        let pulses_us: Vec<Option<u16>> = numbers[1..].iter().map(pulse).collect();
        self.violations.append(&mut self.monitor.judge(tick, elapsed_us, &pulses_us));
        let is_lost =
            self.losses.iter().any(|(first, count)| (*first..first + count).contains(&tick));
        if !is_lost {
            self.sent.clone_from(&pulses_us);
        }
        let elapsed_s = f64::from(elapsed_us) / 1e6;
        let horns = self.servos.iter_mut().zip(&self.sent);
        let horns_us = horns.map(|(servo, pulse_us)| servo.tick(*pulse_us, elapsed_s)).collect();
        self.ticks.push(Tick {
            time_s: self.time_us as f64 / 1e6,
            elapsed_us,
            pulses_us,
            limited: numbers[0].cast_unsigned(),
            in_motion: false,
            begins_motion: false,
            horns_us,
            channels: Vec::new(),
        });
        self.numbers.push(numbers);
    }
}
