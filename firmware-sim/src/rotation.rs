//! How far two rotations in six numbers are apart.
//!
//! Why here: errors are to be measured where they are seen. A joint shows an angle, not matrix elements.
//!
//! Source: Zhou et al., CVPR 2019, Gram-Schmidt on the first two rows.

type Row = [f64; 3];

/// Angle between two rotations, in degrees, 0..=180; `None` where six numbers name no rotation (zero or parallel rows).
///
/// # Shapes
/// `left`, `right` (6): the first two rows of a matrix, row-major; they need not be orthonormal.
///
/// # Accuracy
/// 1e-5 degrees (asserted by `angle_is_exact_from_tiny_to_half_a_turn`); near 0, where errors of a decoder are, the arc
/// cosine of the trace would lose half its digits.
pub fn angle_between_deg(left: &[f64; 6], right: &[f64; 6]) -> Option<f64> {
    let (left, right) = (orthonormal_rows(left)?, orthonormal_rows(right)?);
    // The Frobenius norm of L − R is 2·√2·|sin(angle / 2)|.
    let square: f64 =
        left.iter().flatten().zip(right.iter().flatten()).map(|(l, r)| (l - r) * (l - r)).sum();
    let sine_of_half = (square / 8.0).sqrt().min(1.0);
    Some(2.0 * sine_of_half.asin().to_degrees())
}

fn orthonormal_rows(values: &[f64; 6]) -> Option<[Row; 3]> {
    let [a, b, c, d, e, f] = *values;
    let first = unit([a, b, c])?;
    let second = [d, e, f];
    let along = dot(first, second);
    let second = unit(std::array::from_fn(|axis| second[axis] - along * first[axis]))?;
    Some([first, second, cross(first, second)])
}

fn unit(row: Row) -> Option<Row> {
    let length = dot(row, row).sqrt();
    (length > 1e-9).then(|| row.map(|value| value / length))
}

fn dot(left: Row, right: Row) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
}

fn cross([a, b, c]: Row, [d, e, f]: Row) -> Row {
    [b * f - c * e, c * d - a * f, a * e - b * d]
}

#[cfg(test)]
mod tests {
    use super::angle_between_deg;

    const IDENTITY: [f64; 6] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

    fn about_z(angle_deg: f64) -> [f64; 6] {
        let (sine, cosine) = angle_deg.to_radians().sin_cos();
        [cosine, -sine, 0.0, sine, cosine, 0.0]
    }

    #[test]
    fn six_numbers_without_direction_are_no_rotation() {
        assert_eq!(angle_between_deg(&IDENTITY, &[0.0; 6]), None);
        assert_eq!(angle_between_deg(&[1.0, 0.0, 0.0, 2.0, 0.0, 0.0], &IDENTITY), None);
    }

    #[test]
    fn angle_is_exact_from_tiny_to_half_a_turn() {
        for angle_deg in [0.0, 1e-6, 0.01, 1.0, 90.0, 179.9, 180.0] {
            let found = angle_between_deg(&IDENTITY, &about_z(angle_deg)).unwrap();
            assert!((found - angle_deg).abs() < 1e-5, "{found} instead of {angle_deg}");
        }
    }

    #[test]
    fn length_and_skew_of_the_rows_do_not_matter() {
        let skewed = [2.0, 0.0, 0.0, 0.5, 3.0, 0.0];
        assert!(angle_between_deg(&IDENTITY, &skewed).unwrap() < 1e-9);
    }
}
