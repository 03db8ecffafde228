//! The chip's end of the link: every command once, in its order, or an answer that says why not.
//!
//! In:  bytes of the line.
//! Out: commands to act upon; answers to send back.
//!
//! Why here: a host that hears no answer sends its command again. Without numbers the body would then nod twice, and
//! a motion that was meant to come before a stop would be played after it.

use super::{Command, Frame, LinkError, Receiver, Refusal, Report};

/// What the last byte of a frame brings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival<'a> {
    /// To act upon; send what [`Inbox::answer`] makes of the outcome.
    Act {
        /// Number of the command.
        sequence: u16,
        /// The command.
        command: Command<'a>,
    },
    /// Nothing to act upon: send this.
    Answer(Report),
}

/// Receives commands; `N` as of [`Receiver`].
#[derive(Clone, Debug, Default)]
pub struct Inbox<const N: usize> {
    receiver: Receiver<N>,
    order: Order,
}

impl<const N: usize> Inbox<N> {
    /// An inbox without a session.
    pub const fn new() -> Self {
        Self { receiver: Receiver::new(), order: Order { last: None, broken_frames: 0 } }
    }

    /// Takes the next byte of the line.
    ///
    /// A command that came already is answered again and not acted upon. [`Command::Hold`], [`Command::SoftStop`],
    /// [`Command::Relax`] and [`Command::Query`] are obeyed whatever their number is; what was lost before them stays
    /// refused.
    pub fn push(&mut self, byte: u8) -> Option<Arrival<'_>> {
        let frame = self.receiver.push(byte)?;
        Some(self.order.arrive(frame))
    }

    /// The answer to the command of this number, remembered in case the command comes again.
    pub fn answer(&mut self, sequence: u16, outcome: Result<(), Refusal>) -> Report {
        if let Some((last, remembered)) = &mut self.order.last
            && *last == sequence
        {
            *remembered = outcome;
        }
        answer(sequence, outcome)
    }

    /// Frames that were refused since the start; stays at the largest number.
    pub fn broken_frames(&self) -> u32 {
        self.order.broken_frames
    }
}

fn answer(sequence: u16, outcome: Result<(), Refusal>) -> Report {
    match outcome {
        Ok(()) => Report::Ack { sequence },
        Err(reason) => Report::Refused { sequence, reason },
    }
}

/// Which command is next.
#[derive(Clone, Debug, Default)]
struct Order {
    /// Number and outcome of the newest command; none before the first hello.
    last: Option<(u16, Result<(), Refusal>)>,
    broken_frames: u32,
}

impl Order {
    fn arrive<'a>(&mut self, frame: Result<Frame<'a>, LinkError>) -> Arrival<'a> {
        let read = frame.map(|frame| (frame.sequence(), frame.command()));
        let (sequence, command) = match read {
            Ok((sequence, Err(LinkError::UnknownMessage))) => {
                self.count_broken();
                return Arrival::Answer(answer(sequence, Err(Refusal::UnknownMessage)));
            }
            Err(error) | Ok((_, Err(error))) => {
                self.count_broken();
                return Arrival::Answer(Report::Broken { error });
            }
            Ok((sequence, Ok(command))) => (sequence, command),
        };
        match self.admit(sequence, &command) {
            Ok(()) => Arrival::Act { sequence, command },
            Err(outcome) => Arrival::Answer(answer(sequence, outcome)),
        }
    }

    fn count_broken(&mut self) {
        self.broken_frames = self.broken_frames.saturating_add(1);
    }

    /// Whether to act upon a command; if not, with what answer.
    fn admit(&mut self, sequence: u16, command: &Command<'_>) -> Result<(), Result<(), Refusal>> {
        let is_first = matches!(command, Command::Hello);
        let is_admitted = is_first || command.is_always_obeyed();
        let Some((last, outcome)) = self.last else {
            if is_first {
                self.last = Some((sequence, Ok(())));
            }
            return if is_admitted { Ok(()) } else { Err(Err(Refusal::NoSession)) };
        };
        let ahead = sequence.wrapping_sub(last);
        if is_first || ahead == 1 || is_admitted && ahead <= u16::MAX / 2 {
            self.last = Some((sequence, Ok(())));
            return Ok(());
        }
        match ahead {
            _ if is_admitted => Ok(()),
            0 => Err(outcome),
            _ => Err(Err(Refusal::OutOfOrder { expected: last.wrapping_add(1) })),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::Play;

    const NOD: Command<'_> = Command::Play(Play {
        action: 1,
        duration_ms: 800,
        seed: 7,
        transition_ms: 400,
        then: false,
    });

    /// Whether the command is to be acted upon, or the answer.
    fn send(inbox: &mut Inbox<64>, sequence: u16, command: &Command<'_>) -> Result<(), Report> {
        let mut buffer = [0; 64];
        let frame = command.encode(sequence, &mut buffer).unwrap();
        let mut arrived = None;
        for &byte in frame {
            if let Some(arrival) = inbox.push(byte) {
                arrived = Some(match arrival {
                    Arrival::Act { sequence: number, command: read } => {
                        assert_eq!((number, read), (sequence, *command));
                        Ok(())
                    }
                    Arrival::Answer(report) => Err(report),
                });
            }
        }
        arrived.expect("a frame ended")
    }

    fn refused(sequence: u16, reason: Refusal) -> Result<(), Report> {
        Err(Report::Refused { sequence, reason })
    }

    #[test]
    fn motion_before_hello_is_refused_by_name() {
        let mut inbox = Inbox::new();
        assert_eq!(send(&mut inbox, 4, &NOD), refused(4, Refusal::NoSession));
        assert_eq!(send(&mut inbox, 5, &Command::Relax), Ok(()), "stopping needs no session");
        assert_eq!(send(&mut inbox, 6, &NOD), refused(6, Refusal::NoSession));
    }

    #[test]
    fn command_that_comes_again_is_answered_and_not_obeyed() {
        let mut inbox = Inbox::new();
        assert_eq!(send(&mut inbox, u16::MAX, &Command::Hello), Ok(()));
        assert_eq!(send(&mut inbox, 0, &NOD), Ok(()), "numbers wrap");
        assert_eq!(inbox.answer(0, Ok(())), Report::Ack { sequence: 0 });
        assert_eq!(send(&mut inbox, 0, &NOD), Err(Report::Ack { sequence: 0 }));
    }

    #[test]
    fn refusal_is_repeated_for_a_command_that_comes_again() {
        let mut inbox = Inbox::new();
        let reason = Refusal::UnknownAction { count: 1 };
        assert_eq!(send(&mut inbox, 1, &Command::Hello), Ok(()));
        assert_eq!(send(&mut inbox, 2, &NOD), Ok(()));
        inbox.answer(2, Err(reason));
        assert_eq!(send(&mut inbox, 2, &NOD), refused(2, reason));
    }

    #[test]
    fn command_after_a_lost_one_is_refused_by_name() {
        let mut inbox = Inbox::new();
        assert_eq!(send(&mut inbox, 1, &Command::Hello), Ok(()));
        assert_eq!(send(&mut inbox, 3, &NOD), refused(3, Refusal::OutOfOrder { expected: 2 }));
        assert_eq!(send(&mut inbox, 0, &NOD), refused(0, Refusal::OutOfOrder { expected: 2 }));
    }

    #[test]
    fn motion_meant_to_come_before_a_stop_is_not_played_after_it() {
        let mut inbox = Inbox::new();
        assert_eq!(send(&mut inbox, 1, &Command::Hello), Ok(()));
        assert_eq!(send(&mut inbox, 3, &Command::SoftStop), Ok(()), "although number 2 was lost");
        assert_eq!(send(&mut inbox, 2, &NOD), refused(2, Refusal::OutOfOrder { expected: 4 }));
        assert_eq!(send(&mut inbox, 4, &NOD), Ok(()));
        assert_eq!(send(&mut inbox, 2, &Command::Hold), Ok(()), "a late stop is a stop");
        assert_eq!(send(&mut inbox, 5, &NOD), Ok(()), "and moves nothing back");
    }

    #[test]
    fn what_is_no_command_is_answered_and_counted() {
        let mut inbox: Inbox<64> = Inbox::new();
        let broken = |error| Some(Arrival::Answer(Report::Broken { error }));
        assert_eq!(inbox.push(9), None);
        assert_eq!(inbox.push(0), broken(LinkError::Cut));
        let mut buffer = [0; 64];
        let echo = Report::Ack { sequence: 1 }.encode(1, &mut buffer).unwrap();
        let last = echo.iter().fold(None, |last, &byte| inbox.push(byte).map(|_| ()).or(last));
        assert_eq!((last, inbox.broken_frames()), (Some(()), 2));
    }
}
