//! One line a cue: seconds if it has a time, a word, what belongs to it. The words of `firmware-sim perform`.
//!
//! In:  a line; the model whose actions it names, if there is one.
//! Out: a [`Cue`].

use std::time::Duration;

use karakuri::link::{Command, DialSettings, Play};
use karakuri::{Dials, Model};

/// The words, for `--help` and for errors.
pub const HELP: &str = "\
Lines of a script: seconds from the start (without: at once), a word, what belongs to it; # begins a comment.
  0    wake                          servos on, softly
  1    play nod 2.4 seed 7 over 300  at once, from wherever the body is, within 300 ms
  4    then bow 1.8 seed 3           after what is going on
  10   idle all                      live on its own: all, none, or actions with commas
  12   dial rate 1.5                 intensity, rate, stillness or variety
  30   hold | resume | soft-stop | relax | clear-fault | query

Actions are numbers, or names if --model says which.

Example:
  host-trainer perform --serial /dev/ttyACM0 --model creature.kara --script day.txt
  host-trainer perform --serial /dev/ttyACM0 --load creature.kara   sends the blob first";

/// A command and when to give it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cue {
    /// Since the start; none: as soon as the one before is done.
    pub at: Option<Duration>,
    /// What to command.
    pub command: Command<'static>,
}

/// What is wrong with a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    /// What stands there.
    pub value: String,
    /// What should.
    pub expected: String,
}

impl Wrong {
    fn new(value: impl ToString, expected: impl ToString) -> Self {
        Self { value: value.to_string(), expected: expected.to_string() }
    }
}

type Read<Value> = Result<Value, Wrong>;

/// Reads lines one after another: dials keep their values from line to line.
#[derive(Debug)]
pub struct Reader<'a, 'm> {
    model: Option<&'a Model<'m>>,
    dials: [u16; 4],
}

impl<'a, 'm> Reader<'a, 'm> {
    /// A reader that knows the names of a model's actions, or only numbers.
    pub fn new(model: Option<&'a Model<'m>>) -> Self {
        let Dials { intensity_q12, rate_q12, stillness_q12, variety_q12 } = Dials::NEUTRAL;
        Self { model, dials: [intensity_q12, rate_q12, stillness_q12, variety_q12] }
    }

    /// The cue of a line, `None` where it is empty.
    ///
    /// # Errors
    /// [`Wrong`].
    pub fn read(&mut self, line: &str) -> Read<Option<Cue>> {
        let words = line.split('#').next().unwrap_or_default().split_whitespace();
        let words: Vec<&str> = words.collect();
        let Some(first) = words.first() else { return Ok(None) };
        let seconds: Option<f64> = first.parse().ok();
        let at = seconds.map(|_| number(first, 0.0, 1e6)).transpose()?;
        let command = self.command(&words[usize::from(at.is_some())..])?;
        Ok(Some(Cue { at: at.map(Duration::from_secs_f64), command }))
    }

    fn command(&mut self, words: &[&str]) -> Read<Command<'static>> {
        Ok(match *words {
            ["wake"] => Command::Wake,
            ["hold"] => Command::Hold,
            ["resume"] => Command::Resume,
            ["soft-stop"] => Command::SoftStop,
            ["relax"] => Command::Relax,
            ["clear-fault"] => Command::ClearFault,
            ["query"] => Command::Query,
            ["idle", actions] => Command::Idle { actions: self.actions(actions)? },
            ["dial", dial, value] => self.dial(dial, value)?,
            [verb @ ("play" | "then"), action, seconds, ref rest @ ..] => {
                let duration_ms = (number(seconds, 0.01, 3600.0)? * 1000.0).round() as u32;
                let (seed, transition_ms) = options(rest)?;
                let (action, then) = (self.action(action)?, verb == "then");
                Command::Play(Play { action, duration_ms, seed, transition_ms, then })
            }
            ["late" | "lose" | "brown-out" | "breathe", ..] => {
                return Err(Wrong::new(words[0], "a word that a real body knows"));
            }
            _ => return Err(Wrong::new(words.join(" "), "a cue such as `wake` or `play nod 2.4`")),
        })
    }

    fn action(&self, name: &str) -> Read<u16> {
        let named = self.model.and_then(|model| model.action_by_name(name)).map(|action| action.0);
        named.or_else(|| name.parse().ok()).ok_or_else(|| {
            let names = self.model.map(|model| model.actions().collect::<Vec<_>>().join(", "));
            let names = names.unwrap_or_else(|| "by its number, or --model with its name".into());
            Wrong::new(name, format!("an action: {names}"))
        })
    }

    fn actions(&self, names: &str) -> Read<u64> {
        match names {
            "all" => Ok(u64::MAX),
            "none" => Ok(0),
            _ => names.split(',').try_fold(0, |set, name| {
                let bit = 1u64.checked_shl(self.action(name)?.into());
                Ok(set | bit.ok_or_else(|| Wrong::new(name, "one of the first 64 actions"))?)
            }),
        }
    }

    fn dial(&mut self, dial: &str, value: &str) -> Read<Command<'static>> {
        let names = ["intensity", "rate", "stillness", "variety"];
        let ranges = [(0.0, 2.0), (0.25, 4.0), (0.0, 1.0), (0.0, 2.0)];
        let place = names.iter().position(|name| *name == dial);
        let place = place.ok_or_else(|| Wrong::new(dial, names.join(", ")))?;
        let (min, max) = ranges[place];
        self.dials[place] = (number(value, min, max)? * 4096.0).round() as u16;
        let [intensity_q12, rate_q12, stillness_q12, variety_q12] = self.dials;
        let dials = DialSettings { intensity_q12, rate_q12, stillness_q12, variety_q12 };
        Ok(Command::SetDials(dials))
    }
}

/// `seed N` and `over MS`, both or either, in any order.
fn options(mut words: &[&str]) -> Read<(u64, u16)> {
    let (mut seed, mut transition_ms) = (1, 400);
    while let [name, value, rest @ ..] = words {
        let expected = || Wrong::new(value, "a whole number");
        match *name {
            "seed" => seed = value.parse().map_err(|_| expected())?,
            "over" => transition_ms = value.parse().map_err(|_| expected())?,
            _ => return Err(Wrong::new(name, "`seed N` or `over MILLISECONDS`")),
        }
        words = rest;
    }
    words
        .first()
        .map_or(Ok((seed, transition_ms)), |word| Err(Wrong::new(word, "a number behind it")))
}

fn number(text: &str, min: f64, max: f64) -> Read<f64> {
    let value = text.parse().ok().filter(|value| (min..=max).contains(value));
    value.ok_or_else(|| Wrong::new(text, format!("a number, {min} to {max}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_line_says_what_was_expected() {
        for (line, value) in [
            ("-1 wake", "-1"),
            ("jump", "jump"),
            ("0 play nod 1", "nod"),
            ("play 1 x", "x"),
            ("play 1 2 seed x", "x"),
            ("play 1 2 loudly 3", "loudly"),
            ("play 1 2 seed", "seed"),
            ("dial mood 1", "mood"),
            ("dial rate 9", "9"),
            ("NaN wake", "NaN"),
            ("idle 64", "64"),
            ("3 brown-out", "brown-out"),
        ] {
            let wrong = Reader::new(None).read(line).unwrap_err();
            assert_eq!(wrong.value, value, "{line}: {wrong:?}");
        }
    }

    #[test]
    fn lines_become_cues() {
        let mut reader = Reader::new(None);
        assert_eq!(reader.read("  # nothing"), Ok(None));
        let cue = reader.read("1.5 then 3 2.4 over 300 seed 7 # slowly").unwrap().unwrap();
        let play = Play { action: 3, duration_ms: 2400, seed: 7, transition_ms: 300, then: true };
        let at = Some(Duration::from_millis(1500));
        assert_eq!(cue, Cue { at, command: Command::Play(play) });
        reader.read("dial rate 2").unwrap();
        let turned = reader.read("dial intensity 0.5").unwrap().unwrap().command;
        let Command::SetDials(dials) = turned else { panic!("{turned:?}") };
        assert_eq!((dials.rate_q12, dials.intensity_q12), (8192, 2048), "dials stay");
        let idle = reader.read("idle 0,5").unwrap().unwrap().command;
        assert_eq!(idle, Command::Idle { actions: 33 });
    }
}
