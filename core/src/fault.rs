//! Why the servos stand still although nobody told them to.
//!
//! In:  what a stage notices itself, what the program around it knows.
//! Out: one code, latched by `servo.rs` until it is cleared.
//!
//! Why here: a body that stops must be able to say why, in a number that fits a telemetry frame and a blinking LED.

use core::fmt;

/// Why a [`ServoStage`](crate::ServoStage) holds still until [`clear_fault`](crate::ServoStage::clear_fault).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Fault {
    /// Nobody aimed for too long: decoding stopped. Look for what blocks the loop.
    StaleTarget,
    /// The loop itself stood still: the servos had stopped before this tick. Look for what blocks the loop.
    LateTick,
    /// The link to the host failed, or its commands were unusable.
    Link,
    /// The model cannot be used.
    Blob,
    /// Latched by the program around the stage, with a number of its own: an emergency stop, a supply that sags.
    External(u8),
}

impl Fault {
    /// The number for telemetry: 1 to 4, or 256 and more for [`External`](Self::External). 0 is no fault.
    pub const fn code(self) -> u16 {
        match self {
            Self::StaleTarget => 1,
            Self::LateTick => 2,
            Self::Link => 3,
            Self::Blob => 4,
            Self::External(number) => 0x100 | number as u16,
        }
    }

    /// The fault with this number, `None` where no fault has it.
    pub const fn from_code(code: u16) -> Option<Self> {
        match code {
            1 => Some(Self::StaleTarget),
            2 => Some(Self::LateTick),
            3 => Some(Self::Link),
            4 => Some(Self::Blob),
            0x100..=0x1FF => Some(Self::External(code as u8)),
            _ => None,
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StaleTarget => out.write_str("no target came in time"),
            Self::LateTick => out.write_str("a tick came too late"),
            Self::Link => out.write_str("the link failed"),
            Self::Blob => out.write_str("the model cannot be used"),
            Self::External(number) => write!(out, "fault {number} of the program"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_leads_back_to_its_fault_and_no_other_code_to_any() {
        let faults = (0..=u16::MAX).filter_map(|code| Some((code, Fault::from_code(code)?)));
        let mut count = 0;
        for (code, fault) in faults {
            assert_eq!(fault.code(), code);
            count += 1;
        }
        assert_eq!(count, 4 + 256);
    }
}
