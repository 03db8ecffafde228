//! The performer: from intentions to servo commands, for hours.
//!
//! In:  what to do and how ([`Intent`], [`Dials`], [`Overlay`]s); the time since the last tick.
//! Out: a [`ServoCommand`] a tick, and [`Event`]s.
//!
//! Why here: what a builder puts into firmware is not a decoder. A player never repeats itself, moves on from wherever
//! the body is, and ends at the servo stage, whose limits nothing here can pass. It reads no clock and no random
//! source: the same seed and the same calls give the same commands on every chip.

use crate::decoder::Decoder;
use crate::dials::Dials;
use crate::error::PlayError;
use crate::fault::Fault;
use crate::idle::Idle;
use crate::intent::{Event, Intent};
use crate::limits::{EVENTS_MAX, OVERLAYS_MAX, QUEUE_MAX};
use crate::model::{ActionId, Model};
use crate::overlay::Overlay;
use crate::pose::Pose;
use crate::servo::ServoStage;
use crate::servo_command::ServoCommand;
use crate::voice::Voice;

/// What a player is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlayerState {
    /// The servos are off.
    Released,
    /// A fault is latched: the body holds still until [`Player::clear_fault`].
    Faulted(Fault),
    /// Told to hold: time stands until [`Player::resume`].
    Held,
    /// In a motion.
    Moving(ActionId),
    /// Between motions.
    Resting,
}

/// Time of a [`Player::soft_stop`], µs.
const SOFT_STOP_US: u32 = 700_000;
/// A hold takes an eighth of a second to stop time, and a resume to start it. Q16 per second.
const FLOW_SLEW_PER_S_Q16: u64 = 8 << 16;

/// A character: a body that moves ([`Voice`]), what lies over it, and the servos.
///
/// `CHANNELS`: at least those of the model. 6.3 KB with nine channels, 24 bytes more with each further one (asserted by
/// `player_is_as_large_as_its_documentation_says`), beside the workspace of its decoder; no heap.
#[derive(Debug)]
pub struct Player<'m, 'w, const CHANNELS: usize> {
    voice: Voice<'m, 'w, CHANNELS>,
    stage: ServoStage,
    overlays: heapless::Vec<Overlay, OVERLAYS_MAX>,
    queue: heapless::Deque<Intent, QUEUE_MAX>,
    events: heapless::Deque<Event, EVENTS_MAX>,
    idle: Idle,
    dials: Dials,
    /// The motion under way.
    motion: Option<Intent>,
    /// Its rate beside the dial's, Q4.12: 1 but for motions of the character's own.
    haste_q12: u16,
    /// Time of the motion up to which markers have been told.
    marked_us: u32,
    is_held: bool,
    /// How fast time flows for the body, Q16: 0 while it holds.
    flow_q16: u32,
    flow_rest_q16: u32,
    fault: Option<Fault>,
}

impl<'m, 'w, const CHANNELS: usize> Player<'m, 'w, CHANNELS> {
    /// A character whose servos are off until [`wake`](Self::wake). `seed` is that of its idling.
    ///
    /// `frames_per_key`: frames of the model between two decoded poses, see [`Voice::new`].
    ///
    /// # Errors
    /// [`PlayError::TooManyChannels`].
    pub fn new(
        model: &'m Model<'m>,
        decoder: Decoder<'m, 'w>,
        frames_per_key: u8,
        stage: ServoStage,
        seed: u64,
    ) -> Result<Self, PlayError> {
        Ok(Self {
            voice: Voice::new(model, decoder, frames_per_key)?,
            stage,
            overlays: heapless::Vec::new(),
            queue: heapless::Deque::new(),
            events: heapless::Deque::new(),
            idle: Idle::new(seed),
            dials: Dials::NEUTRAL,
            motion: None,
            haste_q12: Dials::ONE_Q12,
            marked_us: 0,
            is_held: false,
            flow_q16: 1 << 16,
            flow_rest_q16: 0,
            fault: None,
        })
    }

    /// Plays a motion at once, in place of whatever is going on; what waits is forgotten.
    ///
    /// # Errors
    /// [`PlayError::Sample`]; the body then goes on as before.
    pub fn play(&mut self, intent: Intent) -> Result<(), PlayError> {
        self.begin(intent, self.dials)?;
        self.queue.clear();
        Ok(())
    }

    /// Plays a motion after all that wait already.
    ///
    /// # Errors
    /// [`PlayError::Sample`], [`PlayError::QueueFull`].
    pub fn then(&mut self, intent: Intent) -> Result<(), PlayError> {
        let model = self.voice.model();
        model.check_request(intent.action, intent.frames(model.rate_millihz()))?;
        self.queue.push_back(intent).map_err(|_| PlayError::QueueFull { max: QUEUE_MAX })
    }

    /// Lets the character live on its own between motions: these actions now and then, as [`Dials::stillness_q12`]
    /// says. Actions from number 64 on are left out; no action ends it.
    pub fn idle(&mut self, actions: impl IntoIterator<Item = ActionId>) {
        self.idle.set_actions(actions);
    }

    /// Stops time: the body comes to a stand within an eighth of a second, in the midst of its motion.
    pub fn hold(&mut self) {
        self.is_held = true;
    }

    /// Goes on after a [`hold`](Self::hold).
    pub fn resume(&mut self) {
        self.is_held = false;
    }

    /// Ends everything gently: the motion runs out within 0.7 s, what waits is forgotten, idling ends. Overlays stay.
    pub fn soft_stop(&mut self) {
        self.forget();
        self.voice.settle(SOFT_STOP_US);
    }

    /// Releases the servos at once: no pulses, no torque. [`wake`](Self::wake) is the way back.
    pub fn relax(&mut self) {
        self.stage.relax();
        self.forget();
        self.voice.settle(1);
    }

    /// Switches the servos on: they are sent to their park pose, then softly to the body's. Nothing where they are on.
    pub fn wake(&mut self) {
        self.stage.enable();
    }

    /// Forgets the latched fault; the body goes on softly.
    pub fn clear_fault(&mut self) {
        self.stage.clear_fault();
        self.fault = None;
    }

    /// Latches a fault of the caller's own: a hot servo, a lost link.
    pub fn latch(&mut self, fault: Fault) {
        self.stage.latch(fault);
    }

    /// Turns the dials, each as far as it goes.
    pub fn set_dials(&mut self, dials: Dials) {
        self.dials = dials.clamped();
    }

    /// The dials as they are.
    pub fn dials(&self) -> Dials {
        self.dials
    }

    /// Lays something over the body, above what lies there already; the number is that of
    /// [`overlay_mut`](Self::overlay_mut).
    ///
    /// # Errors
    /// [`PlayError::TooManyOverlays`].
    pub fn lay_over(&mut self, overlay: Overlay) -> Result<usize, PlayError> {
        let error = PlayError::TooManyOverlays { count: OVERLAYS_MAX + 1, max: OVERLAYS_MAX };
        self.overlays.push(overlay).map_err(|_| error)?;
        Ok(self.overlays.len() - 1)
    }

    /// An overlay, to be aimed or faded.
    pub fn overlay_mut(&mut self, index: usize) -> Option<&mut Overlay> {
        self.overlays.get_mut(index)
    }

    /// The oldest event that has not been taken yet.
    pub fn take_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// What the body does.
    pub fn state(&self) -> PlayerState {
        match (&self.motion, self.stage.fault()) {
            _ if self.stage.is_released() => PlayerState::Released,
            (_, Some(fault)) => PlayerState::Faulted(fault),
            _ if self.is_held => PlayerState::Held,
            (Some(motion), _) => PlayerState::Moving(motion.action),
            (None, _) => PlayerState::Resting,
        }
    }

    /// The pose of the last tick, overlays and all, before the servos' limits.
    pub fn pose(&self) -> &Pose {
        self.voice.pose()
    }

    /// The command of the last tick.
    pub fn command(&self) -> &ServoCommand {
        self.stage.command()
    }

    /// The model.
    pub fn model(&self) -> &'m Model<'m> {
        self.voice.model()
    }

    /// Lets `elapsed_us` pass since the last tick and tells the servos where to be.
    ///
    /// A tick that comes late makes up for [`ServoStage::ELAPSED_US_MAX`] at most: the body falls behind rather than
    /// leaping. See [`ServoStage::tick`] for when that becomes a fault.
    pub fn tick(&mut self, elapsed_us: u32) -> &ServoCommand {
        self.tick_with(elapsed_us, |_| ())
    }

    /// [`tick`](Self::tick) with a last word on the pose: a second voice, or inverse kinematics of your own.
    pub fn tick_with(&mut self, elapsed_us: u32, compose: impl FnOnce(&mut Pose)) -> &ServoCommand {
        let body_us = self.flow(elapsed_us.min(ServoStage::ELAPSED_US_MAX));
        self.voice.advance(body_us, self.rate_q12());
        self.tell_markers();
        if self.voice.is_resting() {
            self.choose(body_us);
        }
        let pose = self.voice.pose_mut();
        for overlay in &mut self.overlays {
            overlay.apply(body_us, pose);
        }
        compose(pose);
        self.stage.aim(pose);
        self.stage.tick(elapsed_us);
        self.tell_fault();
        self.stage.command()
    }

    /// Speed of the body's time, Q4.12.
    fn rate_q12(&self) -> u16 {
        ((u32::from(self.dials.rate_q12) * u32::from(self.haste_q12)) >> 12) as u16
    }

    fn begin(&mut self, intent: Intent, dials: Dials) -> Result<(), PlayError> {
        let frames = intent.frames(self.voice.model().rate_millihz());
        let transition_us = u32::from(intent.transition_ms) * 1000;
        self.voice.begin(intent.action, frames, intent.seed, dials, transition_us)?;
        let haste_q12 = (u32::from(dials.rate_q12) << 12) / u32::from(self.dials.rate_q12.max(1));
        self.haste_q12 = haste_q12.min(u32::from(2 * Dials::ONE_Q12)) as u16;
        self.tell(Event::Started(intent.action));
        self.marked_us = 0;
        self.motion = Some(intent);
        Ok(())
    }

    /// At rest: the end of a motion, the next one that waits, or one of the character's own.
    fn choose(&mut self, body_us: u32) {
        if let Some(motion) = self.motion.take() {
            self.tell(Event::Finished(motion.action));
            let at_rate = u64::from(self.voice.duration_us()) * u64::from(Dials::ONE_Q12);
            let motion_us = at_rate / u64::from(self.rate_q12().max(1));
            let motion_us = u32::try_from(motion_us).unwrap_or(u32::MAX);
            self.idle.rest_after(motion_us, self.dials.stillness_q12);
        }
        let next = match self.queue.pop_front() {
            None => self.idle.wait(body_us, self.dials, self.voice.model()),
            Some(waiting) => Some((waiting, self.dials)),
        };
        if let Some((intent, dials)) = next {
            // Checked when it was queued; one of idling that falls between two intervals is drawn again next tick.
            let _ = self.begin(intent, dials);
        }
    }

    fn forget(&mut self) {
        self.queue.clear();
        self.idle.stop();
        self.motion = None;
    }

    /// The body's share of the time: all of it, or none while it holds, and a smooth course between.
    fn flow(&mut self, elapsed_us: u32) -> u32 {
        let stands = self.is_held || self.stage.fault().is_some();
        let step = (u64::from(elapsed_us) * FLOW_SLEW_PER_S_Q16 / 1_000_000) as u32;
        self.flow_q16 = match stands {
            true => self.flow_q16.saturating_sub(step),
            false => self.flow_q16.saturating_add(step).min(1 << 16),
        };
        let passed =
            u64::from(elapsed_us) * u64::from(self.flow_q16) + u64::from(self.flow_rest_q16);
        self.flow_rest_q16 = (passed & 0xFFFF) as u32;
        (passed >> 16) as u32
    }

    fn tell_markers(&mut self) {
        let Some(motion) = &self.motion else {
            return;
        };
        let at_end = self.voice.is_resting();
        let now_us = if at_end { u32::MAX } else { self.voice.motion_us() };
        let passed = self.marked_us..now_us;
        for marker in &motion.markers {
            let at_us = u64::from(marker.at_ms) * 1000;
            if at_us < u64::from(passed.end) && at_us >= u64::from(passed.start) {
                push(&mut self.events, Event::Marker(marker.id));
            }
        }
        self.marked_us = now_us;
    }

    fn tell_fault(&mut self) {
        let fault = self.stage.fault();
        if let (Some(fault), true) = (fault, fault != self.fault) {
            self.tell(Event::Faulted(fault));
        }
        self.fault = fault;
    }

    fn tell(&mut self, event: Event) {
        push(&mut self.events, event);
    }
}

/// Pushes the oldest event out where no room is left.
fn push(events: &mut heapless::Deque<Event, EVENTS_MAX>, event: Event) {
    if events.is_full() {
        let _ = events.pop_front();
    }
    let _ = events.push_back(event);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::SampleError;
    use crate::manifest::SamplerKind;
    use crate::overlay::OverlayKind;
    use crate::random::Pcg32;
    use crate::servo_map::{ServoLimits, ServoMap};
    use crate::specimen::specimen;
    use crate::{NumberFormat, Workspace};
    use std::vec::Vec;

    const TICK_US: u32 = 20_000;
    const LIMITS: ServoLimits =
        ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };

    fn maps() -> [ServoMap; 3] {
        [0, 1, 3].map(|channel| {
            ServoMap::new(channel, [500, 1500, 2500], 10 << 16, LIMITS)
                .unwrap()
                .with_park_at(1200)
                .unwrap()
        })
    }

    /// Runs a test with a character of four channels and three servos, awake.
    fn with_player<Outcome>(
        seed: u64,
        test: impl FnOnce(&mut Player<'_, '_, 4>) -> Outcome,
    ) -> Outcome {
        let kind = SamplerKind::NearestClips { clip_count: 2, row_bytes: 2 };
        let blob = specimen(NumberFormat::W8A16, kind);
        let model = Model::from_bytes(&blob).unwrap();
        let mut workspace = Workspace::<8>::new();
        let decoder = Decoder::new(&model, &mut workspace).unwrap();
        let stage = ServoStage::new(&maps()).unwrap();
        let mut player = Player::new(&model, decoder, 1, stage, seed).unwrap();
        player.wake();
        test(&mut player)
    }

    /// 20 frames of action 0.
    fn intent(player: &Player<'_, '_, 4>, seed: u64) -> Intent {
        let duration_ms = 20 * 1_000_000 / player.model().rate_millihz();
        Intent::new(ActionId(0), duration_ms, seed)
    }

    fn run(player: &mut Player<'_, '_, 4>, ticks: u32) {
        for _ in 0..ticks {
            player.tick(TICK_US);
        }
    }

    fn events(player: &mut Player<'_, '_, 4>) -> Vec<Event> {
        core::iter::from_fn(|| player.take_event()).collect()
    }

    #[test]
    fn motion_that_cannot_be_drawn_is_refused_and_the_body_goes_on() {
        with_player(1, |player| {
            player.play(intent(player, 3)).unwrap();
            run(player, 10);
            let state = player.state();
            assert_eq!(state, PlayerState::Moving(ActionId(0)));
            for wrong in [Intent::new(ActionId(9), 1000, 1), Intent::new(ActionId(0), 999_999, 1)] {
                assert!(matches!(player.play(wrong.clone()), Err(PlayError::Sample(_))));
                assert!(matches!(player.then(wrong), Err(PlayError::Sample(_))));
            }
            assert_eq!(player.state(), state);
            let unknown = PlayError::Sample(SampleError::UnknownAction { action: 9, count: 2 });
            assert_eq!(player.play(Intent::new(ActionId(9), 1, 1)), Err(unknown));
        });
    }

    #[test]
    fn more_motions_and_overlays_than_fit_are_refused() {
        with_player(1, |player| {
            for _ in 0..QUEUE_MAX {
                player.then(intent(player, 1)).unwrap();
            }
            assert_eq!(
                player.then(intent(player, 1)),
                Err(PlayError::QueueFull { max: QUEUE_MAX })
            );
            let overlay = || Overlay::new(OverlayKind::Add, &[0]).unwrap();
            for index in 0..OVERLAYS_MAX {
                assert_eq!(player.lay_over(overlay()), Ok(index));
            }
            assert!(player.lay_over(overlay()).is_err());
        });
    }

    #[test]
    fn motions_follow_each_other_and_tell_their_markers() {
        with_player(1, |player| {
            player.play(intent(player, 3).mark(0, 1).mark(100, 2).mark(1_000_000, 3)).unwrap();
            player.then(intent(player, 4).mark(50, 4)).unwrap();
            let mut told = Vec::new();
            for _ in 0..2000 {
                run(player, 1);
                told.append(&mut events(player));
            }
            let action = ActionId(0);
            let expected = [
                Event::Started(action),
                Event::Marker(1),
                Event::Marker(2),
                Event::Marker(3),
                Event::Finished(action),
                Event::Started(action),
                Event::Marker(4),
                Event::Finished(action),
            ];
            assert_eq!(told, expected);
            assert_eq!(player.state(), PlayerState::Resting);
        });
    }

    #[test]
    fn body_that_holds_stands_still_and_goes_on_where_it_was() {
        with_player(1, |player| {
            player.play(intent(player, 3)).unwrap();
            run(player, 8);
            player.hold();
            run(player, 7);
            let pose = player.pose().clone();
            run(player, 500);
            assert_eq!((player.pose(), player.state()), (&pose, PlayerState::Held));
            player.resume();
            run(player, 5);
            assert_ne!(*player.pose(), pose);
            assert_eq!(player.state(), PlayerState::Moving(ActionId(0)));
        });
    }

    #[test]
    fn soft_stop_ends_everything_and_relax_switches_off() {
        with_player(1, |player| {
            player.idle([ActionId(0)]);
            player.then(intent(player, 3)).unwrap();
            run(player, 20);
            player.soft_stop();
            run(player, 40);
            let pose = player.pose().clone();
            run(player, 5000);
            assert_eq!((player.pose(), player.state()), (&pose, PlayerState::Resting));
            player.relax();
            assert!(player.tick(TICK_US).is_released());
            assert_eq!(player.state(), PlayerState::Released);
            player.wake();
            assert_eq!(player.tick(0).pulses_us(), [1200; 3]);
        });
    }

    #[test]
    fn late_tick_is_a_fault_until_it_is_cleared() {
        with_player(1, |player| {
            player.play(intent(player, 3)).unwrap();
            run(player, 8);
            player.tick(10_000_000);
            let fault = Fault::LateTick;
            assert_eq!(player.state(), PlayerState::Faulted(fault));
            let command = player.command().clone();
            run(player, 100);
            assert_eq!(player.command().pulses_us(), command.pulses_us());
            assert_eq!(events(player), [Event::Started(ActionId(0)), Event::Faulted(fault)]);
            player.clear_fault();
            run(player, 200);
            assert_ne!(player.command().pulses_us(), command.pulses_us());
        });
    }

    #[test]
    fn same_seed_and_calls_give_the_same_commands_and_another_seed_others() {
        let course = |seed| {
            with_player(seed, |player| {
                player.idle([ActionId(0), ActionId(1)]);
                let tick = |_| player.tick(TICK_US).pulses_us().to_vec();
                (0..3000).map(tick).collect::<Vec<_>>()
            })
        };
        assert_eq!(course(5), course(5));
        assert_ne!(course(5), course(6));
    }

    #[test]
    fn idle_body_rests_for_the_share_that_the_dial_says() {
        for (stillness_q12, expected) in [(1024, 0.25), (2731, 0.667), (3686, 0.9)] {
            with_player(7, |player| {
                player.set_dials(Dials { stillness_q12, ..Dials::NEUTRAL });
                player.idle([ActionId(0), ActionId(1)]);
                let (mut resting, count) = (0, 200_000);
                for _ in 0..count {
                    player.tick(TICK_US);
                    resting += u32::from(player.state() == PlayerState::Resting);
                }
                let share = f64::from(resting) / f64::from(count);
                assert!((share - expected).abs() < 0.03, "{share}, expected {expected}");
            });
        }
    }

    #[test]
    fn player_is_as_large_as_its_documentation_says() {
        let bytes = |channels: usize| match channels {
            9 => size_of::<Player<'_, '_, 9>>(),
            _ => size_of::<Player<'_, '_, 73>>(),
        };
        assert!(bytes(9) <= 6300 && bytes(73) - bytes(9) == 64 * 24, "{}", bytes(9));
        assert!(size_of::<Voice<'_, '_, 9>>() <= 2450);
        assert_eq!(
            [size_of::<Overlay>(), size_of::<Intent>(), size_of::<crate::Marker>()],
            [160, 56, 8]
        );
    }

    #[test]
    fn breath_goes_on_while_the_body_rests() {
        with_player(1, |player| {
            let mut breath = Overlay::new(OverlayKind::Breathe { period_ms: 3000 }, &[3]).unwrap();
            breath.aim(&[4 << 16], 0);
            breath.fade(1 << 16, 500);
            player.lay_over(breath).unwrap();
            run(player, 300);
            let pulses: Vec<u16> = (0..150).map(|_| player.tick(TICK_US).pulses_us()[2]).collect();
            assert_eq!((pulses.iter().min(), pulses.iter().max()), (Some(&1460), Some(&1540)));
        });
    }

    #[test]
    fn last_word_on_the_pose_is_heard() {
        with_player(1, |player| {
            for _ in 0..300 {
                player.tick_with(TICK_US, |pose| pose.channels[0] = 30 << 16);
            }
            assert_eq!(player.command().pulses_us()[0], 1800);
        });
    }

    /// Everything that can be called, in any order, at any pace.
    #[test]
    fn no_calls_whatever_make_a_command_leave_its_range_or_speed() {
        let mut random = Pcg32::new(9);
        with_player(1, |player| {
            let mut last: Option<Vec<u16>> = None;
            for _ in 0..300_000u32 {
                call(player, &mut random);
                let elapsed_us = match random.next_u32() % 50 {
                    0 => 0,
                    1 => random.next_u32(),
                    2 => random.next_u32() % 300_000,
                    _ => 1 + random.next_u32() % 30_000,
                };
                let command = player.tick(elapsed_us);
                let pulses = (!command.is_released()).then(|| command.pulses_us().to_vec());
                if let (Some(last), Some(pulses)) = (&last, &pulses) {
                    let way = u64::from(elapsed_us.min(100_000)) * 6000 / 1_000_000 + 1;
                    for (before, now) in last.iter().zip(pulses) {
                        assert!((500..=2500).contains(now), "{now}");
                        assert!(
                            u64::from(before.abs_diff(*now)) <= way,
                            "{before}, {now} in {elapsed_us}"
                        );
                    }
                }
                last = pulses;
            }
        });
    }

    fn call(player: &mut Player<'_, '_, 4>, random: &mut Pcg32) {
        let number = random.next_u32();
        match random.next_u32() % 40 {
            0..=3 => drop(player.play(intent(player, number.into()).over_ms(number as u16))),
            4 => drop(player.then(intent(player, number.into()))),
            5 => player.hold(),
            6..=7 => player.resume(),
            8 => player.soft_stop(),
            9 => player.relax(),
            10..=11 => player.wake(),
            12..=13 => player.clear_fault(),
            14 => player.latch(Fault::External(number as u8)),
            15 => player.idle([ActionId(number as u16 % 70)]),
            16 => player.set_dials(Dials {
                intensity_q12: number as u16,
                rate_q12: (number >> 8) as u16,
                stillness_q12: (number >> 16) as u16,
                variety_q12: (number >> 4) as u16,
            }),
            17 => {
                let overlay = Overlay::new(OverlayKind::Replace, &[number as u16 % 5]).unwrap();
                let _ = player.lay_over(overlay);
            }
            18 => {
                if let Some(overlay) = player.overlay_mut(number as usize % OVERLAYS_MAX) {
                    overlay.aim(&[number.cast_signed()], (number >> 20) as u16);
                    overlay.fade(number, (number >> 10) as u16);
                }
            }
            _ => {}
        }
    }
}
