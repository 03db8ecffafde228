//! A performance in a text file: one line a cue, seconds first.
//!
//! In:  the text, and the model whose actions it names.
//! Out: [`Cue`]s in order of time.
//!
//! Why here: what a builder wants to try is a line, not a program. Every line is checked before the first tick.

use karakuri::{ActionId, Dials, Model};

use crate::cue::{Cue, Deed};
use crate::error::{Error, Result};

/// The words, for `--help` and for errors.
pub const HELP: &str = "\
Exit code 1 when a command broke a limit or a chip's differ from the host's.

Example:
  firmware-sim perform creature.kara --minutes 60 --target cortex-m4 --out hour

Lines of a script: seconds, a word, what belongs to it; # begins a comment.
  0    wake                          servos on, softly
  1    play nod 2.4 seed 7 over 300  at once, from wherever the body is, within 300 ms
  4    then bow 1.8 seed 3           after what is going on
  10   idle all                      live on its own: all, none, or actions with commas
  12   dial rate 1.5                 intensity, rate, stillness or variety
  20   breathe neck 2.5 4            over a channel: crest in its unit, period in seconds
  30   hold | resume | soft-stop | relax | clear-fault
  40   late 400                      the tick comes 400 ms late
  41   lose 5                        5 commands never arrive
  42   brown-out                     the supply fails, everything begins anew";

/// Reads a script.
///
/// # Errors
/// [`Error::BadInput`]: an unknown word, action or channel, a length that was never trained, a number that is none,
/// times that go back; each with its line.
pub fn read(text: &str, model: &Model<'_>, tick_hz: u32) -> Result<Vec<Cue>> {
    let mut reader = Reader { model, tick_hz, dials: Dials::NEUTRAL, last_tick: 0 };
    let mut cues = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let words: Vec<&str> =
            line.split('#').next().unwrap_or_default().split_whitespace().collect();
        if !words.is_empty() {
            cues.push(reader.cue(&words).map_err(|wrong| wrong.in_line(index + 1, line))?);
        }
    }
    Ok(cues)
}

/// What is wrong with a line: the value, what was expected, and what to do.
struct Wrong(String, String);

impl Wrong {
    fn new(value: impl ToString, expected: impl ToString) -> Self {
        Self(value.to_string(), expected.to_string())
    }

    fn in_line(self, number: usize, line: &str) -> Error {
        let field = format!("line {number} (`{}`)", line.trim());
        let remedy = "see `firmware-sim perform --help` for the words of a script";
        Error::bad_input("--script", field, self.0, self.1, remedy)
    }
}

type Line<Value> = std::result::Result<Value, Wrong>;

struct Reader<'a, 'm> {
    model: &'a Model<'m>,
    tick_hz: u32,
    /// As the last line about them left them.
    dials: Dials,
    last_tick: u32,
}

impl Reader<'_, '_> {
    fn cue(&mut self, words: &[&str]) -> Line<Cue> {
        let time_s = number(words[0], "seconds")?;
        let tick = (time_s * f64::from(self.tick_hz)).round();
        if !(f64::from(self.last_tick)..=f64::from(u32::MAX)).contains(&tick) {
            return Err(Wrong::new(words[0], "seconds from 0 on that never go back"));
        }
        self.last_tick = tick as u32;
        Ok(Cue { tick: self.last_tick, deed: self.deed(&words[1..])? })
    }

    fn deed(&mut self, words: &[&str]) -> Line<Deed> {
        Ok(match *words {
            ["wake"] => Deed::Wake,
            ["hold"] => Deed::Hold,
            ["resume"] => Deed::Resume,
            ["soft-stop"] => Deed::SoftStop,
            ["relax"] => Deed::Relax,
            ["clear-fault"] => Deed::ClearFault,
            ["brown-out"] => Deed::BrownOut,
            ["late", ms] => Deed::Late { by_us: (whole(ms, 1, 60_000)? * 1000) as u32 },
            ["lose", ticks] => Deed::Lose { ticks: whole(ticks, 1, 100_000)? as u32 },
            ["idle", actions] => Deed::Idle { actions: self.actions(actions)? },
            ["dial", dial, value] => self.dial(dial, value)?,
            ["breathe", channel, crest, period_s] => self.breathe(channel, crest, period_s)?,
            [verb @ ("play" | "then"), action, seconds, ref rest @ ..] => {
                let (action, duration_ms) = self.motion(action, seconds)?;
                let (seed, transition_ms) = options(rest)?;
                match verb {
                    "play" => Deed::Play { action, duration_ms, seed, transition_ms },
                    _ => Deed::Then { action, duration_ms, seed, transition_ms },
                }
            }
            _ => return Err(Wrong::new(words.join(" "), "a cue such as `wake` or `play nod 2.4`")),
        })
    }

    fn action(&self, name: &str) -> Line<ActionId> {
        self.model.action_by_name(name).ok_or_else(|| {
            let names: Vec<&str> = self.model.actions().collect();
            Wrong::new(name, format!("an action: {}", names.join(", ")))
        })
    }

    fn actions(&self, names: &str) -> Line<u64> {
        let count = self.model.actions().count().min(64) as u32;
        match names {
            "all" => Ok(u64::MAX.unbounded_shr(64 - count)),
            "none" => Ok(0),
            _ => names.split(',').try_fold(0, |set, name| {
                let ActionId(index) = self.action(name)?;
                let bit = 1u64.checked_shl(index.into());
                Ok(set | bit.ok_or_else(|| Wrong::new(name, "one of the first 64 actions"))?)
            }),
        }
    }

    fn motion(&self, action: &str, seconds: &str) -> Line<(u16, u32)> {
        let action = self.action(action)?;
        let seconds = number(seconds, "seconds")?;
        let rate_hz = f64::from(self.model.rate_millihz()) / 1000.0;
        let frames = (seconds * rate_hz).round().clamp(0.0, f64::from(u16::MAX)) as u32;
        if self.model.check_request(action, frames).is_err() {
            let trained = self.model.trained_frames(action);
            let [min_s, max_s] =
                [trained.start(), trained.end()].map(|frames| f64::from(*frames) / rate_hz);
            let expected = format!("a trained length, {min_s:.2} to {max_s:.2} s");
            return Err(Wrong::new(seconds, expected));
        }
        Ok((action.0, (f64::from(frames) / rate_hz * 1000.0).round() as u32))
    }

    fn dial(&mut self, dial: &str, value: &str) -> Line<Deed> {
        let names = ["intensity", "rate", "stillness", "variety"];
        let ranges = [0.0..=2.0, 0.25..=4.0, 0.0..=1.0, 0.0..=2.0];
        let Some(place) = names.iter().position(|name| *name == dial) else {
            return Err(Wrong::new(dial, names.join(", ")));
        };
        let turned = number(value, "a dial")?;
        if !ranges[place].contains(&turned) {
            let range = &ranges[place];
            return Err(Wrong::new(value, format!("{} to {}", range.start(), range.end())));
        }
        let q12 = (turned * f64::from(Dials::ONE_Q12)).round() as u16;
        match place {
            0 => self.dials.intensity_q12 = q12,
            1 => self.dials.rate_q12 = q12,
            2 => self.dials.stillness_q12 = q12,
            _ => self.dials.variety_q12 = q12,
        }
        Ok(Deed::Dials(self.dials))
    }

    fn breathe(&self, channel: &str, crest: &str, period_s: &str) -> Line<Deed> {
        let mut names = Vec::new();
        for group in self.model.groups() {
            let first = names.len();
            names.resize(first + group.kind.channel_count(), None);
            names[first] = Some(group.name);
        }
        let place = names.iter().position(|name| *name == Some(channel)).ok_or_else(|| {
            let names: Vec<&str> = names.iter().flatten().copied().collect();
            Wrong::new(channel, format!("a channel: {}", names.join(", ")))
        })?;
        let crest_q16 = (number(crest, "a value")? * 65_536.0).round() as i32;
        let period_s = number(period_s, "seconds")?;
        if !(0.1..=65.0).contains(&period_s) {
            return Err(Wrong::new(period_s, "a period of 0.1 to 65 s"));
        }
        let period_ms = (period_s * 1000.0).round() as u16;
        Ok(Deed::Breathe { channel: place as u16, crest_q16, period_ms })
    }
}

/// `seed N` and `over MS`, both or either, in any order.
fn options(mut words: &[&str]) -> Line<(u32, u16)> {
    let (mut seed, mut transition_ms) = (1, 400);
    while let [name, value, rest @ ..] = words {
        match *name {
            "seed" => seed = whole(value, 0, u64::from(u32::MAX))? as u32,
            "over" => transition_ms = whole(value, 0, 60_000)? as u16,
            _ => return Err(Wrong::new(name, "`seed N` or `over MILLISECONDS`")),
        }
        words = rest;
    }
    if words.is_empty() {
        Ok((seed, transition_ms))
    } else {
        Err(Wrong::new(words[0], "a number behind it"))
    }
}

fn number(text: &str, what: &str) -> Line<f64> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| Wrong::new(text, format!("{what}, a number")))
}

fn whole(text: &str, min: u64, max: u64) -> Line<u64> {
    let value = text.parse().ok().filter(|value| (min..=max).contains(value));
    value.ok_or_else(|| Wrong::new(text, format!("a whole number, {min} to {max}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use karakuri::NumberFormat;

    fn read_with(text: &str) -> Result<Vec<Cue>> {
        let blob = Fixture::new(1).blob(NumberFormat::W8A16);
        read(text, &Model::from_bytes(&blob).unwrap(), 50)
    }

    #[test]
    fn wrong_line_is_named_with_its_number_and_what_was_expected() {
        for (text, expected) in [
            ("0 wake\nx wake", "line 2 (`x wake`) is x, expected seconds, a number"),
            ("5 wake\n4 wake", "line 2 (`4 wake`) is 4, expected seconds from 0 on"),
            ("0 jump", "is jump, expected a cue"),
            ("0 play sing 1", "is sing, expected an action: "),
            ("0 play write 1000", "expected a trained length"),
            ("0 play write 1.2 seed x", "is x, expected a whole number"),
            ("0 play write 1.2 loudly 3", "is loudly, expected `seed N`"),
            ("0 play write 1.2 seed", "is seed, expected a number behind it"),
            ("0 dial rate 9", "is 9, expected 0.25 to 4"),
            ("0 dial mood 1", "is mood, expected intensity, rate"),
            ("0 breathe tail 1 4", "is tail, expected a channel: "),
            ("0 late 0", "expected a whole number, 1 to 60000"),
            ("0 idle write,sing", "is sing, expected an action: "),
            ("0 wake NaN", "expected a cue"),
            ("NaN wake", "is NaN, expected seconds"),
        ] {
            let error = read_with(text).unwrap_err();
            assert_eq!(error.exit_code(), 3);
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    #[test]
    fn script_becomes_cues() {
        let text = "# a day\n0 wake\n\n1.5 play write 1.2 seed 7 # slowly\n2 then write 1.2 over 300\n\
                    3 dial rate 2\n3 dial stillness 0.5\n4 idle all\n5 late 40\n6 brown-out\n";
        let cues = read_with(text).unwrap();
        let rated =
            |stillness_q12| Deed::Dials(Dials { rate_q12: 8192, stillness_q12, ..Dials::NEUTRAL });
        let [_, play, then, rate, stillness, idle, late, out] = cues[..] else {
            panic!("{cues:?}")
        };
        assert!(matches!(
            play,
            Cue { tick: 75, deed: Deed::Play { seed: 7, transition_ms: 400, .. } }
        ));
        assert!(matches!(then.deed, Deed::Then { seed: 1, transition_ms: 300, .. }));
        assert_eq!((rate.deed, stillness.deed), (rated(2731), rated(2048)));
        assert!(matches!(idle.deed, Deed::Idle { actions } if actions > 0));
        assert_eq!((late.deed, out.deed), (Deed::Late { by_us: 40_000 }, Deed::BrownOut));
    }
}
