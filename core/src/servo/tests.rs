//! What a stage must do when it is told to: tick by tick, from outside.

use super::*;
use crate::random::Pcg32;
use crate::rotation::{Axis, AxisOrder};
use crate::servo_map::ServoLimits;

mod random_ticks;

const ONE_Q16: i32 = 1 << 16;
const TICK_US: u32 = 20_000;
/// A hobby servo.
const LIMITS: ServoLimits = ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };
/// Across the range in a step.
const AT_ONCE: ServoLimits =
    ServoLimits { pulse_us_per_s_max: 1_600_000, pulse_us_per_s2_max: u32::MAX };

fn pose(channels: &[i32]) -> Pose {
    Pose { channels: channels.iter().copied().collect() }
}

/// 10 µs per degree about 1500 µs.
fn map(limits: ServoLimits) -> ServoMap {
    ServoMap::new(0, [500, 1500, 2500], 10 * ONE_Q16, limits).unwrap()
}

/// Follows, the soft start behind it, at neutral.
fn following(maps: &[ServoMap]) -> ServoStage {
    let mut stage = ServoStage::new(maps).unwrap();
    stage.enable();
    run(&mut stage, &pose(&[0; 16]), 120);
    stage
}

/// The command after so many ticks of a constant target.
fn run(stage: &mut ServoStage, pose: &Pose, ticks: usize) -> ServoCommand {
    for _ in 0..ticks {
        stage.aim(pose);
        stage.tick(TICK_US);
    }
    stage.command().clone()
}

#[test]
fn more_servos_than_the_limit_are_rejected() {
    assert!(ServoStage::new(&[map(LIMITS); SERVOS_MAX]).is_ok());
    let error = ServoStage::new(&[map(LIMITS); SERVOS_MAX + 1]).unwrap_err();
    assert_eq!(error, ServoError::TooMany { count: SERVOS_MAX + 1, max: SERVOS_MAX });
}

#[test]
fn new_stage_gives_no_pulses_until_it_is_enabled() {
    let mut stage = ServoStage::new(&[map(LIMITS); 2]).unwrap();
    assert_eq!(run(&mut stage, &pose(&[ONE_Q16]), 100).pulses_us(), [0, 0]);
    assert!(stage.is_released() && stage.command().is_released() && stage.fault().is_none());
}

#[test]
fn first_command_is_the_park_pose_however_long_nobody_ticked() {
    let parked = map(LIMITS).with_park_at(1234).unwrap();
    let mut stage = ServoStage::new(&[parked, map(LIMITS)]).unwrap();
    stage.aim(&pose(&[90 * ONE_Q16]));
    for hold in [false, true] {
        stage.relax();
        stage.enable();
        if hold {
            stage.hold();
        }
        assert_eq!(stage.tick(u32::MAX).pulses_us(), [1234, 1500]);
        assert_eq!((stage.fault(), stage.is_holding()), (None, hold));
    }
}

#[test]
fn soft_start_reaches_the_target_after_its_time_and_is_half_way_in_the_middle() {
    let mut stage = ServoStage::new(&[map(LIMITS).with_park_at(900).unwrap()]).unwrap();
    stage.enable();
    let target = pose(&[60 * ONE_Q16]);
    assert_eq!(run(&mut stage, &target, 1).pulses_us(), [900]);
    assert_eq!(run(&mut stage, &target, 50).pulses_us(), [1500]);
    assert_eq!(run(&mut stage, &target, 49).pulses_us(), [2100]);
    assert_eq!(run(&mut stage, &target, 1).pulses_us(), [2100]);
    assert_eq!(stage.command().limited_servos(), 0);
}

#[test]
fn servo_whose_channel_is_missing_keeps_its_target() {
    let mut stage = following(&[map(LIMITS)]);
    assert_eq!(run(&mut stage, &pose(&[ONE_Q16]), 5).pulses_us(), [1510]);
    assert_eq!(run(&mut stage, &pose(&[]), 5).pulses_us(), [1510]);
}

#[test]
fn servo_whose_rotation_is_cut_off_stays() {
    let map = map(LIMITS);
    for map in [map.following_angle(AxisOrder::Zyx, Axis::X), map.following_twist(Axis::X)] {
        let mut stage = ServoStage::new(&[map]).unwrap();
        stage.enable();
        assert_eq!(run(&mut stage, &pose(&[0, 1, 2, 3, 4]), 200).pulses_us(), [1500]);
    }
}

#[test]
fn direction_neutral_and_limits_are_those_of_the_map() {
    let reversed = ServoMap::new(1, [900, 1500, 2100], -10 * ONE_Q16, LIMITS).unwrap();
    let width = ServoMap::new(2, [500, 1500, 2500], ONE_Q16, AT_ONCE).unwrap();
    let width = width.with_neutral_at(1500 * ONE_Q16);
    let mut stage = following(&[map(AT_ONCE), reversed, width]);
    run(&mut stage, &pose(&[0, 0, 1500 * ONE_Q16]), 50);
    let asked = pose(&[200 * ONE_Q16, 30 * ONE_Q16, 1800 * ONE_Q16]);
    let command = run(&mut stage, &asked, 1);
    assert_eq!(
        [0, 1, 2, 99].map(|servo| command.is_range_limited(servo)),
        [true, false, false, false]
    );
    let is_late = [0, 1, 2, 99].map(|servo| command.is_acceleration_limited(servo));
    assert_eq!(is_late, [false, true, false, false]);
    assert_eq!(command.limited_servos(), 0b11);
    assert_eq!(run(&mut stage, &asked, 40).pulses_us(), [2500, 1200, 1800]);
    let far = run(&mut stage, &pose(&[0, -50 * ONE_Q16, 0]), 7);
    assert!(far.is_speed_limited(1) && !far.is_speed_limited(99));
}

#[test]
fn target_that_stops_coming_brakes_and_latches() {
    let mut stage = following(&[map(LIMITS)]);
    run(&mut stage, &pose(&[90 * ONE_Q16]), 6);
    for _ in 0..7 {
        stage.tick(TICK_US);
        assert_eq!(stage.fault(), None);
    }
    let at_us = stage.tick(TICK_US).pulses_us()[0];
    assert_eq!(stage.fault(), Some(Fault::StaleTarget));
    let still = run(&mut stage, &pose(&[-90 * ONE_Q16]), 10);
    assert_eq!(run(&mut stage, &pose(&[-90 * ONE_Q16]), 100), still);
    assert!(still.pulses_us()[0] >= at_us);
    stage.clear_fault();
    assert_eq!(run(&mut stage, &pose(&[-90 * ONE_Q16]), 100).pulses_us(), [600]);
}

#[test]
fn loop_that_stood_still_stops_at_once_and_latches() {
    let mut stage = following(&[map(LIMITS)]);
    let before = run(&mut stage, &pose(&[90 * ONE_Q16]), 8);
    stage.aim(&pose(&[90 * ONE_Q16]));
    assert_eq!(stage.tick(250_001).pulses_us(), before.pulses_us());
    assert_eq!(stage.fault(), Some(Fault::LateTick));
    assert_eq!(run(&mut stage, &pose(&[0]), 20).pulses_us(), before.pulses_us());
    stage.latch(Fault::External(3));
    assert_eq!(stage.fault(), Some(Fault::LateTick), "the first fault stays");
}

#[test]
fn relax_releases_at_once_even_with_a_fault_and_enabling_waits_for_it_to_be_cleared() {
    let mut stage = following(&[map(LIMITS)]);
    run(&mut stage, &pose(&[90 * ONE_Q16]), 8);
    stage.latch(Fault::Link);
    stage.relax();
    assert!(stage.command().is_released() && stage.tick(0).is_released());
    stage.enable();
    assert!(stage.tick(TICK_US).is_released());
    stage.clear_fault();
    assert!(stage.tick(TICK_US).is_released());
    stage.enable();
    assert_eq!(stage.tick(TICK_US).pulses_us(), [1500]);
}

#[test]
fn fault_before_the_first_pulse_prevents_it() {
    let mut stage = ServoStage::new(&[map(LIMITS)]).unwrap();
    stage.enable();
    stage.latch(Fault::Blob);
    assert!(stage.tick(TICK_US).is_released());
}

#[test]
fn held_servo_stays_through_a_cleared_fault_and_resumes_softly() {
    let mut stage = following(&[map(LIMITS)]);
    run(&mut stage, &pose(&[30 * ONE_Q16]), 20);
    stage.hold();
    stage.latch(Fault::External(0));
    stage.clear_fault();
    assert!(stage.is_holding());
    // No watchdog where nobody is followed.
    (0..50).for_each(|_| _ = stage.tick(TICK_US));
    assert_eq!((stage.fault(), stage.command().pulses_us()[0]), (None, 1800));
    stage.resume();
    assert_eq!(run(&mut stage, &pose(&[0]), 25).pulses_us(), [1650]);
    assert_eq!(run(&mut stage, &pose(&[0]), 25).pulses_us(), [1500]);
}

/// 300 µs at 1 Hz at 60 Hz, no multiple of a step: what is sent is as smooth as what is aimed at.
#[test]
fn tick_rate_that_is_no_multiple_of_a_step_does_not_jitter() {
    let at_us = |time_us: u32| 300.0 * libm::sin(f64::from(time_us) / 1e6 * core::f64::consts::TAU);
    let mut stage = following(&[map(LIMITS)]);
    let (mut time_us, mut worst_us) = (0, 0.0);
    for tick in 0..600 {
        let elapsed_us = [16_667, 16_666, 16_667][tick % 3];
        time_us += elapsed_us;
        stage.aim(&pose(&[(at_us(time_us) * 6553.6) as i32]));
        let pulse_us = stage.tick(elapsed_us).pulses_us()[0];
        if tick > 12 {
            worst_us = f64::max(worst_us, (f64::from(pulse_us) - 1500.0 - at_us(time_us)).abs());
            assert_eq!(stage.command().limited_servos(), 0, "tick {tick}");
        }
    }
    assert!(worst_us < 0.8, "{worst_us}");
}

#[test]
fn slow_limit_does_not_stall() {
    let limits = ServoLimits { pulse_us_per_s_max: 1, pulse_us_per_s2_max: 1 };
    let mut stage = following(&[map(limits)]);
    // 100 s at 1 µs/s, after 1 s of acceleration.
    let pulse_us = run(&mut stage, &pose(&[i32::MAX]), 5000).pulses_us()[0];
    assert!((1598..=1600).contains(&pulse_us), "{pulse_us}");
}

#[test]
fn size_is_what_the_documentation_says() {
    assert!(size_of::<Servo>() <= 88, "{}", size_of::<Servo>());
    assert!(size_of::<ServoCommand>() <= 88, "{}", size_of::<ServoCommand>());
}
