//! Motions as sequences in a settings file of Pololu's Maestro Control Center.
//!
//! In:  [`PulseTrack`]s of the same servos, one sequence each.
//! Out: XML: one channel a servo with its limits, one frame a pose.
//!
//! Targets and limits are quarter microseconds. The device stores limits in steps of 16 µs: they are rounded into the
//! servo's range, never beyond it, and targets stay inside them. Durations are whole milliseconds whose sum keeps up
//! with the motion's time.
//!
//! Why here: servos start off (`homemode` is Off) and pulses begin with the first frame, so nothing moves when the file
//! is applied. The speed limit goes into the channel, where the Maestro enforces it.
//! Source: Pololu USB SDK, configuration file and sequence frames, read; user's guide 0J40.

use std::fmt::Write;

use crate::bake::pulse_track::PulseTrack;
use crate::bake::servo::us_per_s_max;
use crate::bake::{credit, identifier};
use crate::calibration::Servo;
use crate::error::{Error, Result};

/// Channels of the boards that exist; the smallest is the Micro Maestro, which counts its period in other units.
const BOARDS: [usize; 4] = [6, 12, 18, 24];
/// Limits are multiples of this, in quarter µs.
const LIMIT_STEP: u32 = 64;
/// µs/s of one step of the speed limit: a quarter µs in 10 ms.
const SPEED_UNIT_US_PER_S: f64 = 25.0;

/// Limits and home of one channel, quarter µs.
struct Limits {
    min: u32,
    home: u32,
    max: u32,
}

/// The whole file.
///
/// # Errors
/// More servos than the largest board has channels; a servo whose range lies between two steps of the limits.
pub fn emit(tracks: &[PulseTrack<'_>], remarks: &mut Vec<String>) -> Result<String> {
    let servos = tracks.first().map_or(&[][..], |track| track.servos);
    let Some(channel_count) = BOARDS.into_iter().find(|count| *count >= servos.len()) else {
        let remedy = "bake another format, or a calibration with fewer servos";
        return Err(Error::bad_input(
            "--format",
            "servos",
            servos.len(),
            "at most 24 channels",
            remedy,
        ));
    };
    let limits: Vec<Limits> = servos.iter().map(limits).collect::<Result<_>>()?;
    let mut text = String::from("<!--Pulse widths from karakuri-->\n<UscSettings version=\"1\">\n");
    for (name, value) in [
        ("NeverSuspend", "false"),
        ("SerialMode", "USB_DUAL_PORT"),
        ("FixedBaudRate", "9600"),
        ("SerialTimeout", "0"),
        ("EnableCrc", "false"),
        ("SerialDeviceNumber", "12"),
        ("SerialMiniSscOffset", "0"),
    ] {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "  <{name}>{value}</{name}>");
    }
    text += &channels(servos, &limits, channel_count);
    text += "  <Sequences>\n";
    for track in tracks {
        text += &sequence(track, &limits, remarks);
    }
    text += "  </Sequences>\n  <Script ScriptDone=\"true\"></Script>\n</UscSettings>\n";
    Ok(text)
}

fn limits(servo: &Servo) -> Result<Limits> {
    let quarters = |pulse_us: u16| u32::from(pulse_us) * 4;
    let [min, _, max] = servo.map.pulses_us().map(quarters);
    let home = quarters(servo.map.pulse_us_park());
    let (min, max) = (min.next_multiple_of(LIMIT_STEP), max / LIMIT_STEP * LIMIT_STEP);
    if min >= max {
        let value = format!("{:?} µs", servo.map.pulses_us());
        let expected =
            "a range that holds two multiples of 16 µs, in which the Maestro stores its limits";
        return Err(Error::bad_input(
            "--format",
            &servo.name,
            value,
            expected,
            "widen the servo's range",
        ));
    }
    Ok(Limits { min, home: home.clamp(min, max), max })
}

fn channels(servos: &[Servo], limits: &[Limits], count: usize) -> String {
    let period = match count == BOARDS[0] {
        true => "ServosAvailable=\"6\" ServoPeriod=\"156\"",
        false => "MiniMaestroServoPeriod=\"80000\" ServoMultiplier=\"1\"",
    };
    let mut text = format!("  <Channels {period}>\n");
    for index in 0..count {
        let (name, min, home, max, speed) = match (servos.get(index), limits.get(index)) {
            (Some(servo), Some(Limits { min, home, max })) => {
                let speed = (us_per_s_max(servo) / SPEED_UNIT_US_PER_S).floor().clamp(1.0, 3968.0);
                (escaped(&servo.name), *min, *home, *max, speed)
            }
            _ => (String::new(), 3968, 6000, 8000, 0.0),
        };
        let _ = writeln!(
            text,
            "    <Channel name=\"{name}\" mode=\"Servo\" min=\"{min}\" max=\"{max}\" homemode=\"Off\" home=\"{home}\" \
             speed=\"{speed:.0}\" acceleration=\"0\" neutral=\"{home}\" range=\"1905\" />"
        );
    }
    text + "  </Channels>\n"
}

fn sequence(track: &PulseTrack<'_>, limits: &[Limits], remarks: &mut Vec<String>) -> String {
    let motion = track.motion;
    let mut text = format!(
        "    <!--{}-->\n    <Sequence name=\"{}\">\n",
        escaped(&credit(motion)),
        identifier(motion)
    );
    let time_ms = |frame: usize| (frame as f64 * 1000.0 / motion.rate_hz).round() as u64;
    let mut clamped = 0;
    for (index, frame) in track.frames().enumerate() {
        let targets: Vec<String> = frame
            .iter()
            .zip(limits)
            .map(|(pulse_us, Limits { min, max, .. })| {
                let asked = (pulse_us * 4.0).round() as u32;
                clamped += usize::from(!(*min..=*max).contains(&asked));
                asked.clamp(*min, *max).to_string()
            })
            .collect();
        let duration_ms = time_ms(index + 1) - time_ms(index);
        let _ = writeln!(
            text,
            "      <Frame name=\"Frame {index}\" duration=\"{duration_ms}\">{}</Frame>",
            targets.join(" ")
        );
    }
    if clamped > 0 {
        remarks.push(format!(
            "seed {}: {clamped} targets moved inside limits in steps of 16 µs, at most 16 µs",
            motion.seed
        ));
    }
    text + "    </Sequence>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;
    use crate::export::Motion;
    use regex::Regex;

    fn attribute<'t>(tag: &'t str, name: &str) -> &'t str {
        tag.split_once(&format!(" {name}=\"")).unwrap().1.split_once('"').unwrap().0
    }

    fn number(tag: &str, name: &str) -> u32 {
        attribute(tag, name).parse().unwrap()
    }

    /// Every start tag and its text, in order; asserts that tags close as they opened.
    fn tags(xml: &str) -> Vec<(String, String)> {
        let pattern =
            Regex::new(r"<(!--.*?--|/?\w+(?: \w+=\x22[^\x22<>]*\x22)* ?/?)>([^<]*)").unwrap();
        let (mut open, mut found, mut length) = (Vec::new(), Vec::new(), 0);
        for capture in pattern.captures_iter(xml) {
            length += capture[0].len();
            let (tag, text) = (capture[1].to_owned(), capture[2].to_owned());
            if tag.starts_with("!--") {
                assert!(!tag[3..tag.len() - 2].contains("--"), "no comment holds its own end");
            } else if let Some(name) = tag.strip_prefix('/') {
                assert_eq!(open.pop().as_deref(), Some(name));
            } else {
                if !tag.ends_with('/') {
                    open.push(tag.split(' ').next().unwrap().to_owned());
                }
                found.push((tag, text));
            }
        }
        assert!(open.is_empty() && length == xml.len(), "the file is nothing but tags");
        found
    }

    #[test]
    fn more_servos_than_a_board_has_are_refused() {
        let motion = specimen::motion_of(&[0.0, 1.0]);
        let servos = vec![specimen::servos(&motion)[0].clone(); 25];
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let error = emit(&[track], &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("servos is 25"), "{error}");
    }

    #[test]
    fn servo_without_room_between_the_limits_is_refused() {
        let motion = specimen::motion_of(&[0.0, 1.0]);
        let mut servos = specimen::servos(&motion);
        servos[0] = specimen::servo([1490, 1500, 1510]);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        assert!(emit(&[track], &mut Vec::new()).unwrap_err().to_string().contains("jaw"));
    }

    #[test]
    fn sequences_come_back_within_a_quarter_microsecond() {
        let motions = specimen::character(3);
        let servos = specimen::servos(&motions[0]);
        let tracks = specimen::tracks(&motions, &servos);
        let tags = tags(&emit(&tracks, &mut Vec::new()).unwrap());
        let channels: Vec<&str> = tags
            .iter()
            .map(|(tag, _)| tag.as_str())
            .filter(|tag| tag.starts_with("Channel "))
            .collect();
        assert!(BOARDS.contains(&channels.len()));
        for (channel, servo) in channels.iter().zip(&servos) {
            assert_eq!(attribute(channel, "name"), servo.name);
            let (min, max) = (number(channel, "min"), number(channel, "max"));
            assert!(
                min >= u32::from(servo.map.pulses_us()[0]) * 4
                    && max <= u32::from(servo.map.pulses_us()[2]) * 4
            );
            assert_eq!((min % LIMIT_STEP, max % LIMIT_STEP), (0, 0));
            assert_eq!(number(channel, "speed"), 240);
        }
        let sequences = tags.split(|(tag, _)| tag.starts_with("Sequence ")).skip(1);
        assert_eq!(sequences.clone().count(), 3);
        for (sequence, track) in sequences.zip(&tracks) {
            let frames: Vec<_> =
                sequence.iter().filter(|(tag, _)| tag.starts_with("Frame ")).collect();
            assert_eq!(frames.len(), track.frames().len());
            for ((tag, text), pulses_us) in frames.iter().zip(track.frames()) {
                assert_eq!(number(tag, "duration"), 20);
                let targets: Vec<f64> =
                    text.split(' ').map(|target| target.parse().unwrap()).collect();
                let is_near = |(target, us): (&f64, &f64)| {
                    let is_at_a_limit = *target == 2048.0 || *target == 9984.0;
                    (target / 4.0 - us).abs() <= if is_at_a_limit { 12.0 } else { 0.126 }
                };
                assert!(
                    targets.len() == servos.len() && targets.iter().zip(pulses_us).all(is_near)
                );
            }
        }
    }

    #[test]
    fn durations_keep_up_with_the_motion() {
        let motion = Motion { rate_hz: 30.0, ..specimen::motion_of(&[0.0; 90]) };
        let servos = specimen::servos(&motion);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let tags = tags(&emit(&[track], &mut Vec::new()).unwrap());
        let durations = tags
            .iter()
            .filter(|(tag, _)| tag.starts_with("Frame "))
            .map(|(tag, _)| number(tag, "duration"));
        assert_eq!(durations.sum::<u32>(), 3000);
    }
}
