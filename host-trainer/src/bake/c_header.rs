//! Motions as one C header: pulse widths in whole µs, `stdint.h` and nothing else.
//!
//! In:  [`PulseTrack`]s of the same servos.
//! Out: text that C and C++ compile, with Arduino or without.
//!
//! Why here: a header is what every build system of a microcontroller takes. Where flash needs a qualifier, the sketch
//! defines `KARAKURI_PROGMEM` as `PROGMEM` before it includes the file; elsewhere it is empty.

use std::fmt::Write;

use crate::bake::pulse_track::PulseTrack;
use crate::bake::{credit, identifier, identifier_of};

/// Numbers in a line.
const NUMBERS_A_LINE: usize = 16;

/// The whole header.
pub fn emit(tracks: &[PulseTrack<'_>]) -> String {
    let servos = tracks.first().map_or(&[][..], |track| track.servos);
    let stem = tracks.first().map_or_else(String::new, |track| identifier_of(&track.motion.action));
    let guard = format!("KARAKURI_{}_H", stem.to_uppercase());
    let mut text = String::from(
        "/*\n  Pulse widths in microseconds, frame after frame, one number a servo.\n\n",
    );
    for track in tracks {
        let _ = writeln!(text, "  {}", credit(track.motion));
    }
    let _ = write!(
        text,
        "*/\n#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n\n/* Define as PROGMEM (and include \
         <avr/pgmspace.h>) where constants must be told to stay in flash. */\n#ifndef KARAKURI_PROGMEM\n#define \
         KARAKURI_PROGMEM\n#endif\n\n"
    );
    for (index, servo) in servos.iter().enumerate() {
        let [min, neutral, max] = servo.map.pulses_us();
        let name = servo.name.replace("*/", "* /");
        let _ = writeln!(text, "/* servo {index}: {name}, {min} to {max}, neutral {neutral} */");
    }
    for track in tracks {
        text += &array(track);
    }
    let _ = writeln!(text, "\n#endif /* {guard} */");
    text
}

fn array(track: &PulseTrack<'_>) -> String {
    let name = identifier(track.motion);
    let upper = name.to_uppercase();
    let frames = track.whole_us();
    let (frame_count, servo_count) = (frames.len(), track.servos.len());
    let mut text = format!(
        "
#define {upper}_FRAMES {frame_count}
#define {upper}_SERVOS {servo_count}
#define {upper}_MILLIHZ {:.0}

static const uint16_t {name}_us[{upper}_FRAMES * {upper}_SERVOS] KARAKURI_PROGMEM = {{
",
        track.motion.rate_hz * 1000.0
    );
    for line in frames.concat().chunks(NUMBERS_A_LINE) {
        let numbers: Vec<String> = line.iter().map(u16::to_string).collect();
        let _ = writeln!(text, "    {},", numbers.join(", "));
    }
    text + "};\n"
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;
    use crate::bake::specimen;

    /// Numbers of the array `name`, in their order.
    fn numbers(text: &str, name: &str) -> Vec<u16> {
        let array = text.split_once(&format!("{name}_us[")).unwrap().1.split_once('{').unwrap().1;
        let list = array.split_once('}').unwrap().0.split(',').map(str::trim);
        list.filter(|cell| !cell.is_empty()).map(|cell| cell.parse().unwrap()).collect()
    }

    #[test]
    fn numbers_come_back() {
        let motions = specimen::character(3);
        let servos = specimen::servos(&motions[0]);
        let tracks = specimen::tracks(&motions, &servos);
        let text = emit(&tracks);
        assert!(text.contains("blob CRC-32 deadbeef") && text.contains("seed 3"));
        for track in &tracks {
            let name = identifier(track.motion);
            assert_eq!(numbers(&text, &name), track.whole_us().concat());
            assert!(text.contains(&format!(
                "#define {}_FRAMES {}",
                name.to_uppercase(),
                track.frames().len()
            )));
        }
    }

    #[test]
    fn header_compiles_as_c_and_prints_the_motion() {
        let motion = specimen::character(1).remove(0);
        let servos = specimen::servos(&motion);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("motion.h"), emit(std::slice::from_ref(&track))).unwrap();
        let name = identifier(&motion);
        let program = format!(
            "#include \"motion.h\"\n#include \"motion.h\"\n#include <stdio.h>\nint main(void) {{ for (int i = 0; i < \
             {0}_FRAMES * {0}_SERVOS; i++) printf(\"%d\\n\", {name}_us[i]); return 0; }}\n",
            name.to_uppercase()
        );
        std::fs::write(path("main.c"), program).unwrap();
        let mut compiler = Command::new("cc");
        compiler.args(["-std=c99", "-Wall", "-Werror", "-o"]).args([path("main"), path("main.c")]);
        let Ok(output) = compiler.output() else {
            eprintln!(
                "SKIPPED: no C compiler `cc`; the header was read by the parser of this test only"
            );
            return;
        };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let printed = Command::new(path("main")).output().unwrap().stdout;
        let printed = String::from_utf8(printed).unwrap();
        let printed: Vec<u16> = printed.lines().map(|line| line.parse().unwrap()).collect();
        assert_eq!(printed, track.whole_us().concat());
    }
}
