//! Motions as Rust constants: pulse widths in whole µs.
//!
//! In:  [`PulseTrack`]s of the same servos.
//! Out: one file for `include!` or `mod`; `no_std`, no dependency.

use std::fmt::Write;

use crate::bake::pulse_track::PulseTrack;
use crate::bake::{credit, identifier};

/// The whole file.
pub fn emit(tracks: &[PulseTrack<'_>]) -> String {
    let mut text =
        String::from("// Pulse widths in microseconds: one array a frame, one number a servo.\n");
    let servos = tracks.first().map_or(&[][..], |track| track.servos);
    for (index, servo) in servos.iter().enumerate() {
        let [min, neutral, max] = servo.map.pulses_us();
        let name = servo.name.replace(['\r', '\n'], " ");
        let _ = writeln!(text, "// servo {index}: {name}, {min} to {max}, neutral {neutral}");
    }
    for track in tracks {
        text += &constant(track);
    }
    text
}

fn constant(track: &PulseTrack<'_>) -> String {
    let name = identifier(track.motion).to_uppercase();
    let frames = track.whole_us();
    let mut text = format!(
        "\n/// {}\npub static {name}_US: [[u16; {}]; {}] = [\n",
        credit(track.motion),
        track.servos.len(),
        frames.len()
    );
    for frame in &frames {
        let _ = writeln!(text, "    {frame:?},");
    }
    let _ = write!(
        text,
        "];\n/// Frames of [`{name}_US`] in 1000 s.\npub const {name}_MILLIHZ: u32 = {:.0};\n",
        track.motion.rate_hz * 1000.0
    );
    text
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;
    use crate::bake::specimen;

    #[test]
    fn numbers_come_back() {
        let motions = specimen::character(2);
        let servos = specimen::servos(&motions[0]);
        let tracks = specimen::tracks(&motions, &servos);
        let text = emit(&tracks);
        for track in &tracks {
            let name = format!("{}_US: [[u16; ", identifier(track.motion).to_uppercase());
            let body = text.split_once(&name).unwrap().1.split_once("= [\n").unwrap().1;
            let rows = body.lines().take_while(|line| *line != "];");
            let read: Vec<Vec<u16>> = rows
                .map(|row| serde_json::from_str(row.trim().trim_end_matches(',')).unwrap())
                .collect();
            assert_eq!(read, track.whole_us());
        }
    }

    #[test]
    fn file_compiles_as_a_library_without_std() {
        let motion = specimen::character(1).remove(0);
        let servos = specimen::servos(&motion);
        let track = PulseTrack::new(&motion, &servos, &mut Vec::new());
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("motion.rs");
        let text = emit(std::slice::from_ref(&track));
        std::fs::write(&source, format!("#![no_std]\n#![deny(warnings)]\n{text}")).unwrap();
        let mut compiler = Command::new("rustc");
        compiler.args(["--edition=2024", "--crate-type=lib", "--emit=metadata", "--out-dir"]);
        let Ok(output) = compiler.args([folder.path(), &source]).output() else {
            eprintln!("SKIPPED: no `rustc`; the file was read by the parser of this test only");
            return;
        };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
