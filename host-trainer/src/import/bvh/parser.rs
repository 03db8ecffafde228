//! Biovision hierarchy text → joints and raw channel values.
//!
//! Why here: the format has no standard but a known grammar: `HIERARCHY`, nested
//! `ROOT`/`JOINT`/`End Site` blocks of `OFFSET` and `CHANNELS`, then `MOTION`, `Frames:`, `Frame
//! Time:` and one line a frame. A stack of open joints instead of recursion takes any depth of
//! nesting; keywords are compared without case; line ends and blanks may be any.

use std::path::Path;

use super::motion;
use crate::error::{Error, Result};

/// One parsed file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bvh {
    /// In order of declaration, which is that of the channels; parents precede children.
    pub joints: Vec<Joint>,
    pub frame_time_s: f64,
    /// Degrees and the file's unit of length. // (frame, channel)
    pub values: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Joint {
    pub name: String,
    pub parent: Option<usize>,
    pub offset: [f64; 3],
    pub channels: Vec<Channel>,
}

/// What one number of a frame does to its joint; 0, 1, 2 are the axes x, y, z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    /// Replaces one component of the offset.
    Position(usize),
    /// Turns about one axis, in degrees; the joint's rotations multiply in listed order.
    Rotation(usize),
}

impl Bvh {
    /// Numbers per frame.
    pub fn channel_count(&self) -> usize {
        self.joints.iter().map(|joint| joint.channels.len()).sum()
    }
}

/// Parses a whole file; NaN and infinite motion values pass, as the caller decides on them.
pub(super) fn parse(file: &Path, bytes: &[u8]) -> Result<Bvh> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let field = format!("byte {}", error.valid_up_to());
        Error::bad_input(file, field, "no text", "a BVH file", EXPORT_AGAIN)
    })?;
    let text = text.trim_start_matches('\u{feff}');
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    let is_motion = |line: &str| line.trim().eq_ignore_ascii_case("MOTION");
    let mut tokens = Vec::new();
    let mut has_motion = false;
    for (number, line) in lines.by_ref() {
        has_motion = is_motion(line);
        if has_motion {
            break;
        }
        let spaced = line.replace('{', " { ").replace('}', " } ");
        tokens.extend(spaced.split_whitespace().map(|word| (number, word.to_string())));
    }
    let joints = Hierarchy::parse(file, tokens)?;
    if !has_motion {
        return Err(Error::bad_input(file, "MOTION", "absent", "a MOTION section", EXPORT_AGAIN));
    }
    let lines: Vec<(usize, &str)> = lines.filter(|(_, line)| !line.trim().is_empty()).collect();
    motion::parse(file, joints, &lines)
}

pub(super) const EXPORT_AGAIN: &str = "export the file again; it may be cut short";

/// The joints found so far and those whose block is still open.
struct Hierarchy<'a> {
    file: &'a Path,
    words: std::vec::IntoIter<(usize, String)>,
    line: usize,
    joints: Vec<Joint>,
    open: Vec<usize>,
}

impl<'a> Hierarchy<'a> {
    fn parse(file: &'a Path, words: Vec<(usize, String)>) -> Result<Vec<Joint>> {
        let mut hierarchy =
            Self { file, words: words.into_iter(), line: 1, joints: Vec::new(), open: Vec::new() };
        hierarchy.expect("HIERARCHY")?;
        while let Some((line, word)) = hierarchy.words.next() {
            hierarchy.line = line;
            hierarchy.statement(&word)?;
        }
        if let Some(&joint) = hierarchy.open.last() {
            let value = format!("open at joint {}", hierarchy.joints[joint].name);
            return Err(hierarchy.refuse(value, "a closing brace", EXPORT_AGAIN));
        }
        if hierarchy.joints.is_empty() {
            return Err(hierarchy.refuse("no joint", "ROOT", EXPORT_AGAIN));
        }
        Ok(hierarchy.joints)
    }

    fn statement(&mut self, word: &str) -> Result<()> {
        match (word.to_ascii_uppercase().as_str(), self.open.last().copied()) {
            ("ROOT", None) if self.joints.is_empty() => self.open_joint(None),
            ("ROOT", None) => {
                let expected = "one body: a second root has no place relative to the first";
                Err(self.refuse("a second ROOT", expected, "export each body to its own file"))
            }
            ("JOINT", Some(parent)) => self.open_joint(Some(parent)),
            ("END", Some(_)) => self.end_site(),
            ("OFFSET", Some(joint)) => {
                self.joints[joint].offset = self.offset()?;
                Ok(())
            }
            ("CHANNELS", Some(joint)) => {
                self.joints[joint].channels = self.channels()?;
                Ok(())
            }
            ("}", Some(_)) => {
                self.open.pop();
                Ok(())
            }
            (_, Some(_)) => {
                Err(self.refuse(word, "JOINT, End Site, OFFSET, CHANNELS or }", CORRECT))
            }
            (_, None) => Err(self.refuse(word, "ROOT or MOTION", CORRECT)),
        }
    }

    fn open_joint(&mut self, parent: Option<usize>) -> Result<()> {
        let mut words = Vec::new();
        loop {
            match self.next("a joint's name and {")? {
                word if word == "{" => break,
                word => words.push(word),
            }
        }
        let name = words.join(" ");
        if self.joints.len() == JOINTS_MAX {
            let expected = format!("at most {JOINTS_MAX} joints");
            return Err(self.refuse("one joint more", &expected, "remove joints"));
        }
        if name.is_empty() || self.joints.iter().any(|joint| joint.name == name) {
            let value = format!("joint name {name:?}");
            return Err(self.refuse(value, "a name that no other joint has", "rename the joint"));
        }
        self.open.push(self.joints.len());
        self.joints.push(Joint { name, parent, offset: [0.0; 3], channels: Vec::new() });
        Ok(())
    }

    /// Skips the tip of a limb: it never moves relative to its joint.
    fn end_site(&mut self) -> Result<()> {
        self.expect("Site")?;
        self.expect("{")?;
        self.expect("OFFSET")?;
        self.offset()?;
        self.expect("}")
    }

    fn offset(&mut self) -> Result<[f64; 3]> {
        let mut offset = [0.0; 3];
        for component in &mut offset {
            let word = self.next("three numbers")?;
            let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
            *component = number.ok_or_else(|| self.refuse(&word, "a finite number", CORRECT))?;
        }
        Ok(offset)
    }

    fn channels(&mut self) -> Result<Vec<Channel>> {
        let word = self.next("the number of channels")?;
        let count = word.parse::<usize>().ok().filter(|&count| count <= CHANNELS_MAX);
        let expected = "a count up to 6";
        let count = count.ok_or_else(|| self.refuse(&word, expected, CORRECT))?;
        let mut channels: Vec<Channel> = Vec::new();
        for _ in 0..count {
            let word = self.next("a channel's name")?;
            let channel = channel(&word).filter(|channel| !channels.contains(channel));
            let expected =
                "Xposition, Yposition, Zposition, Xrotation, Yrotation or Zrotation, once";
            channels.push(channel.ok_or_else(|| self.refuse(&word, expected, CORRECT))?);
        }
        Ok(channels)
    }

    fn next(&mut self, expected: &str) -> Result<String> {
        let (line, word) = self
            .words
            .next()
            .ok_or_else(|| self.refuse("the end of the hierarchy", expected, EXPORT_AGAIN))?;
        self.line = line;
        Ok(word)
    }

    fn expect(&mut self, expected: &str) -> Result<()> {
        let word = self.next(expected)?;
        match word.eq_ignore_ascii_case(expected) {
            true => Ok(()),
            false => Err(self.refuse(word, expected, CORRECT)),
        }
    }

    fn refuse(&self, value: impl ToString, expected: &str, remedy: &str) -> Error {
        Error::bad_input(self.file, format!("line {}", self.line), value, expected, remedy)
    }
}

pub(super) const CORRECT: &str = "correct the line or export the file again";
const CHANNELS_MAX: usize = 6;

/// More than any body has; it bounds the work on a damaged file.
const JOINTS_MAX: usize = 1024;

fn channel(word: &str) -> Option<Channel> {
    let word = word.to_ascii_lowercase();
    let axis = "xyz".find(word.chars().next()?)?;
    match word.get(1..)? {
        "position" => Some(Channel::Position(axis)),
        "rotation" => Some(Channel::Rotation(axis)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::super::support::assert_refused;
    use super::*;

    const ARM: &str = "HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Upper Arm
  {
    OFFSET 10 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 5 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.05
0 90 0 0 0 0 10 20 30
1 91 1 0 0 0 11 21 31
";

    fn parsed(text: &str) -> Result<Bvh> {
        parse(Path::new("walk.bvh"), text.as_bytes())
    }

    /// Replaces a part of the arm that must be there, and expects a refusal that says `words`.
    fn refused(from: &str, to: &str, words: &[&str]) {
        assert!(ARM.contains(from));
        assert_refused(parsed(&ARM.replacen(from, to, 1)), &[&["walk.bvh"], words].concat());
    }

    #[test]
    fn file_cut_anywhere_before_its_last_number_is_refused() {
        // A cut inside the last number leaves a number; nothing in the format could tell.
        for length in 0..ARM.len() - 2 {
            assert_refused(parsed(&ARM[..length]), &["walk.bvh"]);
        }
        assert!(parsed(ARM.trim_end()).is_ok());
    }

    #[test]
    fn several_roots_are_refused_with_the_reason() {
        let words = ["line 16", "a second ROOT", "no place relative to the first", "each body"];
        refused("MOTION", "ROOT Tail { OFFSET 0 0 0 CHANNELS 0 }\nMOTION", &words);
    }

    #[test]
    fn structure_errors_are_refused_with_their_line() {
        refused("HIERARCHY", "HIERACHY", &["line 1 is HIERACHY", "HIERARCHY"]);
        refused("ROOT", "JOINT", &["line 2 is JOINT", "ROOT or MOTION"]);
        refused("JOINT Upper Arm", "BONE Upper Arm", &["line 6 is BONE", "End Site"]);
        refused("  }\n}\n", "  }\n", &["open at joint Hips", "a closing brace"]);
        refused("End Site", "End", &["line 11 is {", "Site"]);
        refused("Upper Arm", "Hips", &["line 7", "joint name \"Hips\"", "rename"]);
        refused("Upper Arm", "", &["joint name \"\""]);
        refused("OFFSET 10 0 0", "OFFSET 10 0", &["line 9 is CHANNELS", "a finite number"]);
        refused("OFFSET 10 0 0", "OFFSET 10 nan 0", &["line 8 is nan", "a finite number"]);
        refused("}\nMOTION", "}\n}\nMOTION", &["line 16 is }"]);
    }

    #[test]
    fn channels_that_do_not_exist_are_refused() {
        refused("CHANNELS 3", "CHANNELS 7", &["line 9 is 7", "a count up to 6"]);
        refused("CHANNELS 3", "CHANNELS -1", &["line 9 is -1"]);
        refused("CHANNELS 3 Zrotation", "CHANNELS 3 Zscale", &["Zscale", "Xposition"]);
        refused("3 Zrotation", "3 Xrotation", &["line 9 is Xrotation", "once"]);
        refused("3 Zrotation", "3 é", &["é"]);
        let still = "HIERARCHY ROOT a { OFFSET 0 0 0 }\nMOTION\nFrames: 1\nFrame Time: 1\n";
        assert_refused(parsed(still), &["CHANNELS is 0 in all"]);
    }

    #[test]
    fn motion_headers_that_mean_nothing_are_refused() {
        refused("Frames: 2", "Frames: x", &["line 17", "Frames: and a number"]);
        refused("Frames: 2", "Frame Time: 2", &["line 17", "Frames:"]);
        refused("Frames: 2", "Frames: 3", &["motion is 2 lines", "3 as Frames: says"]);
        refused("Frames: 2", "Frames: 2.5", &["2.5 as Frames: says"]);
        for time in ["0", "-1", "nan", "x"] {
            refused("Frame Time: 0.05", &format!("Frame Time: {time}"), &["Frame Time"]);
        }
    }

    #[test]
    fn frames_of_the_wrong_width_are_refused_with_their_line() {
        refused("10 20 30", "10 20", &["line 19 is 8 numbers", "9, one per channel"]);
        refused("10 20 30", "10 20 30 40", &["line 19 is 10 numbers"]);
        refused("10 20 30", "10 2o 30", &["line 19, value 8 is 2o", "a number"]);
    }

    #[test]
    fn bytes_that_are_no_text_are_refused() {
        assert_refused(parse(Path::new("walk.bvh"), b"HIERARCHY \xff"), &["byte 10 is no text"]);
    }

    #[test]
    fn nesting_of_any_depth_ends_in_a_result() {
        let deep = |count: usize| {
            let open: String =
                (1..count).map(|i| format!("JOINT j{i} {{ OFFSET 0 1 0 CHANNELS 0 ")).collect();
            format!(
                "HIERARCHY ROOT a {{ OFFSET 0 0 0 CHANNELS 1 Xrotation {open} {} \nMOTION\n\
                 Frames: 1\nFrame Time: 1\n0\n",
                "}".repeat(count)
            )
        };
        assert_eq!(parsed(&deep(JOINTS_MAX)).unwrap().joints.len(), JOINTS_MAX);
        assert_refused(parsed(&deep(JOINTS_MAX + 1)), &["at most 1024 joints"]);
    }

    #[test]
    fn joints_channels_and_values_are_read() {
        let bvh = parsed(ARM).unwrap();
        let arm = &bvh.joints[1];
        assert_eq!(
            (arm.name.as_str(), arm.parent, arm.offset),
            ("Upper Arm", Some(0), [10.0, 0.0, 0.0])
        );
        let rotations = [Channel::Rotation(2), Channel::Rotation(0), Channel::Rotation(1)];
        assert_eq!(arm.channels, rotations);
        assert_eq!((bvh.channel_count(), bvh.values.len(), bvh.frame_time_s), (9, 18, 0.05));
        assert_eq!(bvh.values[6..10], [10.0, 20.0, 30.0, 1.0]);
    }

    #[test]
    fn blanks_line_ends_case_and_attached_braces_do_not_matter() {
        let bvh = parsed(ARM).unwrap();
        let variants = [
            ARM.replace('\n', "\r\n"),
            ARM.replace(' ', "\t")
                .replace("Upper\tArm", "Upper Arm")
                .replace("Frame\tT", "Frame T"),
            ARM.replace("\n{", "{").replace("\n  {", "{"),
            ARM.to_uppercase().replace("UPPER ARM", "Upper Arm").replace("HIPS", "Hips"),
            format!("\u{feff}{}\n\n", ARM.replace("Frames: 2", "Frames:2")),
        ];
        for text in variants {
            assert_eq!(parsed(&text).unwrap(), bvh, "{text}");
        }
    }

    /// The text of a file; the parser's inverse.
    fn emit(bvh: &Bvh) -> String {
        fn block(bvh: &Bvh, index: usize, text: &mut String) {
            let joint = &bvh.joints[index];
            let keyword = if joint.parent.is_none() { "ROOT" } else { "JOINT" };
            let [x, y, z] = joint.offset;
            *text += &format!(
                "{keyword} {}\n{{\nOFFSET {x} {y} {z}\nCHANNELS {}",
                joint.name,
                joint.channels.len()
            );
            for channel in &joint.channels {
                *text += &match channel {
                    Channel::Position(axis) => format!(" {}position", ["X", "Y", "Z"][*axis]),
                    Channel::Rotation(axis) => format!(" {}rotation", ["X", "Y", "Z"][*axis]),
                };
            }
            *text += "\n";
            for child in (0..bvh.joints.len()).filter(|&i| bvh.joints[i].parent == Some(index)) {
                block(bvh, child, text);
            }
            *text += "}\n";
        }
        let mut text = "HIERARCHY\n".to_string();
        block(bvh, 0, &mut text);
        let frames = bvh.values.chunks(bvh.channel_count());
        text += &format!("MOTION\nFrames: {}\nFrame Time: {}\n", frames.len(), bvh.frame_time_s);
        for frame in frames {
            let numbers: Vec<String> = frame.iter().map(f64::to_string).collect();
            text += &format!("{}\n", numbers.join(" "));
        }
        text
    }

    fn any_bvh() -> impl Strategy<Value = Bvh> {
        let channels = Just([0, 1, 2].map(Channel::Rotation).to_vec()).prop_shuffle();
        let joint = (channels, prop::array::uniform3(-1e3..1e3), any::<prop::sample::Index>());
        (prop::collection::vec(joint, 1..8), 1usize..5).prop_flat_map(|(joints, frame_count)| {
            let joints: Vec<Joint> = joints
                .into_iter()
                .enumerate()
                .map(|(index, (channels, offset, parent))| Joint {
                    name: format!("j{index}"),
                    // Only the last joint or one of its ancestors can be open, so a chain with the
                    // root's children.
                    parent: (index > 0).then(|| if parent.index(2) == 0 { 0 } else { index - 1 }),
                    offset,
                    channels,
                })
                .collect();
            let count = joints.len() * 3 * frame_count;
            prop::collection::vec(-180.0..180.0, count).prop_map(move |values| Bvh {
                joints: joints.clone(),
                frame_time_s: 0.05,
                values,
            })
        })
    }

    proptest! {
        #[test]
        fn any_hierarchy_survives_the_round_trip(bvh in any_bvh()) {
            prop_assert_eq!(parsed(&emit(&bvh)).unwrap(), bvh);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = parse(Path::new("a.bvh"), &bytes);
        }

        #[test]
        fn damaged_file_never_panics(index in 0usize..1000, text in "[ -~\n]{0,3}") {
            let index = index % ARM.len();
            let _ = parsed(&format!("{}{text}{}", &ARM[..index], &ARM[index + 1..]));
            let _ = parsed(&format!("{}{text}", &ARM[..index]));
        }

        #[test]
        fn arbitrary_words_never_panic(
            words in prop::collection::vec(
                prop::sample::select(vec![
                    "HIERARCHY", "ROOT", "JOINT", "End", "Site", "{", "}", "OFFSET", "CHANNELS",
                    "1", "3", "Xrotation", "a", "\nMOTION\n", "Frames: 1\n", "Frame Time: 1\n", "\n",
                ]),
                0..40,
            ),
        ) {
            let _ = parsed(&words.join(" "));
        }
    }
}
