//! A host, a line and a body, all in one place.

use std::vec::Vec;

use super::*;
use crate::fault::Fault;
use crate::link::{COMMAND_BYTES_MAX, LinkError, SinkError, receiver_bytes};
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

/// Room for 20 bytes, and no liking for zeros.
#[derive(Default)]
struct Shelf(Vec<u8>);

impl BlobSink for Shelf {
    fn begin(&mut self, len_bytes: u32) -> Result<(), SinkError> {
        self.0.clear();
        if len_bytes > 20 { Err(SinkError::TooLarge) } else { Ok(()) }
    }

    fn write(&mut self, _: u32, bytes: &[u8]) -> Result<(), SinkError> {
        self.0.extend(bytes);
        Ok(())
    }

    fn commit(&mut self, _: u32) -> Result<(), SinkError> {
        if self.0.contains(&0) { Err(SinkError::Rejected) } else { Ok(()) }
    }
}

/// A line, a body and what takes blobs; frames are numbered.
struct Dock<'a, 'm, 'w> {
    line: &'a mut Line,
    body: &'a mut Body<'m, 'w>,
    loader: Loader,
    shelf: Shelf,
    sequence: u16,
}

impl Dock<'_, '_, '_> {
    /// The outcome of a command, and whether a blob was committed.
    fn send(&mut self, command: Command<'_>) -> (Result<(), Refusal>, bool) {
        self.sequence += 1;
        self.send_again(command)
    }

    fn send_again(&mut self, command: Command<'_>) -> (Result<(), Refusal>, bool) {
        let mut buffer = [0; 64];
        let frame = command.encode(self.sequence, &mut buffer).unwrap();
        let committed = frame.iter().fold(false, |committed, &byte| {
            let Self { line, body, loader, shelf, .. } = self;
            line.hear_or_load(byte, body, loader, shelf) | committed
        });
        let outcome = match self.line.take_report() {
            Some(Report::Ack { .. }) => Ok(()),
            Some(Report::Refused { reason, .. }) => Err(reason),
            report => panic!("{report:?}"),
        };
        (outcome, committed)
    }

    /// All of a blob in pieces of ten bytes.
    fn load(&mut self, blob: &[u8], crc: u32) -> (Result<(), Refusal>, bool) {
        let begin = Command::LoadBegin { len_bytes: blob.len() as u32, crc };
        assert_eq!(self.send(begin), (Ok(()), false));
        for (index, bytes) in blob.chunks(10).enumerate() {
            let offset = index as u32 * 10;
            assert_eq!(self.send(Command::LoadChunk { offset, bytes }), (Ok(()), false));
        }
        self.send(Command::LoadCommit)
    }
}

fn with_dock(test: impl FnOnce(Dock<'_, '_, '_>)) {
    with_body(|line, body| {
        let (loader, shelf) = (Loader::new(), Shelf::default());
        let mut dock = Dock { line, body, loader, shelf, sequence: 0 };
        assert_eq!(dock.send(Command::Hello).0, Ok(()));
        let Some(Report::Hello { chunk_bytes_max: 15, .. }) = dock.line.take_report() else {
            panic!("no chunks are offered");
        };
        test(dock);
    });
}

const BLOB: [u8; 15] = [0x5A; 15];

#[test]
fn body_whose_servos_are_on_takes_no_blob() {
    with_dock(|mut dock| {
        let begin = Command::LoadBegin { len_bytes: 15, crc: 0 };
        dock.send(Command::Wake).0.unwrap();
        dock.body.tick(20_000);
        assert_eq!(dock.send(begin), (Err(Refusal::NotRelaxed), false));
        dock.send(Command::Hold).0.unwrap();
        assert_eq!(dock.send(begin), (Err(Refusal::NotRelaxed), false), "holding is not enough");
        dock.send(Command::Relax).0.unwrap();
        assert_eq!(dock.send(begin), (Ok(()), false));
        dock.send(Command::Wake).0.unwrap();
        let chunk = Command::LoadChunk { offset: 0, bytes: &BLOB };
        assert_eq!(dock.send(chunk), (Err(Refusal::NotRelaxed), false), "nor between pieces");
    });
}

#[test]
fn blob_that_is_no_good_is_refused_by_name_and_the_old_one_is_played() {
    with_dock(|mut dock| {
        let large = Command::LoadBegin { len_bytes: 21, crc: 0 };
        assert_eq!(dock.send(large), (Err(Refusal::BlobTooLarge), false));
        let crc = crate::crc32::crc32([BLOB.as_slice()]);
        assert_eq!(dock.load(&BLOB, !crc), (Err(Refusal::WrongChecksum), false));
        let crc_of_zeros = crate::crc32::crc32([[0; 15].as_slice()]);
        assert_eq!(dock.load(&[0; 15], crc_of_zeros), (Err(Refusal::BadBlob), false));
        dock.send(Command::LoadBegin { len_bytes: 15, crc }).0.unwrap();
        let gap = Command::LoadChunk { offset: 1, bytes: &BLOB[1..] };
        let missing = (Err(Refusal::WrongOffset { expected: 0 }), false);
        assert_eq!(dock.send(gap), missing);
        assert_eq!(dock.send(Command::LoadCommit), missing);
        dock.send(Command::Wake).0.unwrap();
        dock.body.tick(20_000);
        let play = motion(dock.body);
        assert_eq!(dock.send(Command::Play(play)), (Ok(()), false));
    });
}

#[test]
fn program_is_told_once_of_a_new_blob() {
    with_dock(|mut dock| {
        let crc = crate::crc32::crc32([BLOB.as_slice()]);
        assert_eq!(dock.load(&BLOB, crc), (Ok(()), true));
        assert_eq!(dock.shelf.0, BLOB);
        assert_eq!(dock.send_again(Command::LoadCommit), (Ok(()), false), "its answer got lost");
        assert_eq!(dock.send(Command::LoadCommit), (Err(Refusal::NotBegun), false));
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
