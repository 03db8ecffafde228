//! What the device said: its poses and its use of memory.
//!
//! In:  lines of `cortex-m/src/bin/decode_cases.rs`, each a word and hexadecimal numbers of eight digits.
//! Out: [`Transcript`] to `parity.rs`.

use serde::Serialize;

use crate::error::{Error, Result};

/// Memory that the program used on the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Ram {
    /// Statics.
    pub static_bytes: u32,
    /// Deepest stack; workspace, code and pose lie there.
    pub stack_bytes_max: u32,
}

/// Everything a program printed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transcript {
    /// Channels of each pose, Q15.16 in channel units. // (pose, channel)
    pub poses: Vec<Vec<i32>>,
    /// Present when the program reached its end.
    pub ram: Option<Ram>,
}

impl Transcript {
    /// Takes one line in; lines that begin with no known word are remarks for humans.
    ///
    /// # Errors
    /// [`Error::Firmware`] for a known word with anything but its numbers behind it.
    pub fn read_line(&mut self, line: &str) -> Result<()> {
        match line.split_once(' ') {
            Some(("pose", digits)) => self.poses.push(numbers(line, digits)?),
            Some(("ram", digits)) => {
                let numbers = numbers(line, digits)?;
                let &[static_bytes, stack_bytes_max] = numbers.as_slice() else {
                    return Err(unreadable(line));
                };
                let [static_bytes, stack_bytes_max] =
                    [static_bytes, stack_bytes_max].map(i32::cast_unsigned);
                self.ram = Some(Ram { static_bytes, stack_bytes_max });
            }
            _ => {}
        }
        Ok(())
    }
}

/// Splits `digits` into two's complement numbers.
fn numbers(line: &str, digits: &str) -> Result<Vec<i32>> {
    let (chunks, rest) = digits.as_bytes().as_chunks::<8>();
    if !rest.is_empty() {
        return Err(unreadable(line));
    }
    chunks
        .iter()
        .map(|chunk| {
            let text = std::str::from_utf8(chunk).map_err(|_| unreadable(line))?;
            let number = u32::from_str_radix(text, 16).map_err(|_| unreadable(line))?;
            Ok(number.cast_signed())
        })
        .collect()
}

fn unreadable(line: &str) -> Error {
    let reason = format!("unreadable line of {} characters", line.len());
    Error::Firmware { reason, log: line.chars().take(80).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pose_line_with_a_missing_digit_is_rejected() {
        assert!(Transcript::default().read_line("pose 0000000100000").is_err());
    }

    #[test]
    fn pose_line_with_a_letter_that_is_no_digit_is_rejected() {
        assert!(Transcript::default().read_line("pose 0000000g").is_err());
        assert!(Transcript::default().read_line("pose 0000000é").is_err());
    }

    #[test]
    fn ram_line_with_one_number_is_rejected() {
        assert!(Transcript::default().read_line("ram 00000001").is_err());
    }

    #[test]
    fn poses_and_ram_are_read_and_remarks_skipped() {
        let mut transcript = Transcript::default();
        for line in ["", "error: none", "pose 00010000ffffffff", "ram 0000001000001000"] {
            transcript.read_line(line).unwrap();
        }
        assert_eq!(transcript.poses, [[65_536, -1]]);
        let ram = Ram { static_bytes: 16, stack_bytes_max: 4096 };
        assert_eq!(transcript.ram, Some(ram));
    }
}
