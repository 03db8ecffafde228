//! Biovision hierarchy text → joints and raw channel values.
//!
//! Why here: the format has no standard but a known grammar: `HIERARCHY`, nested `ROOT`/`JOINT`/`End Site` blocks of
//! `OFFSET` and `CHANNELS`, then `MOTION`, `Frames:`, `Frame Time:` and one line a frame. A stack of open joints instead
//! of recursion takes any depth of nesting; keywords are compared without case; line ends and blanks may be any.

use std::path::Path;

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
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line));
    let is_motion = |line: &str| line.trim().eq_ignore_ascii_case("MOTION");
    let mut tokens = Vec::new();
    let mut has_motion = false;
    for (number, line) in lines.by_ref() {
        has_motion = is_motion(line);
        if has_motion {
            break;
        }
        let spaced = line.replace('{', " { ").replace('}', " } ");
        tokens.extend(
            spaced
                .split_whitespace()
                .map(|word| (number, word.to_string())),
        );
    }
    let joints = Hierarchy::parse(file, tokens)?;
    if !has_motion {
        return Err(Error::bad_input(
            file,
            "MOTION",
            "absent",
            "a MOTION section",
            EXPORT_AGAIN,
        ));
    }
    let lines: Vec<(usize, &str)> = lines.filter(|(_, line)| !line.trim().is_empty()).collect();
    motion(file, joints, &lines)
}

const EXPORT_AGAIN: &str = "export the file again; it may be cut short";

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
        let mut hierarchy = Self {
            file,
            words: words.into_iter(),
            line: 1,
            joints: Vec::new(),
            open: Vec::new(),
        };
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
        match (
            word.to_ascii_uppercase().as_str(),
            self.open.last().copied(),
        ) {
            ("ROOT", None) if self.joints.is_empty() => self.open_joint(None),
            ("ROOT", None) => {
                let expected = "one body: a second root has no place relative to the first";
                Err(self.refuse(
                    "a second ROOT",
                    expected,
                    "export each body to its own file",
                ))
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
        self.joints.push(Joint {
            name,
            parent,
            offset: [0.0; 3],
            channels: Vec::new(),
        });
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
        let count = word
            .parse::<usize>()
            .ok()
            .filter(|&count| count <= CHANNELS_MAX);
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
        Error::bad_input(
            self.file,
            format!("line {}", self.line),
            value,
            expected,
            remedy,
        )
    }
}

const CORRECT: &str = "correct the line or export the file again";
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

/// Parses `Frames:`, `Frame Time:` and the frames, from lines that are not blank.
fn motion(file: &Path, joints: Vec<Joint>, lines: &[(usize, &str)]) -> Result<Bvh> {
    let frame_count = header_value(file, lines.first(), "Frames:")?;
    let frame_time_s = header_value(file, lines.get(1), "Frame Time:")?;
    if frame_time_s <= 0.0 {
        let expected = "a time in seconds above 0";
        return Err(Error::bad_input(
            file,
            "Frame Time",
            frame_time_s,
            expected,
            CORRECT,
        ));
    }
    let mut bvh = Bvh {
        joints,
        frame_time_s,
        values: Vec::new(),
    };
    if bvh.channel_count() == 0 {
        let expected = "at least one channel";
        return Err(Error::bad_input(
            file,
            "CHANNELS",
            "0 in all",
            expected,
            EXPORT_AGAIN,
        ));
    }
    let frames = &lines[2..];
    if frames.len() as f64 != frame_count {
        let value = format!("{} lines", frames.len());
        let expected = format!("{frame_count} as Frames: says");
        return Err(Error::bad_input(
            file,
            "motion",
            value,
            expected,
            EXPORT_AGAIN,
        ));
    }
    for (number, line) in frames {
        frame(file, *number, line, &mut bvh)?;
    }
    Ok(bvh)
}

fn header_value(file: &Path, line: Option<&(usize, &str)>, key: &str) -> Result<f64> {
    let (number, text) = line.copied().unwrap_or((0, ""));
    let value = text
        .trim()
        .get(..key.len())
        .filter(|start| start.eq_ignore_ascii_case(key))
        .and_then(|_| text.trim()[key.len()..].trim().parse::<f64>().ok())
        .filter(|value| value.is_finite());
    value.ok_or_else(|| {
        let (field, value) = match number {
            0 => ("end of file".to_string(), "nothing".to_string()),
            _ => (format!("line {number}"), format!("{text:?}")),
        };
        Error::bad_input(
            file,
            field,
            value,
            format!("{key} and a number"),
            EXPORT_AGAIN,
        )
    })
}

fn frame(file: &Path, line_number: usize, line: &str, bvh: &mut Bvh) -> Result<()> {
    let channel_count = bvh.channel_count();
    let start = bvh.values.len();
    for (index, word) in line.split_whitespace().enumerate() {
        let value = word.parse::<f64>().map_err(|_| {
            let field = format!("line {line_number}, value {}", index + 1);
            Error::bad_input(file, field, word, "a number", CORRECT)
        })?;
        bvh.values.push(value);
    }
    let found = bvh.values.len() - start;
    if found != channel_count {
        let field = format!("line {line_number}");
        let expected = format!("{channel_count}, one per channel");
        let value = format!("{found} numbers");
        return Err(Error::bad_input(file, field, value, expected, EXPORT_AGAIN));
    }
    Ok(())
}
