//! What the instruction counter wrote: how often each address was executed in each region.
//!
//! In:  the text of `plugin/instruction_count.c`.
//! Out: one [`RegionCounts`] for each region, in the order of the run.

use crate::error::{Error, Result};

/// One marked region of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RegionCounts {
    /// All instructions.
    pub instructions: u64,
    /// Address, and how often the instruction there was executed.
    pub addresses: Vec<(u32, u64)>,
}

/// Reads the counter's file.
///
/// # Errors
/// [`Error::Firmware`] for a line of another form, or a region whose addresses do not add up to its sum.
pub fn parse_region_counts(text: &str) -> Result<Vec<RegionCounts>> {
    let mut regions: Vec<RegionCounts> = Vec::new();
    for line in text.lines() {
        let (first, count) = line.split_once(' ').ok_or_else(|| unreadable(line))?;
        let count: u64 = count.parse().map_err(|_| unreadable(line))?;
        if first == "region" {
            regions.push(RegionCounts { instructions: count, addresses: Vec::new() });
        } else {
            let address = u32::from_str_radix(first, 16).map_err(|_| unreadable(line))?;
            let region = regions.last_mut().ok_or_else(|| unreadable(line))?;
            region.addresses.push((address, count));
        }
    }
    let sum = |region: &RegionCounts| region.addresses.iter().map(|(_, count)| count).sum::<u64>();
    match regions.iter().find(|&region| sum(region) != region.instructions) {
        Some(region) => Err(unreadable(&format!("region {}", region.instructions))),
        None => Ok(regions),
    }
}

fn unreadable(line: &str) -> Error {
    let reason = "unreadable line of the instruction counter".to_owned();
    Error::Firmware { reason, log: line.chars().take(80).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_counts_are_rejected() {
        for text in ["region", "region x", "1c 2", "region 2\nxyz 2", "region 2\n1c 1"] {
            assert!(parse_region_counts(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn counts_are_read_region_by_region() {
        let regions = parse_region_counts("region 0\nregion 5\n1c 2\n38000020 3\n").unwrap();
        let addresses = vec![(0x1c, 2), (0x3800_0020, 3)];
        let expected = [RegionCounts::default(), RegionCounts { instructions: 5, addresses }];
        assert_eq!(regions, expected);
    }
}
