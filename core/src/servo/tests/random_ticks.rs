//! What a stage must never do, whatever poses, clocks and programs bring.

use super::*;
use proptest::prelude::*;
use std::vec::Vec;

/// A builder's calibration, whatever it is.
fn any_map(random: &mut Pcg32) -> ServoMap {
    let shifted = |random: &mut Pcg32| random.next_u32() >> (random.next_u32() % 32);
    loop {
        let mut pulses_us = [(); 3].map(|()| 1 + (random.next_u32() % 20_000) as u16);
        pulses_us.sort_unstable();
        let limits = match random.next_u32() % 2 {
            0 => LIMITS,
            _ => ServoLimits {
                pulse_us_per_s_max: shifted(random),
                pulse_us_per_s2_max: shifted(random),
            },
        };
        let channel = (random.next_u32() % 4) as u16;
        let Ok(map) = ServoMap::new(channel, pulses_us, random.next_u32() as i32, limits) else {
            continue;
        };
        let park_us = pulses_us[0] + (random.next_u32() % 20_000) as u16;
        return map.with_park_at(park_us).unwrap_or(map);
    }
}

/// Whatever a decoder and a clock may bring.
fn any_tick(random: &mut Pcg32, channels: &mut [i32; 4]) -> u32 {
    for channel in channels {
        *channel = match random.next_u32() % 12 {
            0 => i32::MAX,
            1 => i32::MIN,
            2 => random.next_u32() as i32,
            3 => 0,
            // The other end.
            4 => !*channel,
            5..8 => channel.wrapping_add(random.next_u32() as i32 >> 14),
            _ => *channel,
        };
    }
    match random.next_u32() % 64 {
        0 => 0,
        // A counter of 32 bits that wrapped between two ticks, or stood still.
        1 => 12_345u32.wrapping_sub(u32::MAX - random.next_u32() % 40_000),
        2 => random.next_u32(),
        3 => random.next_u32() % 300_000,
        4..10 => 1 + random.next_u32() % 4_000,
        10..20 => 16_667,
        20..40 => 20_000,
        _ => 5_000,
    }
}

/// Whatever a program may call.
fn any_call(random: &mut Pcg32, stage: &mut ServoStage, channels: &[i32; 4]) {
    match random.next_u32() % 512 {
        0 => stage.hold(),
        1..4 => stage.resume(),
        4 => stage.relax(),
        5..12 => stage.enable(),
        12 => stage.latch(Fault::External(1)),
        13..32 => stage.clear_fault(),
        // A tick without an aim.
        32..64 => {}
        64 => stage.aim(&pose(&channels[..2])),
        _ => stage.aim(&pose(channels)),
    }
}

fn velocities(stage: &ServoStage) -> Vec<(i32, i32)> {
    stage.servos.iter().map(|servo| servo.limiter.velocity_and_change_max()).collect()
}

/// What a tick must not do, whatever came before: of every servo the pulse, and the change of velocity.
fn check_tick(stage: &ServoStage, last: &ServoCommand, were: &[(i32, i32)], elapsed_us: u32) {
    let is_late = elapsed_us > ServoStage::LATE_US;
    let elapsed_us = u64::from(elapsed_us.min(ServoStage::ELAPSED_US_MAX));
    let steps = 1 + elapsed_us / 5_000;
    let pulses_us = stage.command.pulses_us().iter().zip(last.pulses_us());
    let now = velocities(stage);
    for ((servo, (&pulse_us, &last_us)), (was, now)) in
        stage.servos.iter().zip(pulses_us).zip(were.iter().zip(now))
    {
        if stage.is_released() {
            assert_eq!(pulse_us, 0);
            continue;
        }
        let [min_us, _, max_us] = servo.map.pulses_us();
        assert!((min_us..=max_us).contains(&pulse_us));
        if last_us == 0 {
            assert_eq!(pulse_us, servo.map.pulse_us_park(), "the first pulse");
            continue;
        }
        let travel_us = u64::from(pulse_us.abs_diff(last_us)).saturating_sub(1);
        let speed = u64::from(servo.map.limits().pulse_us_per_s_max);
        // And 2^-16 µs of the line between two steps.
        let way_us = speed * elapsed_us + 50;
        assert!(travel_us * 1_000_000 <= way_us, "{travel_us} us in {elapsed_us} us, {servo:?}");
        let change = u64::from(now.0.abs_diff(was.0));
        assert!(is_late && now.0 == 0 || change <= steps * u64::from(was.1 as u32));
    }
}

/// 4,000,000 ticks of three servos each: 1000 robots.
#[test]
fn no_command_leaves_range_speed_or_acceleration_whatever_happens() {
    let mut random = Pcg32::new(5);
    for robot in 0..1000 {
        // Half of them are only aimed at and never wait long: they get beyond their soft start.
        let is_calm = robot % 2 == 0;
        let maps = [(); 3].map(|()| any_map(&mut random));
        let mut stage = ServoStage::new(&maps).unwrap();
        let mut channels = [0; 4];
        stage.enable();
        for _ in 0..4000 {
            let mut elapsed_us = any_tick(&mut random, &mut channels);
            if is_calm {
                elapsed_us = elapsed_us.min(ServoStage::ELAPSED_US_MAX);
                stage.aim(&pose(&channels));
            } else {
                any_call(&mut random, &mut stage, &channels);
            }
            let (last, were) = (stage.command.clone(), velocities(&stage));
            let was_parking = stage.is_parking;
            stage.tick(elapsed_us);
            let last = if was_parking { ServoStage::new(&maps).unwrap().command } else { last };
            check_tick(&stage, &last, &were, elapsed_us);
        }
        assert!(!is_calm || stage.fault().is_none());
    }
}

#[test]
fn same_calls_give_the_same_commands() {
    let commands = |seed| {
        let mut random = Pcg32::new(seed);
        let maps = [(); 3].map(|()| any_map(&mut random));
        let mut stage = ServoStage::new(&maps).unwrap();
        let mut channels = [0; 4];
        let command = |_| {
            let elapsed_us = any_tick(&mut random, &mut channels);
            any_call(&mut random, &mut stage, &channels);
            stage.tick(elapsed_us).clone()
        };
        (0..2000).map(command).collect::<Vec<_>>()
    };
    for seed in 0..10 {
        assert_eq!(commands(seed), commands(seed));
    }
}

proptest! {
    #[test]
    fn speed_holds_over_any_number_of_ticks(seed: u64) {
        let mut random = Pcg32::new(seed);
        let map = any_map(&mut random);
        let mut stage = ServoStage::new(&[map]).unwrap();
        let mut channels = [0; 4];
        stage.enable();
        stage.tick(0);
        // Pulse, and time counted by the stage.
        let mut course = Vec::from([(map.pulse_us_park(), 0u64)]);
        for _ in 0..200 {
            let elapsed_us = any_tick(&mut random, &mut channels);
            stage.aim(&pose(&channels));
            stage.clear_fault();
            let pulse_us = stage.tick(elapsed_us).pulses_us()[0];
            let time_us = course.last().unwrap().1;
            course.push((pulse_us, time_us + u64::from(elapsed_us.min(100_000))));
        }
        for (index, &(from_us, start_us)) in course.iter().enumerate() {
            for &(to_us, end_us) in &course[index..] {
                let travel_us = u128::from(from_us.abs_diff(to_us).saturating_sub(1));
                let elapsed_us = u128::from(end_us - start_us);
                let speed = u128::from(map.limits().pulse_us_per_s_max);
                prop_assert!(travel_us * 1_000_000 <= speed * elapsed_us + 50);
            }
        }
    }

    /// The last target of a motion is really sent.
    #[test]
    fn constant_target_within_range_is_reached_exactly_and_kept(
        channel in -100 * ONE_Q16..=100 * ONE_Q16, gain in -10 * ONE_Q16..=10 * ONE_Q16,
        speed in 500..20_000u32, factor in 5..50u32, elapsed_us in 1_000..100_000u32,
        later_us in prop::collection::vec(0..250_000u32, 20)
    ) {
        let limits = ServoLimits { pulse_us_per_s_max: speed, pulse_us_per_s2_max: speed * factor };
        let map = ServoMap::new(0, [500, 1500, 2500], gain, limits).unwrap();
        let mut stage = ServoStage::new(&[map]).unwrap();
        let asked = pose(&[channel]);
        stage.enable();
        for _ in 0..8_000_000 / elapsed_us {
            stage.aim(&asked);
            stage.tick(elapsed_us);
        }
        let reached = stage.command().clone();
        let exact_q32 = (1500i64 << 32) + i64::from(channel) * i64::from(gain);
        let error_q32 = (i64::from(reached.pulses_us()[0]) << 32) - exact_q32;
        prop_assert!(error_q32.abs() <= (1 << 31) + (1 << 15));
        prop_assert_eq!(reached.limited_servos(), 0);
        for elapsed_us in later_us {
            stage.aim(&asked);
            prop_assert_eq!(stage.tick(elapsed_us), &reached);
        }
    }
}
