//! Station 10: pose → servo command. The only way to a servo.
//!
//! In:  a [`Pose`] a tick, the calibration of every servo, the time since the last tick.
//! Out: a [`ServoCommand`] to whatever makes the pulses.
//!
//! Why here: the last place before the hardware. No pose, however wrong or late, may ask a servo for what it cannot do:
//! range, speed, acceleration and braking are `servo_limiter.rs`, between two aims `goal_path.rs` leads, and this file
//! decides whether to follow at all.
//!
//! **Not a safety-rated system.** It knows what servos were told, not where they are: after power-up an analogue servo
//! jumps to its first pulse, wherever it stood. Park the body by hand, and keep a hardware power cut.

use crate::error::ServoError;
use crate::fault::Fault;
use crate::goal_path::{GoalPath, PathWeights};
use crate::limits::SERVOS_MAX;
use crate::pose::Pose;
use crate::servo_command::ServoCommand;
use crate::servo_limiter::{STEP_US, ServoLimiter};
use crate::servo_map::{ServoMap, whole_us};
use crate::soft_start::SoftStart;

/// All servos of a robot: their calibration and motion. 88 bytes a servo, for as many as the limit allows; no heap.
#[derive(Clone, Debug)]
pub struct ServoStage {
    servos: heapless::Vec<Servo, SERVOS_MAX>,
    command: ServoCommand,
    mode: Mode,
    /// The next command is the first one: the park pose.
    is_parking: bool,
    fault: Option<Fault>,
    soft_start: SoftStart,
    /// How far the last step lies after the last tick.
    ahead_us: u32,
    /// Since the last aim.
    aim_age_us: u32,
    has_new_aim: bool,
    aim_age_us_max: u32,
}

#[derive(Clone, Debug)]
struct Servo {
    map: ServoMap,
    limiter: ServoLimiter,
    path: GoalPath,
    is_in_range: bool,
    /// Where a soft start began, Q16 µs.
    origin: i32,
    /// Goal of the last step, Q16 µs.
    goal: i32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// No pulses.
    Released,
    Following,
    Holding,
}

impl ServoStage {
    /// Longest time that one tick makes up for; after a longer pause servos still move only this far at once.
    pub const ELAPSED_US_MAX: u32 = 100_000;
    /// A tick that comes later than this latches [`Fault::LateTick`].
    pub const LATE_US: u32 = 250_000;
    /// Without a new aim for longer than this, [`Fault::StaleTarget`] is latched; see
    /// [`set_aim_age_us_max`](Self::set_aim_age_us_max).
    pub const AIM_AGE_US_MAX: u32 = 150_000;
    /// From the park pose to what is aimed at after [`enable`](Self::enable).
    pub const SOFT_START_US: u32 = SoftStart::FROM_PARK_STEPS as u32 * STEP_US;
    /// The same after [`resume`](Self::resume) and [`clear_fault`](Self::clear_fault), from where the servos stand.
    pub const SOFT_RESUME_US: u32 = SoftStart::FROM_STANDING_STEPS as u32 * STEP_US;

    /// Servos without pulses, until [`enable`](Self::enable).
    ///
    /// # Errors
    /// [`ServoError::TooMany`].
    pub fn new(maps: &[ServoMap]) -> Result<Self, ServoError> {
        Self::from_maps(maps.iter().copied())
    }

    /// [`new`](Self::new) from the servos of a blob: `Model::servos`.
    ///
    /// # Errors
    /// [`ServoError::TooMany`].
    pub fn from_maps(maps: impl IntoIterator<Item = ServoMap>) -> Result<Self, ServoError> {
        let mut stage = Self {
            servos: heapless::Vec::new(),
            command: ServoCommand::default(),
            mode: Mode::Released,
            is_parking: false,
            fault: None,
            soft_start: SoftStart::done(),
            ahead_us: 0,
            aim_age_us: 0,
            has_new_aim: false,
            aim_age_us_max: Self::AIM_AGE_US_MAX,
        };
        for map in maps {
            let count = stage.servos.len() + 1;
            let too_many = ServoError::TooMany { count, max: SERVOS_MAX };
            let limiter = ServoLimiter::new(&map);
            let at = limiter.position();
            let path = GoalPath::new(at);
            let servo = Servo { map, limiter, path, is_in_range: true, origin: at, goal: at };
            stage.servos.push(servo).map_err(|_| too_many)?;
            stage.command.push().map_err(|_| too_many)?;
        }
        Ok(stage)
    }

    /// Switches released servos on: the next command is the park pose, from which they then start softly (minimum jerk,
    /// [`SOFT_START_US`](Self::SOFT_START_US)) towards what is aimed at. Nothing happens where servos are on already or
    /// a fault is latched.
    ///
    /// Park poses are *declared*: a servo that stands elsewhere jumps there with its own speed.
    pub fn enable(&mut self) {
        if self.mode != Mode::Released || self.fault.is_some() {
            return;
        }
        self.mode = Mode::Following;
        self.is_parking = true;
        self.ahead_us = 0;
        self.aim_age_us = 0;
        for servo in &mut self.servos {
            servo.limiter = ServoLimiter::new(&servo.map);
            servo.start_here();
        }
        self.soft_start = SoftStart::from_park();
    }

    /// Where all servos should be at the end of the tick that follows; also tells the watchdog that somebody is there.
    /// A servo whose channel the pose does not have keeps its last target. While a fault is latched nothing happens.
    pub fn aim(&mut self, pose: &Pose) {
        if self.fault.is_some() {
            return;
        }
        self.has_new_aim = true;
        for servo in &mut self.servos {
            if let Some(asked) = servo.map.asked_q16(pose) {
                let goal = servo.map.in_range(asked);
                servo.is_in_range = asked == i64::from(goal);
                servo.path.aim(goal);
            }
        }
    }

    /// The command for now, `elapsed_us` after the last tick: of a counter that wraps, the wrapping difference.
    ///
    /// # Accuracy
    /// Where no limit intervenes and ticks are whole steps of 5 ms, within 0.5 µs of the pulse asked for, 0.29 µs RMS
    /// (asserted by `pulse_error_over_the_whole_range`). Over any number of ticks a pulse travels at most its speed
    /// limit, plus 1 µs for the rounding of both ends.
    ///
    /// # Cost
    /// A step every 5 ms and servo; a square root only where a limit binds. No division of 64 bits. Instructions for 11
    /// servos, every 5 ms or every 20 ms: 2,700 or 9,100 on a Cortex-M4, 7,000 or 22,000 on an M0+; up to a third more
    /// where limits bind. [`aim`](Self::aim) takes 770 and 1,610.
    pub fn tick(&mut self, elapsed_us: u32) -> &ServoCommand {
        match self.mode {
            Mode::Released => {}
            // However long nobody ticked: no time has passed at these pulses.
            _ if self.is_parking => {
                self.is_parking = false;
                self.write_pulses();
            }
            Mode::Following | Mode::Holding => {
                self.watch(elapsed_us);
                self.pass(elapsed_us.min(Self::ELAPSED_US_MAX));
                self.write_pulses();
            }
        }
        &self.command
    }

    /// Brakes and stands still, pulses on. Aims are heard but not followed.
    pub fn hold(&mut self) {
        if self.mode != Mode::Released {
            self.mode = Mode::Holding;
        }
    }

    /// Follows again after [`hold`](Self::hold): once all servos stand, softly from where they are
    /// ([`SOFT_RESUME_US`](Self::SOFT_RESUME_US)).
    pub fn resume(&mut self) {
        if self.mode == Mode::Holding {
            self.mode = Mode::Following;
            self.settle();
        }
    }

    /// Releases all servos at once, whatever state they are in: the next command has no pulses.
    pub fn relax(&mut self) {
        self.mode = Mode::Released;
        self.is_parking = false;
        self.command.release();
    }

    /// The command of the last tick.
    pub fn command(&self) -> &ServoCommand {
        &self.command
    }

    /// The calibration of every servo.
    pub fn maps(&self) -> impl Iterator<Item = &ServoMap> {
        self.servos.iter().map(|servo| &servo.map)
    }

    /// Whether no servo gets a pulse.
    pub fn is_released(&self) -> bool {
        self.mode == Mode::Released
    }

    /// Whether servos stand where they are: held, or because of a fault.
    pub fn is_holding(&self) -> bool {
        self.mode == Mode::Holding || (self.mode != Mode::Released && self.fault.is_some())
    }

    /// What was latched first, if anything is.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Brakes and stands still until [`clear_fault`](Self::clear_fault). The first fault stays; later ones are ignored.
    pub fn latch(&mut self, fault: Fault) {
        self.fault.get_or_insert(fault);
        if self.is_parking {
            self.relax();
        }
    }

    /// Forgets the fault. Servos that are on follow again as after [`resume`](Self::resume), unless they are held.
    pub fn clear_fault(&mut self) {
        if self.fault.take().is_some() {
            self.settle();
        }
    }

    /// Sets the longest time without a new aim, instead of [`AIM_AGE_US_MAX`](Self::AIM_AGE_US_MAX).
    pub fn set_aim_age_us_max(&mut self, aim_age_us_max: u32) {
        self.aim_age_us_max = aim_age_us_max;
    }

    /// Follows once all servos stand.
    fn settle(&mut self) {
        self.aim_age_us = 0;
        self.soft_start = SoftStart::from_standing();
    }

    /// Latches what is wrong with the time.
    fn watch(&mut self, elapsed_us: u32) {
        self.aim_age_us =
            if self.has_new_aim { 0 } else { self.aim_age_us.saturating_add(elapsed_us) };
        self.has_new_aim = false;
        if elapsed_us > Self::LATE_US {
            // Servos have long arrived at their last pulses.
            for servo in &mut self.servos {
                let shown = servo.limiter.position_before(self.ahead_us);
                servo.limiter.stand_at(shown);
            }
            self.ahead_us = 0;
            self.latch(Fault::LateTick);
        } else if self.mode == Mode::Following && self.aim_age_us > self.aim_age_us_max {
            self.latch(Fault::StaleTarget);
        }
    }

    /// All steps until the end of a tick, the last of them at it or up to 5 ms behind it.
    fn pass(&mut self, elapsed_us: u32) {
        if elapsed_us == 0 {
            return;
        }
        // Ticks between two steps show the interventions of the last one.
        if self.ahead_us < elapsed_us {
            self.command.clear();
        }
        while self.ahead_us < elapsed_us {
            self.ahead_us += STEP_US;
            if self.mode == Mode::Following && self.fault.is_none() {
                self.step(PathWeights::at(self.ahead_us, elapsed_us));
            } else {
                self.servos.iter_mut().for_each(|servo| servo.limiter.hold());
            }
        }
        self.ahead_us -= elapsed_us;
        self.servos.iter_mut().for_each(|servo| servo.path.pass());
    }

    /// One step of following.
    fn step(&mut self, weights: PathWeights) {
        if self.soft_start.waits_for_standing() {
            if !self.servos.iter().all(|servo| servo.limiter.is_standing()) {
                return self.servos.iter_mut().for_each(|servo| servo.limiter.hold());
            }
            self.servos.iter_mut().for_each(Servo::start_here);
        }
        let share = self.soft_start.step();
        for (index, servo) in self.servos.iter_mut().enumerate() {
            let aimed = servo.map.in_range(servo.path.at(weights));
            let goal = share.between(servo.origin, aimed);
            let intervention = servo.limiter.follow(servo.goal, goal);
            servo.goal = goal;
            self.command.note(index, servo.is_in_range, intervention);
        }
    }

    fn write_pulses(&mut self) {
        for (servo, pulse_us) in self.servos.iter().zip(self.command.pulses_us_mut()) {
            *pulse_us = whole_us(servo.limiter.position_before(self.ahead_us));
        }
    }
}

impl Servo {
    /// Where a soft start begins.
    fn start_here(&mut self) {
        self.origin = self.limiter.position();
        self.goal = self.origin;
    }
}

#[cfg(test)]
mod tests;
