//! How unlike one another motions are: all of them, those of one action, and from what was recorded.
//!
//! In:  features or crops of motions, and their actions.
//! Out: diversity, multimodality, MMS and APD.
//!
//! Sources: Guo et al., Action2Motion (diversity, multimodality); Cervantes et al., ECCV 2022 (MMS); Lu et al., ODMO,
//! ECCV 2022 (APD).

use rand::{Rng, RngExt};
use rayon::prelude::*;

use super::crop::Crops;

/// Pairs whose mean distance is the diversity.
const DIVERSITY_PAIRS: usize = 200;
/// Pairs of every action whose mean distance is the multimodality.
const MULTIMODALITY_PAIRS: usize = 20;

/// Mean distance of 200 pairs, drawn with replacement. // features: (motion, feature)
pub fn diversity<R: Rng + ?Sized>(features: &[f32], feature_count: usize, rng: &mut R) -> f64 {
    let rows: Vec<&[f32]> = features.chunks_exact(feature_count).collect();
    mean_of_pairs(&rows, DIVERSITY_PAIRS, rng)
}

/// Mean over the actions of the mean distance of 20 pairs of each, drawn with replacement. // actions: (motion)
pub fn multimodality<R: Rng + ?Sized>(
    features: &[f32],
    feature_count: usize,
    actions: &[usize],
    action_count: usize,
    rng: &mut R,
) -> f64 {
    let mut rows_of_action = vec![Vec::new(); action_count];
    for (row, &action) in features.chunks_exact(feature_count).zip(actions) {
        rows_of_action[action].push(row);
    }
    let means = rows_of_action.iter().map(|rows| mean_of_pairs(rows, MULTIMODALITY_PAIRS, rng));
    means.sum::<f64>() / action_count as f64
}

fn mean_of_pairs<R: Rng + ?Sized>(rows: &[&[f32]], count: usize, rng: &mut R) -> f64 {
    if rows.is_empty() {
        return f64::NAN;
    }
    let mut one = || rows[rng.random_range(0..rows.len())];
    (0..count).map(|_| distance(one(), one())).sum::<f64>() / count as f64
}

/// Mean maximum similarity: mean distance of a generated motion to the nearest real one. // (motion, feature)
///
/// The name is the paper's; a larger value means less alike.
pub fn mean_nearest(generated: &[f32], real: &[f32], feature_count: usize) -> f64 {
    let nearest = |row: &[f32]| {
        let distances = real.chunks_exact(feature_count).map(|other| distance(row, other));
        distances.fold(f64::INFINITY, f64::min)
    };
    let nearest: Vec<f64> = generated.par_chunks_exact(feature_count).map(nearest).collect();
    nearest.iter().sum::<f64>() / nearest.len().max(1) as f64
}

/// Average pairwise distance within every action: Euclidean over all numbers of a crop, metres. // actions: (motion) →
/// (action)
///
/// `None` where an action has fewer than two motions.
pub fn pairwise_distances(
    crops: &Crops,
    actions: &[usize],
    action_count: usize,
) -> Vec<Option<f64>> {
    let mut motions_of_action = vec![Vec::new(); action_count];
    for (motion, &action) in actions.iter().enumerate() {
        motions_of_action[action].push(motion);
    }
    let of_action = |motions: &Vec<usize>| {
        let sums: Vec<f64> = (0..motions.len())
            .into_par_iter()
            .map(|index| {
                let one = crops.motion(motions[index]);
                let later = motions[index + 1..].iter();
                later.map(|&other| fast_distance(one, crops.motion(other))).sum()
            })
            .collect();
        let pair_count = motions.len() * motions.len().saturating_sub(1) / 2;
        (pair_count > 0).then(|| sums.iter().sum::<f64>() / pair_count as f64)
    };
    motions_of_action.iter().map(of_action).collect()
}

fn distance(one: &[f32], other: &[f32]) -> f64 {
    let squares = one.iter().zip(other).map(|(a, b)| f64::from(a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// [`distance`] of thousands of numbers, in f32 sums of a few each.
fn fast_distance(one: &[f32], other: &[f32]) -> f64 {
    const LANES: usize = 16;
    let sum = crate::simd::vectorized(|| {
        let mut sums = [0.0_f32; LANES];
        let (one, one_rest) = one.as_chunks::<LANES>();
        let (other, other_rest) = other.as_chunks::<LANES>();
        for (one, other) in one.iter().zip(other) {
            for lane in 0..LANES {
                sums[lane] += (one[lane] - other[lane]) * (one[lane] - other[lane]);
            }
        }
        for ((sum, one), other) in sums.iter_mut().zip(one_rest).zip(other_rest) {
            *sum += (one - other) * (one - other);
        }
        sums
    });
    sum.iter().map(|&sum| f64::from(sum)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::classifier::example::Input;
    use crate::evaluate::crop::Window;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(1)
    }

    #[test]
    fn equal_motions_have_no_spread() {
        let features = vec![0.5; 40 * 3];
        let actions: Vec<usize> = (0..40).map(|motion| motion % 2).collect();
        assert_eq!(diversity(&features, 3, &mut rng()), 0.0);
        assert_eq!(multimodality(&features, 3, &actions, 2, &mut rng()), 0.0);
        assert_eq!(mean_nearest(&features, &features, 3), 0.0);
    }

    #[test]
    fn multimodality_ignores_the_distance_between_actions() {
        let actions: Vec<usize> = (0..60).map(|motion| motion % 2).collect();
        let features: Vec<f32> = actions.iter().map(|&action| action as f32 * 9.0).collect();
        assert_eq!(multimodality(&features, 1, &actions, 2, &mut rng()), 0.0);
        let spread = diversity(&features, 1, &mut rng());
        assert!((3.5..5.5).contains(&spread), "{spread}");
    }

    #[test]
    fn nearest_is_measured_from_the_generated_motions() {
        let distance = mean_nearest(&[1.0, 4.0], &[0.0, 5.0, 100.0], 1);
        assert_eq!(distance, 1.0);
    }

    #[test]
    fn pairwise_distance_is_over_all_pairs_of_an_action() {
        let mut crops = Crops::new(1, 6, Input::Joints);
        for x in [0.0, 3.0, 4.0, 8.0] {
            crops.push(Window { first: 0, count: 1 }, &[0.0, 0.0, 0.0, x, 0.0, 0.0]);
        }
        // Distances 3, 4 and 1 in action 0; a single motion in action 1.
        let found = pairwise_distances(&crops, &[0, 0, 0, 1], 2);
        assert!((found[0].unwrap() - 8.0 / 3.0).abs() < 1e-6);
        assert_eq!(found[1], None);
    }

    #[test]
    fn fast_distance_is_the_distance() {
        let one: Vec<f32> = (0..4321).map(|x| (x as f32 * 0.1).sin()).collect();
        let other: Vec<f32> = (0..4321).map(|x| (x as f32 * 0.13).cos()).collect();
        let (fast, exact) = (fast_distance(&one, &other), distance(&one, &other));
        assert!((fast / exact - 1.0).abs() < 1e-5, "{fast} {exact}");
    }
}
