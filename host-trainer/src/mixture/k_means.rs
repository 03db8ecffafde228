//! Starting points for expectation maximisation: k-means++ seeds, moved by Lloyd's rounds.
//!
//! In:  points and a generator, from `expectation_maximization`.
//! Out: groups of points, back to it.
//!
//! Source: Arthur and Vassilvitskii 2007 (seeds); Lloyd 1982 (rounds).

use rand::distr::Distribution;
use rand::distr::weighted::WeightedIndex;
use rand::{Rng, RngExt};

/// Most rounds. Groups settle in a few; expectation maximisation does the rest.
const ROUND_COUNT_MAX: usize = 20;
/// Partial sums of a distance, so that it can run in vector registers.
const LANE_COUNT: usize = 8;

/// Points of one space, one after the other.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// Numbers per point; at least 1.
    pub dimension_count: usize,
    /// // (point, dimension)
    pub values: &'a [f64],
}

impl<'a> Points<'a> {
    /// Number of points.
    pub fn count(&self) -> usize {
        self.values.len() / self.dimension_count
    }

    /// Every point.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &'a [f64]> + Clone {
        self.values.chunks_exact(self.dimension_count)
    }

    fn get(&self, index: usize) -> &'a [f64] {
        &self.values[index * self.dimension_count..][..self.dimension_count]
    }
}

/// Square of the Euclidean distance.
pub fn square_distance(left: &[f64], right: &[f64]) -> f64 {
    let mut lanes = [0.0; LANE_COUNT];
    let left = left.chunks_exact(LANE_COUNT);
    let right = right.chunks_exact(LANE_COUNT);
    let rest = left.remainder().iter().zip(right.remainder());
    let rest: f64 = rest.map(|(a, b)| (a - b) * (a - b)).sum();
    for (left, right) in left.zip(right) {
        for ((lane, a), b) in lanes.iter_mut().zip(left).zip(right) {
            *lane += (a - b) * (a - b);
        }
    }
    rest + lanes.iter().sum::<f64>()
}

/// Groups the points around at most `count` centres; returns every point's group.
///
/// Points that coincide make fewer groups; a group may be empty.
pub fn cluster<R: Rng + ?Sized>(points: &Points, count: usize, rng: &mut R) -> Vec<usize> {
    let mut centres = seed_centres(points, count, rng);
    let mut groups = nearest_centres(points, &centres);
    for _ in 0..ROUND_COUNT_MAX {
        move_centres(points, &groups, &mut centres);
        let moved = nearest_centres(points, &centres);
        if moved == groups {
            break;
        }
        groups = moved;
    }
    groups
}

/// Every centre after the first is a point, drawn in proportion to its square distance from the
/// centres so far.
fn seed_centres<R: Rng + ?Sized>(points: &Points, count: usize, rng: &mut R) -> Vec<Vec<f64>> {
    let first = points.get(rng.random_range(0..points.count()));
    let mut centres = vec![first.to_vec()];
    let mut distances: Vec<f64> = points.iter().map(|p| square_distance(p, first)).collect();
    while centres.len() < count {
        // Fails when all points coincide with a centre: there is no further one to find.
        let Ok(by_distance) = WeightedIndex::new(&distances) else {
            break;
        };
        let centre = points.get(by_distance.sample(rng));
        for (distance, point) in distances.iter_mut().zip(points.iter()) {
            *distance = distance.min(square_distance(point, centre));
        }
        centres.push(centre.to_vec());
    }
    centres
}

fn nearest_centres(points: &Points, centres: &[Vec<f64>]) -> Vec<usize> {
    let nearest = |point: &[f64]| {
        let distances = centres.iter().map(|centre| square_distance(point, centre));
        let by_distance = |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1);
        distances.enumerate().min_by(by_distance).map_or(0, |(index, _)| index)
    };
    points.iter().map(nearest).collect()
}

/// Moves every centre to the mean of its group; the centre of an empty group stays.
fn move_centres(points: &Points, groups: &[usize], centres: &mut [Vec<f64>]) {
    for (index, centre) in centres.iter_mut().enumerate() {
        let members = || points.iter().zip(groups).filter(|&(_, &group)| group == index);
        let count = members().count();
        if count == 0 {
            continue;
        }
        centre.fill(0.0);
        for (point, _) in members() {
            for (sum, value) in centre.iter_mut().zip(point) {
                *sum += value / count as f64;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn group_count(groups: &[usize]) -> usize {
        groups.iter().collect::<std::collections::BTreeSet<_>>().len()
    }

    #[test]
    fn points_that_coincide_make_one_group() {
        let points = Points { dimension_count: 2, values: &[1.5; 20] };
        let groups = cluster(&points, 4, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(group_count(&groups), 1);
    }

    #[test]
    fn more_centres_than_distinct_points_make_a_group_each() {
        let points = Points { dimension_count: 1, values: &[0.0, 0.0, 5.0, 5.0, 9.0] };
        let groups = cluster(&points, 4, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(group_count(&groups), 3);
        assert_eq!(groups[0], groups[1]);
        assert_eq!(groups[2], groups[3]);
    }

    #[test]
    fn clouds_far_apart_make_a_group_each_from_every_start() {
        let values: Vec<f64> =
            (0..60).map(|i| 100.0 * (i % 3) as f64 + (i as f64 * 0.7).sin()).collect();
        let points = Points { dimension_count: 1, values: &values };
        for seed in 0..20 {
            let groups = cluster(&points, 3, &mut ChaCha8Rng::seed_from_u64(seed));
            assert_eq!(group_count(&groups), 3);
            assert!((3..60).all(|i| groups[i] == groups[i % 3]));
        }
    }

    #[test]
    fn square_distance_counts_lanes_and_remainder() {
        let left: Vec<f64> = (0..11).map(f64::from).collect();
        assert_eq!(square_distance(&left, &[0.0; 11]), 385.0);
    }
}
