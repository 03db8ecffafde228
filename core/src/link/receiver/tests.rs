//! The receiver against noise, damage and every message: what arrives is what was sent, or has a name.

use std::string::ToString;
use std::vec::Vec;

use proptest::prelude::*;

use super::super::frame::encode;
use super::super::{
    CHUNK_HEAD_BYTES_MAX, COMMAND_BYTES_MAX, DialSettings, Mode, Play, REPORT_BYTES_MAX, Refusal,
    frame_bytes_max, receiver_bytes,
};
use super::*;
use crate::limits::SERVOS_MAX;

/// Room for every message of these tests.
const BYTES: usize = receiver_bytes(REPORT_BYTES_MAX + 400);

fn command(bytes: &'static [u8]) -> impl Strategy<Value = Command<'static>> {
    let play = (any::<u16>(), any::<u32>(), any::<u64>(), any::<u16>(), any::<bool>());
    let play = play.prop_map(|(action, duration_ms, seed, transition_ms, then)| {
        Command::Play(Play { action, duration_ms, seed, transition_ms, then })
    });
    let dials =
        any::<[u16; 4]>().prop_map(|[intensity_q12, rate_q12, stillness_q12, variety_q12]| {
            Command::SetDials(DialSettings { intensity_q12, rate_q12, stillness_q12, variety_q12 })
        });
    let plain = [
        Command::Hello,
        Command::Hold,
        Command::SoftStop,
        Command::Relax,
        Command::Wake,
        Command::ClearFault,
        Command::LoadCommit,
        Command::Query,
        Command::Idle { actions: u64::MAX },
        Command::Resume,
    ];
    let load = any::<[u32; 2]>().prop_map(|[len_bytes, crc]| Command::LoadBegin { len_bytes, crc });
    let chunk = any::<u32>().prop_map(move |offset| Command::LoadChunk { offset, bytes });
    prop_oneof![play, dials, prop::sample::select(plain.to_vec()), load, chunk]
}

fn report() -> impl Strategy<Value = Report> {
    let hello = (any::<[u8; 8]>(), any::<u16>(), any::<u8>(), any::<u16>());
    let hello = hello.prop_map(|(model_hash, action_count, servo_count, chunk_bytes_max)| {
        Report::Hello { model_hash, action_count, servo_count, chunk_bytes_max }
    });
    let refused = any::<(u16, u16)>().prop_map(|(sequence, expected)| Report::Refused {
        sequence,
        reason: Refusal::OutOfOrder { expected },
    });
    let state =
        any::<Option<u16>>().prop_map(|action| Report::State { mode: Mode::Playing, action });
    let fault = any::<u16>().prop_map(|code| Report::Fault { code });
    let pulses = prop::collection::vec(any::<u16>(), 0..=SERVOS_MAX);
    let telemetry = (any::<[u32; 3]>(), pulses).prop_map(|(counts, pulses)| {
        let [tick, interventions, broken_frames] = counts;
        let pulses_us = pulses.into_iter().collect();
        Report::Telemetry { tick, interventions, broken_frames, pulses_us }
    });
    let ack = any::<u16>().prop_map(|sequence| Report::Ack { sequence });
    let broken = any::<[u32; 2]>().prop_map(|[stored, computed]| Report::Broken {
        error: LinkError::WrongChecksum { stored, computed },
    });
    prop_oneof![hello, refused, state, fault, telemetry, ack, broken]
}

/// Everything that a receiver says about some bytes.
fn receive<const N: usize>(bytes: &[u8]) -> Vec<Result<Vec<u8>, LinkError>> {
    let mut receiver = Receiver::<N>::new();
    let ends = bytes
        .iter()
        .filter_map(|&byte| receiver.push(byte).map(|end| end.map(|frame| frame.message.to_vec())));
    ends.collect()
}

fn hold(sequence: u16) -> Vec<u8> {
    let mut buffer = [0; 32];
    Command::Hold.encode(sequence, &mut buffer).unwrap().to_vec()
}

#[test]
fn frame_of_a_newer_version_is_refused_by_name() {
    let mut buffer = [0; 32];
    for found in [2, 127] {
        let frame = encode(&Command::Hold, found, 9, &mut buffer).unwrap();
        let refused = Err(LinkError::NewerVersion { found, newest: PROTOCOL_VERSION });
        assert_eq!(receive::<64>(frame), [refused]);
    }
    let frame = encode(&Command::Hold, 0, 9, &mut buffer).unwrap();
    assert_eq!(
        receive::<64>(frame),
        [Err(LinkError::UnknownMessage)],
        "there never was a version 0"
    );
}

#[test]
fn echo_of_ones_own_frame_is_not_obeyed() {
    let mut buffer = [0; 32];
    let mut receiver = Receiver::<64>::new();
    let ack = Report::Ack { sequence: 1 }.encode(1, &mut buffer).unwrap();
    for &byte in ack {
        if let Some(frame) = receiver.push(byte) {
            assert_eq!(frame.unwrap().command(), Err(LinkError::WrongDirection));
        }
    }
    for byte in hold(1) {
        if let Some(frame) = receiver.push(byte) {
            assert_eq!(frame.unwrap().report(), Err(LinkError::WrongDirection));
        }
    }
}

#[test]
fn frame_that_is_longer_than_the_buffer_is_refused_and_the_next_arrives() {
    let mut buffer = [0; 600];
    let chunk = Command::LoadChunk { offset: 0, bytes: &[7; 500] };
    let mut line = chunk.encode(1, &mut buffer).unwrap().to_vec();
    line.extend(hold(2));
    assert_eq!(receive::<64>(&line), [Err(LinkError::TooLong { max: 64 }), Ok([2].to_vec())]);
    assert_eq!(receive::<0>(&hold(1)), [Err(LinkError::TooLong { max: 0 })]);
}

#[test]
fn frame_that_is_cut_anywhere_is_refused_and_the_next_arrives() {
    let whole = hold(1);
    for end in 2..whole.len() - 1 {
        let mut line = whole[..end].to_vec();
        line.extend(hold(2));
        let received = receive::<64>(&line);
        assert_eq!(received.len(), 2, "cut after {end} bytes: {received:?}");
        assert_eq!((received[0].is_err(), &received[1]), (true, &Ok([2].to_vec())));
    }
}

#[test]
fn message_with_something_after_it_is_refused() {
    for message in
        [[2_u8, 0].as_slice(), &[14], &[13, 2], &[], &[1, 5], &[1, 5, 1, 1, 2], &[0xFF; 12]]
    {
        let frame = Frame { is_from_chip: false, sequence: 1, message };
        assert_eq!(frame.command(), Err(LinkError::UnknownMessage), "{message:?}");
    }
    let frame = Frame { is_from_chip: true, sequence: 1, message: &[1, 0, 0] };
    assert_eq!(frame.report(), Err(LinkError::UnknownMessage));
}

#[test]
fn longest_messages_are_as_long_as_declared() {
    let mut buffer = [0; 200];
    let (action, duration_ms, seed, transition_ms) = (u16::MAX, u32::MAX, u64::MAX, u16::MAX);
    let play = Command::Play(Play { action, duration_ms, seed, transition_ms, then: true });
    assert_eq!(postcard::to_slice(&play, &mut buffer).unwrap().len(), COMMAND_BYTES_MAX);
    let pulses_us = core::iter::repeat_n(u16::MAX, SERVOS_MAX).collect();
    let (tick, interventions, broken_frames) = (u32::MAX, u32::MAX, u32::MAX);
    let telemetry = Report::Telemetry { tick, interventions, broken_frames, pulses_us };
    assert_eq!(postcard::to_slice(&telemetry, &mut buffer).unwrap().len(), REPORT_BYTES_MAX);
    let chunk = Command::LoadChunk { offset: u32::MAX, bytes: &[1; 130] };
    let len = postcard::to_slice(&chunk, &mut buffer).unwrap().len();
    assert_eq!(len, 130 + CHUNK_HEAD_BYTES_MAX);
}

#[test]
fn every_error_says_what_is_wrong_in_a_line() {
    let errors = [
        LinkError::Cut,
        LinkError::TooLong { max: 64 },
        LinkError::WrongChecksum { stored: 1, computed: 2 },
        LinkError::NewerVersion { found: 2, newest: 1 },
        LinkError::WrongDirection,
        LinkError::UnknownMessage,
        LinkError::BufferTooSmall { bytes: 3 },
    ];
    let mut lines: Vec<_> = errors.iter().map(ToString::to_string).collect();
    assert!(lines.iter().all(|line| line.len() > 20 && !line.contains('\n')));
    lines.dedup();
    assert_eq!(lines.len(), errors.len());
}

proptest! {
    #[test]
    fn noise_is_survived_and_the_next_frame_arrives(
        noise in prop::collection::vec(prop_oneof![4 => any::<u8>(), 1 => Just(0)], 0..2000)
    ) {
        let mut line = noise;
        line.extend(hold(9));
        prop_assert_eq!(receive::<40>(&line).pop(), Some(Ok([2].to_vec())));
        prop_assert_eq!(receive::<8>(&line).pop(), Some(Ok([2].to_vec())));
    }

    #[test]
    fn message_of_noise_is_read_as_serde_reads_it(
        mut message in prop::collection::vec(prop_oneof![any::<u8>(), 0_u8..4], 0..30), tag in 0_u8..16
    ) {
        if let Some(first) = message.first_mut() {
            *first = tag;
        }
        let by_serde: Option<Command<'_>> =
            postcard::take_from_bytes(&message).ok().and_then(|(command, rest)| rest.is_empty().then_some(command));
        // By hand a number may be written with needless bytes; what serde reads, the hand reads.
        let by_hand = Command::parse(&message).ok();
        prop_assert!(by_serde.is_none() || by_hand == by_serde, "{:?} {:?}", by_hand, by_serde);
        let _ = Report::parse(&message);
    }

    #[test]
    fn every_command_arrives_as_it_was_sent(command in command(&[0, 1, 0, 0, 255]), sequence: u16) {
        let mut buffer = [0; frame_bytes_max(COMMAND_BYTES_MAX)];
        let mut receiver = Receiver::<{ receiver_bytes(COMMAND_BYTES_MAX) }>::new();
        let frame = command.encode(sequence, &mut buffer).unwrap();
        for &byte in frame {
            if let Some(frame) = receiver.push(byte) {
                let frame = frame.unwrap();
                prop_assert_eq!((frame.sequence(), frame.command()), (sequence, Ok(command)));
            }
        }
    }

    #[test]
    fn every_report_arrives_as_it_was_sent(report in report(), sequence: u16) {
        let mut buffer = [0; frame_bytes_max(REPORT_BYTES_MAX)];
        let mut receiver = Receiver::<{ receiver_bytes(REPORT_BYTES_MAX) }>::new();
        let mut received = None;
        for &byte in report.encode(sequence, &mut buffer).unwrap() {
            received = receiver.push(byte).map(|frame| frame.unwrap().report()).or(received);
        }
        prop_assert_eq!(received, Some(Ok(report)));
    }

    #[test]
    fn any_flipped_bit_is_refused(
        bytes in prop::collection::vec(prop_oneof![Just(0_u8), any::<u8>()], 0..400), offset: u32
    ) {
        let mut buffer = [0; 600];
        let frame = Command::LoadChunk { offset, bytes: &bytes }.encode(1, &mut buffer).unwrap();
        for bit in 0..frame.len() * 8 {
            let mut line = frame.to_vec();
            line[bit / 8] ^= 1 << (bit % 8);
            let last = line.len() - 1;
            let received = receive::<BYTES>(&line);
            // Where the last zero was hit the frame has not ended; the zero of the next one will end it.
            let ends = if bit / 8 == last { 0..=0 } else { 1..=2 };
            // A flip in the zero before the frame puts a byte before it, which the checksum catches as well.
            prop_assert!(ends.contains(&received.len()), "bit {}: {:?}", bit, received);
            prop_assert!(received.iter().all(Result::is_err), "bit {}: {:?}", bit, received);
            line.extend(hold(5));
            prop_assert_eq!(receive::<BYTES>(&line).pop(), Some(Ok([2].to_vec())));
        }
    }
}
