//! A host, a line and a body, all in one place.

use std::vec::Vec;

use super::*;
use crate::fault::Fault;
use crate::link::{COMMAND_BYTES_MAX, LinkError, receiver_bytes};
use crate::manifest::SamplerKind;
use crate::servo_map::{ServoLimits, ServoMap};
use crate::specimen::specimen;
use crate::{Decoder, Model, NumberFormat, ServoStage, Workspace};

type Body<'m, 'w> = Player<'m, 'w, 4>;
type Line = Performer<{ receiver_bytes(COMMAND_BYTES_MAX) }>;

/// A line and a body that is asleep.
fn with_body(test: impl FnOnce(&mut Line, &mut Body<'_, '_>)) {
    let kind = SamplerKind::NearestClips { clip_count: 2, row_bytes: 2 };
    let blob = specimen(NumberFormat::W8A16, kind);
    let model = Model::from_bytes(&blob).unwrap();
    let mut workspace = Workspace::<8>::new();
    let decoder = Decoder::new(&model, &mut workspace).unwrap();
    let limits = ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };
    let map = ServoMap::new(0, [500, 1500, 2500], 10 << 16, limits).unwrap();
    let stage = ServoStage::new(&[map]).unwrap();
    let mut player = Player::new(&model, decoder, 1, stage, 1).unwrap();
    test(&mut Line::new(), &mut player);
}

/// All reports after a command.
fn send(
    line: &mut Line,
    body: &mut Body<'_, '_>,
    sequence: u16,
    command: Command<'_>,
) -> Vec<Report> {
    let mut buffer = [0; 64];
    for &byte in command.encode(sequence, &mut buffer).unwrap() {
        line.hear(byte, body);
    }
    core::iter::from_fn(|| line.take_report()).collect()
}

/// 20 frames of action 0, as `specimen` was made.
fn motion(body: &Body<'_, '_>) -> Play {
    let duration_ms = 20 * 1_000_000 / body.model().manifest().rate_millihz;
    Play { action: 0, duration_ms, seed: 3, transition_ms: 400, then: false }
}

fn refused(sequence: u16, reason: Refusal) -> Vec<Report> {
    [Report::Refused { sequence, reason }].into()
}

#[test]
fn body_obeys_only_what_it_can_do() {
    with_body(|line, body| {
        send(line, body, 1, Command::Hello);
        let play = motion(body);
        assert_eq!(send(line, body, 2, Command::Play(play)), refused(2, Refusal::Asleep));
        send(line, body, 3, Command::Wake);
        let wrong = Play { action: 2, ..play };
        let reason = Refusal::UnknownAction { count: 2 };
        assert_eq!(send(line, body, 4, Command::Play(wrong)), refused(4, reason));
        let wrong = Play { duration_ms: u32::MAX, ..play };
        assert_eq!(send(line, body, 5, Command::Play(wrong)), refused(5, Refusal::BadDuration));
        let dials =
            DialSettings { intensity_q12: 0, rate_q12: 0, stillness_q12: 0, variety_q12: 0 };
        assert_eq!(send(line, body, 6, Command::SetDials(dials)), refused(6, Refusal::BadDials));
        let load = Command::LoadBegin { len_bytes: 1, crc: 1 };
        assert_eq!(send(line, body, 7, load), refused(7, Refusal::NotSupported));
        body.tick(20_000);
        body.latch(Fault::External(9));
        body.tick(20_000);
        line.ticked(body);
        line.ticked(body);
        assert_eq!(line.take_report(), Some(Report::Fault { code: 0x109 }), "once");
        let reason = Refusal::Faulted { code: 0x109 };
        assert_eq!(send(line, body, 8, Command::Play(play)), refused(8, reason));
        assert_eq!(send(line, body, 9, Command::ClearFault), [Report::Ack { sequence: 9 }]);
        assert_eq!(send(line, body, 10, Command::Play(play)), [Report::Ack { sequence: 10 }]);
    });
}

#[test]
fn body_does_as_it_is_told_and_says_so() {
    with_body(|line, body| {
        let hello = send(line, body, 100, Command::Hello);
        let Report::Hello { action_count: 2, servo_count: 1, .. } = hello[1] else {
            panic!("{hello:?}");
        };
        send(line, body, 101, Command::Wake);
        send(line, body, 102, Command::Play(motion(body)));
        let state = |mode, action| Report::State { mode, action };
        body.tick(20_000);
        line.ticked(body);
        let said = send(line, body, 103, Command::Query);
        assert_eq!(said, [Report::Ack { sequence: 103 }, state(Mode::Playing, Some(0))]);
        send(line, body, 104, Command::Hold);
        assert_eq!(send(line, body, 105, Command::Query)[1], state(Mode::Holding, None));
        send(line, body, 106, Command::Relax);
        assert_eq!(send(line, body, 107, Command::Query)[1], state(Mode::Relaxed, None));
        body.tick(20_000);
        line.ticked(body);
        let Report::Telemetry { tick: 2, broken_frames: 0, pulses_us, .. } = line.telemetry(body)
        else {
            panic!("{:?}", line.telemetry(body));
        };
        assert_eq!(pulses_us, [0], "released");
    });
}

#[test]
fn noise_moves_nothing() {
    with_body(|line, body| {
        body.wake();
        body.tick(20_000);
        let pulses_us = body.command().pulses_us().to_vec();
        let mut random = crate::random::Pcg32::new(4);
        for _ in 0..100_000 {
            line.hear(random.next_u32() as u8, body);
            while let Some(report) = line.take_report() {
                assert!(
                    matches!(report, Report::Broken { error } if error != LinkError::WrongDirection)
                );
            }
        }
        body.tick(20_000);
        assert_eq!(body.command().pulses_us(), pulses_us);
    });
}
