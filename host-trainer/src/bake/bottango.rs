//! Motions as generated code of Bottango's Arduino driver: cubic curves in place of samples.
//!
//! In:  [`PulseTrack`]s of the same servos, one clip each.
//! Out: `GeneratedCodeAnimations.h` and `.cpp`, which take the place of the driver's own.
//!
//! Commands are lines of text, sorted by their start. `rSVPin,pin,µs min,µs max,µs/s max,µs at start` makes a servo;
//! `sC,pin,start ms,duration ms,y,dx,dy,y,dx,dy` is a Bézier curve whose y runs from 0 to 8192 over the servo's range
//! and whose handles are offsets from their own ends.
//!
//! Why here: the driver's docs say that playback takes every servo to stand at its first key. So a clip begins at the
//! pulse of its first frame, and the speed limit of `rSVPin` bounds the way there.
//! Source: driver 0.8.0c1, read: code stream, curve evaluation, length of commands (100 characters on the smallest
//! boards), of clips, and of the one string that it plays of a clip.

use std::fmt::Write;

use crate::bake::pulse_track::PulseTrack;
use crate::bake::servo::pulses_us;
use crate::bake::{credit, identifier};
use crate::calibration::Servo;
use crate::error::{Error, Result};
use crate::keyframe::cubic;

/// y at the end of the range.
const Y_MAX: f64 = 8192.0;
/// Characters of a command on boards with little memory.
const COMMAND_CHARACTERS_MAX: usize = 100;
/// Clips that the driver can hold.
const CLIPS_MAX: usize = 32;
/// Characters of a clip that a 16-bit board can count.
const CLIP_CHARACTERS_AVR_MAX: usize = 32_767;
/// First pin where the user names none: 0 and 1 are the serial port of many boards.
const FIRST_PIN: u8 = 2;
/// How often a fit is repeated with a narrower tolerance, because whole milliseconds and steps of y add to its error.
const ATTEMPTS: usize = 6;

/// One Bézier curve as the driver reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Curve {
    pin: u8,
    start_ms: i64,
    duration_ms: i64,
    y: [i64; 2],
    /// From the start, from the end: (ms, y).
    handles: [[i64; 2]; 2],
}

/// Both files: header, source.
///
/// # Errors
/// More clips or fewer poses than the driver can play; a pin for every servo.
pub fn emit(
    tracks: &[PulseTrack<'_>],
    pins: &[u8],
    tolerance_us: f64,
    remarks: &mut Vec<String>,
) -> Result<[String; 2]> {
    let servos = tracks.first().map_or(&[][..], |track| track.servos);
    let pins = pins_of(servos, pins, remarks)?;
    if tracks.len() > CLIPS_MAX {
        let expected = format!("at most {CLIPS_MAX}: the driver holds no more");
        return Err(Error::bad_input(
            "--count",
            "clips",
            tracks.len(),
            expected,
            "bake fewer at a time",
        ));
    }
    let clips: Vec<String> = tracks
        .iter()
        .map(|track| clip(track, &pins, tolerance_us, remarks))
        .collect::<Result<_>>()?;
    Ok([header(), source(tracks, &setup(servos, &pins), &clips)])
}

fn pins_of(servos: &[Servo], pins: &[u8], remarks: &mut Vec<String>) -> Result<Vec<u8>> {
    let is_new = |index: usize| !pins[..index].contains(&pins[index]);
    match pins.len() {
        count if count == servos.len() && (0..count).all(is_new) => Ok(pins.to_vec()),
        0 if servos.len() <= usize::from(u8::MAX - FIRST_PIN) => {
            let pins: Vec<u8> = (FIRST_PIN..).take(servos.len()).collect();
            remarks.push(format!(
                "servos are on pins {FIRST_PIN} to {} in the model's order; other pins: --pins",
                pins.last().unwrap_or(&FIRST_PIN)
            ));
            Ok(pins)
        }
        _ => {
            let names: Vec<&str> = servos.iter().map(|servo| servo.name.as_str()).collect();
            let expected = format!("{} pins, each once, for {}", servos.len(), names.join(", "));
            Err(Error::bad_input(
                "--pins",
                "pins",
                format!("{pins:?}"),
                expected,
                "name one pin a servo",
            ))
        }
    }
}

fn setup(servos: &[Servo], pins: &[u8]) -> String {
    let line = |(servo, pin): (&Servo, &u8)| {
        let [min, _, max] = servo.map.pulses_us();
        let (limits, park) = (servo.map.limits(), servo.map.pulse_us_park());
        format!("rSVPin,{pin},{min},{max},{},{park}\n", limits.pulse_us_per_s_max)
    };
    servos.iter().zip(pins).map(line).collect()
}

fn clip(
    track: &PulseTrack<'_>,
    pins: &[u8],
    tolerance_us: f64,
    remarks: &mut Vec<String>,
) -> Result<String> {
    let (motion, mut curves, mut worst_us) = (track.motion, Vec::new(), 0.0f64);
    if track.frames().len() < 2 {
        let remedy = "ask for a longer motion";
        return Err(Error::bad_input(
            "--seconds",
            "poses",
            track.frames().len(),
            "at least 2",
            remedy,
        ));
    }
    for (index, (servo, pin)) in track.servos.iter().zip(pins).enumerate() {
        let (fitted, error_us) =
            curves_of(&track.servo_us(index), servo, *pin, motion.rate_hz, tolerance_us);
        worst_us = worst_us.max(error_us);
        curves.extend(fitted);
    }
    // Stable: curves of one start stay in the order of servos.
    curves.sort_by_key(|curve| curve.start_ms);
    let text: String = curves.iter().map(line).collect();
    remarks.push(format!(
        "seed {}: {} curves, {} characters, at most {worst_us:.1} µs from the motion (--tolerance-us {tolerance_us})",
        motion.seed, curves.len(), text.len()
    ));
    if text.len() > CLIP_CHARACTERS_AVR_MAX {
        remarks
            .push(format!("seed {}: too long for 8-bit boards; raise --tolerance-us", motion.seed));
    }
    debug_assert!(text.lines().all(|line| line.len() <= COMMAND_CHARACTERS_MAX));
    // An empty line ends a clip.
    Ok(text + "\n")
}

/// The fewest curves that keep the tolerance as they are written, and their largest error, µs.
fn curves_of(
    course_us: &[f64],
    servo: &Servo,
    pin: u8,
    rate_hz: f64,
    tolerance_us: f64,
) -> (Vec<Curve>, f64) {
    let [min, _, max] = pulses_us(servo);
    let us_per_y = (max - min).max(1.0) / Y_MAX;
    let values: Vec<f64> = course_us.iter().map(|pulse_us| (pulse_us - min) / us_per_y).collect();
    let ms_per_frame = 1000.0 / rate_hz;
    let mut narrow = tolerance_us / us_per_y;
    let mut best: Option<(Vec<Curve>, f64)> = None;
    for _ in 0..ATTEMPTS {
        let fitted = cubic::fit(&values, narrow);
        let curves: Vec<Curve> =
            fitted.iter().map(|cubic| curve(cubic, pin, ms_per_frame)).collect();
        let error_us = error(&curves, &fitted, &values, ms_per_frame) * us_per_y;
        if best.as_ref().is_none_or(|(_, least)| error_us < *least) {
            best = Some((curves, error_us));
        }
        if error_us <= tolerance_us {
            break;
        }
        narrow *= 0.6;
    }
    best.unwrap_or_default()
}

/// Handles lie at a third of the duration, where x is time itself; rounded as they are written.
fn curve(cubic: &cubic::Cubic, pin: u8, ms_per_frame: f64) -> Curve {
    let ms = |frame: usize| (frame as f64 * ms_per_frame).round() as i64;
    let (start_ms, end_ms) = (ms(cubic.first), ms(cubic.last));
    let third_ms = ((end_ms - start_ms) as f64 / 3.0).round();
    let handle = |sign: f64, slope: f64| {
        [(sign * third_ms) as i64, (sign * slope * third_ms / ms_per_frame).round() as i64]
    };
    let [from, to] = cubic.slopes;
    Curve {
        pin,
        start_ms,
        duration_ms: end_ms - start_ms,
        y: cubic.values.map(|value| value.round() as i64),
        handles: [handle(1.0, from), handle(-1.0, to)],
    }
}

/// Largest distance of the written curves from the samples, in y.
fn error(curves: &[Curve], fitted: &[cubic::Cubic], values: &[f64], ms_per_frame: f64) -> f64 {
    let of_curve = |(curve, cubic): (&Curve, &cubic::Cubic)| {
        let at = |frame: usize| curve.y_at(frame as f64 * ms_per_frame - curve.start_ms as f64);
        (cubic.first..=cubic.last)
            .map(|frame| (values[frame] - at(frame)).abs())
            .fold(0.0, f64::max)
    };
    curves.iter().zip(fitted).map(of_curve).fold(0.0, f64::max)
}

impl Curve {
    /// As the driver evaluates it: bisection for the parameter at a time after the start, then y, inside the range.
    fn y_at(&self, elapsed_ms: f64) -> f64 {
        let duration = self.duration_ms as f64;
        let [[dx0, dy0], [dx1, dy1]] = self.handles.map(|handle| handle.map(|value| value as f64));
        let [y0, y1] = self.y.map(|value| value as f64);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..40 {
            let u = (low + high) / 2.0;
            match bezier([0.0, dx0, duration + dx1, duration], u) < elapsed_ms {
                true => low = u,
                false => high = u,
            }
        }
        bezier([y0, y0 + dy0, y1 + dy1, y1], (low + high) / 2.0).clamp(0.0, Y_MAX)
    }
}

fn bezier([a, b, c, d]: [f64; 4], u: f64) -> f64 {
    let v = 1.0 - u;
    v * v * v * a + 3.0 * v * v * u * b + 3.0 * v * u * u * c + u * u * u * d
}

fn line(curve: &Curve) -> String {
    let Curve { pin, start_ms, duration_ms, y: [from, to], handles: [[dx0, dy0], [dx1, dy1]] } =
        curve;
    format!("sC,{pin},{start_ms},{duration_ms},{from},{dx0},{dy0},{to},{dx1},{dy1}\n")
}

fn header() -> String {
    String::from(
        "#ifndef GeneratedCodeAnimations_h
#define GeneratedCodeAnimations_h

#include <Arduino.h>

namespace GeneratedCodeAnimations
{
    byte getAnimationCount();
    const char *const *getSetup();
    const char *getLoopByIndex(byte animationIndex);
    const char *const *getAnimationDataByIndex(byte animationIndex);
    const uint16_t *getConfigValues(byte animationIndex);
}

#endif
",
    )
}

fn source(tracks: &[PulseTrack<'_>], setup: &str, clips: &[String]) -> String {
    let mut text = String::from("// Animation index key:\n");
    for (index, track) in tracks.iter().enumerate() {
        // Writing to a String cannot fail.
        let _ =
            writeln!(text, "// {index}: {}: {}", identifier(track.motion), credit(track.motion));
    }
    let setup = literal(setup);
    let _ = write!(
        text,
        "
#include \"GeneratedCodeAnimations.h\"

namespace GeneratedCodeAnimations
{{
    const char SETUP_DATA_0[] PROGMEM ={setup};
    const char *const SETUP_DATAARRAY[] PROGMEM = {{SETUP_DATA_0}};
"
    );
    for (index, clip) in clips.iter().enumerate() {
        let clip = literal(clip);
        let _ = write!(
            text,
            "
    const char ANIM_{index}_DATA0[] PROGMEM ={clip};
    const char *const ANIM_{index}_DATAARRAY[] PROGMEM = {{ANIM_{index}_DATA0}};
    const char ANIM_{index}_LOOP[] PROGMEM = \"\";
    // Play on start, loop on start, idle, pin, loop on pin, pin mode, ladder min, ladder max.
    const uint16_t ANIM_{index}_CONFIG[8] = {{0, 0, 0, 0, 0, 0, 0, 0}};
"
        );
    }
    text + &accessors(clips.len())
}

fn accessors(count: usize) -> String {
    let by_index = |result: &str, name: &str, suffix: &str| {
        let case =
            |index| format!("        case {index}:\n            return ANIM_{index}_{suffix};\n");
        let cases: String = (0..count).map(case).collect();
        format!(
            "
    {result}{name}(byte animationIndex)
    {{
        switch (animationIndex)
        {{
{cases}        }}
        return nullptr;
    }}
"
        )
    };
    format!(
        "
    byte getAnimationCount()
    {{
        return {count};
    }}

    const char *const *getSetup()
    {{
        return SETUP_DATAARRAY;
    }}
{}{}{}}}
",
        by_index("const char *", "getLoopByIndex", "LOOP"),
        by_index("const char *const *", "getAnimationDataByIndex", "DATAARRAY"),
        by_index("const uint16_t *", "getConfigValues", "CONFIG"),
    )
}

/// One C string, a line of it a command.
fn literal(text: &str) -> String {
    text.split_inclusive('\n')
        .map(|line| format!("\n        \"{}\\n\"", line.trim_end_matches('\n')))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;
    use crate::bake::specimen;
    use crate::export::Motion;

    const TOLERANCE_US: f64 = 5.0;

    fn emitted(
        motions: &[Motion],
        servos: &[Servo],
        remarks: &mut Vec<String>,
    ) -> Result<[String; 2]> {
        let tracks: Vec<_> =
            motions.iter().map(|motion| PulseTrack::new(motion, servos, &mut Vec::new())).collect();
        emit(&tracks, &[], TOLERANCE_US, remarks)
    }

    /// The commands of the string constant `name`.
    fn commands(source: &str, name: &str) -> Vec<String> {
        let text =
            source.split_once(&format!("{name}[] PROGMEM =")).unwrap().1.split_once(';').unwrap().0;
        let strings = text.lines().map(str::trim).filter(|line| !line.is_empty());
        let joined: String = strings
            .map(|line| line.strip_prefix('"').unwrap().strip_suffix('"').unwrap())
            .collect();
        joined.split("\\n").filter(|line| !line.is_empty()).map(String::from).collect()
    }

    fn read(command: &str) -> Curve {
        let fields: Vec<i64> =
            command.strip_prefix("sC,").unwrap().split(',').map(|f| f.parse().unwrap()).collect();
        let [pin, start_ms, duration_ms, y0, dx0, dy0, y1, dx1, dy1] = fields.try_into().unwrap();
        Curve {
            pin: pin as u8,
            start_ms,
            duration_ms,
            y: [y0, y1],
            handles: [[dx0, dy0], [dx1, dy1]],
        }
    }

    #[test]
    fn too_many_clips_and_too_few_pins_are_refused() {
        let motions = vec![specimen::motion_of(&[0.0, 1.0]); CLIPS_MAX + 1];
        let servos = specimen::servos(&motions[0]);
        let error = emitted(&motions, &servos, &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("clips is 33"), "{error}");
        let track = PulseTrack::new(&motions[0], &servos, &mut Vec::new());
        let error = emit(&[track], &[3, 3], 5.0, &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("1 pins, each once, for jaw"), "{error}");
    }

    #[test]
    fn curves_stay_within_the_stated_tolerance() {
        let motions = specimen::character(6);
        let servos = specimen::servos(&motions[0]);
        let mut remarks = Vec::new();
        let [_, source] = emitted(&motions, &servos, &mut remarks).unwrap();
        let setup = commands(&source, "SETUP_DATA_0");
        assert_eq!(setup.len(), servos.len());
        assert_eq!(setup[0], "rSVPin,2,500,2500,6000,1500");
        for (index, motion) in motions.iter().enumerate() {
            let track = PulseTrack::new(motion, &servos, &mut Vec::new());
            let commands = commands(&source, &format!("ANIM_{index}_DATA0"));
            assert!(commands.iter().all(|command| command.len() <= COMMAND_CHARACTERS_MAX));
            let curves: Vec<Curve> = commands.iter().map(|command| read(command)).collect();
            assert!(curves.is_sorted_by_key(|curve| curve.start_ms));
            assert!(
                curves.len() * 5 < track.frames().len() * servos.len(),
                "{} curves",
                curves.len()
            );
            for servo in 0..servos.len() {
                let own: Vec<&Curve> =
                    curves.iter().filter(|curve| usize::from(curve.pin) == servo + 2).collect();
                assert_eq!(own[0].start_ms, 0);
                assert!(
                    own.windows(2)
                        .all(|pair| pair[0].start_ms + pair[0].duration_ms == pair[1].start_ms
                            && pair[0].y[1] == pair[1].y[0])
                );
                for (frame, pulse_us) in track.servo_us(servo).iter().enumerate() {
                    let at_ms = frame as f64 * 20.0;
                    let curve = own.iter().rfind(|curve| curve.start_ms as f64 <= at_ms).unwrap();
                    let played_us =
                        500.0 + curve.y_at(at_ms - curve.start_ms as f64) / Y_MAX * 2000.0;
                    assert!(
                        (played_us - pulse_us).abs() <= TOLERANCE_US + 1e-6,
                        "{played_us} for {pulse_us}"
                    );
                }
            }
        }
    }

    #[test]
    fn rates_that_are_no_whole_milliseconds_keep_the_tolerance_too() {
        let degrees: Vec<f32> = (0..90).map(|at| 40.0 * (at as f32 / 7.0).sin()).collect();
        let motion = Motion { rate_hz: 30.0, ..specimen::motion_of(&degrees) };
        let servos = specimen::servos(&motion);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let (curves, error_us) = curves_of(&track.servo_us(0), &servos[0], 2, 30.0, TOLERANCE_US);
        assert!(
            error_us <= TOLERANCE_US && curves.len() < 30,
            "{error_us} µs, {} curves",
            curves.len()
        );
    }

    #[test]
    fn both_files_compile_with_a_stand_in_for_arduino() {
        let motions = specimen::character(2);
        let servos = specimen::servos(&motions[0]);
        let [header, source] = emitted(&motions, &servos, &mut Vec::new()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("GeneratedCodeAnimations.h"), header).unwrap();
        std::fs::write(path("GeneratedCodeAnimations.cpp"), source).unwrap();
        let arduino = "#include <stdint.h>\ntypedef uint8_t byte;\n#define PROGMEM\n";
        std::fs::write(path("Arduino.h"), arduino).unwrap();
        let mut compiler = Command::new("c++");
        compiler.args(["-std=c++11", "-Wall", "-Werror", "-fsyntax-only", "-I"]);
        let Ok(output) =
            compiler.args([folder.path(), &path("GeneratedCodeAnimations.cpp")]).output()
        else {
            eprintln!(
                "SKIPPED: no C++ compiler `c++`; the commands were read by the parser of this file only"
            );
            return;
        };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
