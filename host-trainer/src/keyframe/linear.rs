//! Straight lines between samples: Ramer, Douglas and Peucker's simplification, error measured along the value.
//!
//! Source: Douglas and Peucker, Cartographica 10(2), 1973; instead of the distance to the line, its error at the
//! sample's time, which is what a player shows.

/// Indices of the samples that are kept: the first, the last, and as many between as the tolerance takes.
///
/// No sample is farther than `tolerance` from the line between its neighbours in the result.
pub fn keys(values: &[f64], tolerance: f64) -> Vec<usize> {
    let Some(last) = values.len().checked_sub(1) else { return Vec::new() };
    let mut kept = vec![0];
    // Spans still to be checked, the next one on top.
    let mut open = vec![(0, last)];
    while let Some((first, last)) = open.pop() {
        match farthest(values, first, last) {
            Some((middle, error)) if error > tolerance => {
                open.extend([(middle, last), (first, middle)])
            }
            _ => kept.push(last),
        }
    }
    kept.dedup();
    kept
}

/// The polyline through the kept samples, at every sample.
pub fn play(values: &[f64], keys: &[usize]) -> Vec<f64> {
    let mut played: Vec<f64> = values.first().copied().into_iter().collect();
    for pair in keys.windows(2) {
        played.extend((pair[0] + 1..=pair[1]).map(|at| line(values, pair[0], pair[1], at)));
    }
    played
}

/// The sample between two that is farthest from the line between them, and how far.
fn farthest(values: &[f64], first: usize, last: usize) -> Option<(usize, f64)> {
    let errors =
        (first + 1..last).map(|at| (at, (values[at] - line(values, first, last, at)).abs()));
    errors.max_by(|a, b| a.1.total_cmp(&b.1))
}

fn line(values: &[f64], first: usize, last: usize, at: usize) -> f64 {
    let share = (at - first) as f64 / (last - first) as f64;
    values[first] + share * (values[last] - values[first])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn corners_are_kept_and_lines_are_not() {
        assert_eq!(keys(&[], 1.0), Vec::<usize>::new());
        assert_eq!(keys(&[3.0], 1.0), [0]);
        assert_eq!(keys(&[0.0, 1.0, 2.0, 3.0, 2.0, 1.0], 0.01), [0, 3, 5]);
    }

    proptest! {
        #[test]
        fn no_sample_is_farther_than_the_tolerance(
            values in prop::collection::vec(-90.0..90.0f64, 1..80), tolerance in 0.1..30.0f64
        ) {
            let keys = keys(&values, tolerance);
            let played = play(&values, &keys);
            prop_assert_eq!(played.len(), values.len());
            prop_assert!(played.iter().zip(&values).all(|(a, b)| (a - b).abs() <= tolerance + 1e-9));
        }
    }
}
