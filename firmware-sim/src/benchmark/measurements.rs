//! What the counting program said, joined with what the counter wrote.
//!
//! In:  lines of `cortex-m/src/bin/count_instructions.rs`, regions of `region_counts.rs`.
//! Out: [`Measurements`] to `row.rs`.

use std::collections::BTreeMap;

use crate::error::{Error, Result};
use crate::region_counts::RegionCounts;

/// One run, by names.
#[derive(Clone, Debug, Default)]
pub struct Measurements {
    /// Names of the regions, in order.
    names: Vec<String>,
    /// Their counts, in the same order.
    counts: Vec<RegionCounts>,
    /// Numbers of bytes and of repetitions.
    numbers: BTreeMap<String, u64>,
}

impl Measurements {
    /// Takes one line in: `region <name>` or `number <name> <number>`; others are remarks for humans.
    ///
    /// # Errors
    /// [`Error::Firmware`] for a line `number` without one.
    pub fn read_line(&mut self, line: &str) -> Result<()> {
        let unreadable = || Error::Firmware { reason: "unreadable line".into(), log: line.into() };
        match line.split_once(' ') {
            Some(("region", name)) => self.names.push(name.to_owned()),
            Some(("number", words)) => {
                let (name, number) = words.split_once(' ').ok_or_else(unreadable)?;
                let number = number.parse().map_err(|_| unreadable())?;
                self.numbers.insert(name.to_owned(), number);
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes the counts in, one for each name.
    ///
    /// # Errors
    /// [`Error::Firmware`] if there are more or fewer.
    pub fn add_counts(&mut self, counts: Vec<RegionCounts>) -> Result<()> {
        if counts.len() != self.names.len() {
            let log = format!("{} names, {} counts", self.names.len(), counts.len());
            return Err(Error::Firmware { reason: "incomplete output".into(), log });
        }
        self.counts = counts;
        Ok(())
    }

    /// All regions with their names, in the order of the run.
    pub fn regions(&self) -> impl Iterator<Item = (&str, &RegionCounts)> {
        self.names.iter().map(String::as_str).zip(&self.counts)
    }

    /// Instructions of a region.
    ///
    /// # Errors
    /// [`Error::Firmware`] if there is none of this name.
    pub fn instructions(&self, name: &str) -> Result<u64> {
        let region = self.regions().find(|(found, _)| *found == name);
        region.map(|(_, counts)| counts.instructions).ok_or_else(|| missing(name))
    }

    /// A number that the program printed.
    ///
    /// # Errors
    /// [`Error::Firmware`] if there is none of this name.
    pub fn number(&self, name: &str) -> Result<u64> {
        self.numbers.get(name).copied().ok_or_else(|| missing(name))
    }
}

fn missing(name: &str) -> Error {
    Error::Firmware { reason: "incomplete output".into(), log: format!("nothing about {name}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_without_its_number_is_rejected() {
        assert!(Measurements::default().read_line("number workspace").is_err());
        assert!(Measurements::default().read_line("number workspace x").is_err());
    }

    #[test]
    fn name_without_count_is_rejected() {
        let mut measurements = Measurements::default();
        measurements.read_line("region load").unwrap();
        assert!(measurements.add_counts(Vec::new()).is_err());
        assert!(measurements.number("workspace").is_err());
    }

    #[test]
    fn names_and_counts_are_joined_in_order() {
        let mut measurements = Measurements::default();
        for line in ["a remark", "region load", "number workspace 12", "region layer 1"] {
            measurements.read_line(line).unwrap();
        }
        let counts = |instructions| RegionCounts { instructions, addresses: Vec::new() };
        measurements.add_counts(vec![counts(1), counts(2)]).unwrap();
        assert_eq!(measurements.instructions("layer 1").unwrap(), 2);
        assert_eq!(measurements.number("workspace").unwrap(), 12);
    }
}
