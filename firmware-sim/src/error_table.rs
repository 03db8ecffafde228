//! From pairs of poses to the rows of the comparison table.
//!
//! In:  poses of the device's arithmetic and of the float model.
//! Out: [`ErrorRow`]s, one per kind of channel group (or per group), in units that one can see: degrees, millimetres.
//!
//! Why here: an error is measured per joint or servo, not per number. A rotation's error is an angle, a position's is
//! a distance.

use std::ops::Range;

use karakuri::{GroupKind, Unit};
use serde::Serialize;

use crate::checkpoint::Group;
use crate::rotation::angle_between_deg;

/// Error of six numbers that name no rotation at all.
const NO_ROTATION_DEG: f64 = 180.0;

/// How rows are made of groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// A row for all groups of the same kind and unit.
    PerKind,
    /// A row for each group.
    PerGroup,
}

/// The same moment twice, in channel units. // (channel)
#[derive(Clone, Debug, PartialEq)]
pub struct PosePair {
    /// By the device's arithmetic.
    pub device: Vec<f64>,
    /// By the float model.
    pub float: Vec<f64>,
}

/// Errors of one row, over all poses and groups that belong to it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorRow {
    /// Kind of the groups, or name of the group.
    pub group: String,
    /// Channels of the row.
    pub channel_count: usize,
    /// Unit of the errors.
    pub unit: &'static str,
    /// Root of the mean square.
    pub rms: f64,
    /// 99 of 100 errors are not larger.
    pub percentile_99: f64,
    /// The largest.
    pub max: f64,
    /// Variance of the float channels around their means over mean square error of the channels; `None` without error.
    pub signal_to_noise_db: Option<f64>,
}

/// Builds the rows; a row per kind appears where its first group stands.
pub fn error_rows(groups: &[Group], pairs: &[PosePair], rows: Rows) -> Vec<ErrorRow> {
    let mut found: Vec<(String, &'static str, Vec<Member>)> = Vec::new();
    let mut start = 0;
    for group in groups {
        let channels = start..start + group.kind.channel_count();
        start = channels.end;
        let (unit, factor) = visible_unit(group);
        let name = match rows {
            Rows::PerKind => group.kind.name(),
            Rows::PerGroup => &group.name,
        };
        let member = Member { kind: group.kind, channels, factor };
        match found.iter_mut().find(|row| row.0 == name && row.1 == unit) {
            Some(row) => row.2.push(member),
            None => found.push((name.to_owned(), unit, vec![member])),
        }
    }
    found.into_iter().map(|(name, unit, members)| error_row(name, unit, &members, pairs)).collect()
}

/// One group as part of a row.
struct Member {
    kind: GroupKind,
    channels: Range<usize>,
    /// Visible units per channel unit.
    factor: f64,
}

impl Member {
    /// Error of one pose, in the visible unit.
    fn error(&self, pair: &PosePair) -> f64 {
        let (device, float) =
            (&pair.device[self.channels.clone()], &pair.float[self.channels.clone()]);
        if self.kind == GroupKind::Rotation6d {
            let angle = device.try_into().ok().zip(float.try_into().ok());
            return angle
                .and_then(|(device, float)| angle_between_deg(device, float))
                .unwrap_or(NO_ROTATION_DEG);
        }
        let square: f64 = device.iter().zip(float).map(|(d, f)| (d - f) * (d - f)).sum();
        square.sqrt() * self.factor
    }

    /// Sums over poses and channels: (signal, noise), in squares of the channel unit times `factor`.
    fn powers(&self, pairs: &[PosePair]) -> (f64, f64) {
        let (mut signal, mut noise) = (0.0, 0.0);
        for channel in self.channels.clone() {
            let values = || pairs.iter().map(move |pair| pair.float[channel]);
            let mean = values().sum::<f64>() / pairs.len().max(1) as f64;
            let deviations = values().map(|value| value - mean);
            signal += deviations.map(|deviation| deviation * deviation).sum::<f64>();
            let errors = pairs.iter().map(|pair| pair.device[channel] - pair.float[channel]);
            noise += errors.map(|error| error * error).sum::<f64>();
        }
        (signal * self.factor * self.factor, noise * self.factor * self.factor)
    }
}

fn error_row(
    group: String,
    unit: &'static str,
    members: &[Member],
    pairs: &[PosePair],
) -> ErrorRow {
    let of_member = |member| pairs.iter().map(move |pair| Member::error(member, pair));
    let mut errors: Vec<f64> = members.iter().flat_map(of_member).collect();
    errors.sort_unstable_by(f64::total_cmp);
    let mean_square =
        errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64;
    let powers = members.iter().map(|member| member.powers(pairs));
    let (signal, noise) =
        powers.fold((0.0, 0.0), |sums, powers| (sums.0 + powers.0, sums.1 + powers.1));
    ErrorRow {
        group,
        channel_count: members.iter().map(|member| member.channels.len()).sum(),
        unit,
        rms: mean_square.sqrt(),
        percentile_99: percentile(&errors, 0.99),
        max: errors.last().copied().unwrap_or_default(),
        signal_to_noise_db: (noise > 0.0).then(|| 10.0 * (signal / noise).log10()),
    }
}

/// The smallest of the sorted values that is not less than this share of them; 0 of none.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let rank = (sorted.len() as f64 * share).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}

/// The unit in which an error is shown, and how many of it a channel unit is.
fn visible_unit(group: &Group) -> (&'static str, f64) {
    match (group.kind, group.unit) {
        (GroupKind::Rotation6d, _) => ("deg", 1.0),
        (_, Unit::Radian) => ("deg", 1.0_f64.to_degrees()),
        (_, Unit::Degree) => ("deg", 1.0),
        (_, Unit::Metre) => ("mm", 1000.0),
        (_, Unit::Centimetre) => ("mm", 10.0),
        (_, Unit::Millimetre) => ("mm", 1.0),
        (_, Unit::One | Unit::Microsecond) => (group.unit.suffix(), 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(name: &str, kind: GroupKind, unit: Unit) -> Group {
        Group { name: name.to_owned(), kind, unit }
    }

    #[test]
    fn no_poses_give_rows_of_zeros() {
        let rows = error_rows(&[group("a", GroupKind::Scalar, Unit::Degree)], &[], Rows::PerKind);
        assert_eq!((rows[0].rms, rows[0].max, rows[0].signal_to_noise_db), (0.0, 0.0, None));
    }

    #[test]
    fn errors_are_shown_in_degrees_and_millimetres() {
        let groups = [
            group("neck", GroupKind::Scalar, Unit::Radian),
            group("hand", GroupKind::Position, Unit::Metre),
            group("hip", GroupKind::Rotation6d, Unit::One),
        ];
        let float = vec![0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let device = vec![0.1, 0.003, 0.0, 0.004, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0];
        let rows = error_rows(&groups, &[PosePair { device, float }], Rows::PerKind);
        let found: Vec<_> =
            rows.iter().map(|row| (row.group.as_str(), row.unit, row.max)).collect();
        let expected = [
            ("scalar", "deg", 0.1_f64.to_degrees()),
            ("position", "mm", 5.0),
            ("rotation6d", "deg", 90.0),
        ];
        for (found, expected) in found.iter().zip(expected) {
            assert_eq!((found.0, found.1), (expected.0, expected.1));
            assert!((found.2 - expected.2).abs() < 1e-6, "{found:?} instead of {expected:?}");
        }
    }

    #[test]
    fn kinds_of_different_units_do_not_share_a_row() {
        let groups = [
            group("a", GroupKind::Scalar, Unit::Degree),
            group("b", GroupKind::Scalar, Unit::Microsecond),
            group("c", GroupKind::Scalar, Unit::Radian),
        ];
        let channels =
            |rows: Vec<ErrorRow>| rows.iter().map(|row| row.channel_count).collect::<Vec<_>>();
        assert_eq!(channels(error_rows(&groups, &[], Rows::PerKind)), [2, 1]);
        assert_eq!(channels(error_rows(&groups, &[], Rows::PerGroup)), [1, 1, 1]);
    }

    #[test]
    fn signal_to_noise_of_a_tenth_is_twenty_decibels() {
        let pair =
            |float: f64, error: f64| PosePair { device: vec![float + error], float: vec![float] };
        let pairs = [pair(-1.0, 0.1), pair(1.0, -0.1)];
        let rows = error_rows(&[group("a", GroupKind::Scalar, Unit::One)], &pairs, Rows::PerKind);
        assert!((rows[0].signal_to_noise_db.unwrap() - 20.0).abs() < 1e-9);
        assert!((rows[0].rms - 0.1).abs() < 1e-12);
    }

    #[test]
    fn percentile_is_a_value_that_occurred() {
        let sorted: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!(percentile(&sorted, 0.99), 99.0);
        assert_eq!(percentile(&[5.0], 0.99), 5.0);
    }
}
