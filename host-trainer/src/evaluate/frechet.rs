//! The Fréchet distance between two sets of features, each taken for a Gaussian: what the papers call FID.
//!
//! In:  features of motions.
//! Out: |μ₁ − μ₂|² + tr(Σ₁ + Σ₂ − 2 (Σ₁^½ Σ₂ Σ₁^½)^½).
//!
//! Why here: all in f64 and through the symmetric root. \[published code\] takes the eigenvalues of the
//! non-symmetric Σ₁Σ₂ in f32 and inverts, which is noisy at the size of the figures that are compared.
//!
//! Source: Heusel et al., NeurIPS 2017; Dowson and Landau 1982 for the distance.

use faer::{Mat, Side};

use crate::error::{Error, Result};

/// Mean and covariance of features.
#[derive(Clone, Debug)]
pub struct Gaussian {
    mean: Vec<f64>,
    /// Unbiased. // (feature, feature)
    covariance: Mat<f64>,
}

/// Least number of motions for a covariance of `feature_count` features that is not singular by their number alone.
pub const fn motions_min(feature_count: usize) -> usize {
    feature_count + 2
}

impl Gaussian {
    /// Fits features. // features: (motion, feature)
    ///
    /// # Errors
    /// Fewer motions than [`motions_min`]; features that are not finite. `of` names the motions in the message.
    pub fn fit(features: &[f32], feature_count: usize, of: &str) -> Result<Self> {
        let rows = || features.chunks_exact(feature_count);
        let count = rows().len();
        if count < motions_min(feature_count) {
            return Err(Error::bad_input(
                of,
                "number of motions",
                count,
                format!("more than {}, for the FID of {feature_count} features", feature_count + 1),
                "give more clips, or more motions an action",
            ));
        }
        if features.iter().any(|value| !value.is_finite()) {
            let remedy = "look for numbers out of range in clips, run and classifier";
            return Err(Error::bad_input(of, "features", "not finite", "numbers", remedy));
        }
        let mut mean = vec![0.0; feature_count];
        for row in rows() {
            mean.iter_mut().zip(row).for_each(|(sum, value)| *sum += f64::from(*value));
        }
        mean.iter_mut().for_each(|sum| *sum /= count as f64);
        let centred = Mat::from_fn(count, feature_count, |row, column| {
            f64::from(features[row * feature_count + column]) - mean[column]
        });
        let covariance = centred.transpose() * &centred * faer::Scale(1.0 / (count as f64 - 1.0));
        Ok(Self { mean, covariance })
    }

    /// The Fréchet distance to another Gaussian; 0 to itself but for rounding.
    pub fn distance(&self, other: &Self) -> f64 {
        let shift: f64 = self.mean.iter().zip(&other.mean).map(|(a, b)| (a - b).powi(2)).sum();
        let root = square_root(&self.covariance);
        let product = &root * &other.covariance * &root;
        let overlap: f64 = eigenvalues(&product).iter().map(|value| value.max(0.0).sqrt()).sum();
        shift + trace(&self.covariance) + trace(&other.covariance) - 2.0 * overlap
    }
}

fn trace(matrix: &Mat<f64>) -> f64 {
    (0..matrix.nrows()).map(|index| matrix[(index, index)]).sum()
}

/// The symmetric root; eigenvalues below 0 are rounding and count as 0.
fn square_root(matrix: &Mat<f64>) -> Mat<f64> {
    let Ok(eigen) = matrix.self_adjoint_eigen(Side::Lower) else {
        return Mat::full(matrix.nrows(), matrix.ncols(), f64::NAN);
    };
    let (vectors, values) = (eigen.U(), eigen.S());
    let scaled = Mat::from_fn(matrix.nrows(), matrix.ncols(), |row, column| {
        vectors[(row, column)] * values[column].max(0.0).sqrt()
    });
    scaled * vectors.transpose()
}

fn eigenvalues(matrix: &Mat<f64>) -> Vec<f64> {
    let count = matrix.nrows();
    matrix.self_adjoint_eigenvalues(Side::Lower).unwrap_or_else(|_| vec![f64::NAN; count])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    fn diagonal(mean: &[f64], variances: &[f64]) -> Gaussian {
        let covariance = Mat::from_fn(variances.len(), variances.len(), |row, column| {
            if row == column { variances[row] } else { 0.0 }
        });
        Gaussian { mean: mean.to_vec(), covariance }
    }

    fn features(count: usize, width: usize, seed: u64) -> Vec<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count * width).map(|_| rng.sample::<f32, _>(StandardNormal)).collect()
    }

    #[test]
    fn thirty_one_motions_are_too_few_for_thirty_features() {
        let message = Gaussian::fit(&features(31, 30, 1), 30, "clips").unwrap_err().to_string();
        assert!(message.contains("number of motions is 31, expected more than 31"), "{message}");
        assert!(Gaussian::fit(&features(32, 30, 1), 30, "clips").is_ok());
    }

    #[test]
    fn features_that_are_not_finite_are_refused() {
        let mut features = features(40, 30, 1);
        features[7] = f32::NAN;
        assert!(Gaussian::fit(&features, 30, "clips").unwrap_err().to_string().contains("finite"));
    }

    #[test]
    fn distance_of_known_gaussians_is_the_closed_form() {
        let one = diagonal(&[0.0, 1.0, 2.0], &[1.0, 4.0, 9.0]);
        let other = diagonal(&[3.0, 1.0, -2.0], &[4.0, 4.0, 1.0]);
        // 3² + 0 + 4², and (1 − 2)² + 0 + (3 − 1)².
        assert!((one.distance(&other) - 30.0).abs() < 1e-12);
    }

    #[test]
    fn distance_of_correlated_gaussians_is_the_closed_form() {
        // Both have the eigenvectors (1, 1) and (1, −1), so their roots subtract.
        let tilted = |sum: f64, difference: f64| {
            let (same, cross) = ((sum + difference) / 2.0, (sum - difference) / 2.0);
            let covariance = Mat::from_fn(2, 2, |r, c| if r == c { same } else { cross });
            Gaussian { mean: vec![0.0; 2], covariance }
        };
        assert!((tilted(9.0, 4.0).distance(&tilted(16.0, 1.0)) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn singular_covariances_have_a_distance_too() {
        let flat = diagonal(&[0.0, 0.0], &[4.0, 0.0]);
        assert!((flat.distance(&diagonal(&[0.0, 0.0], &[0.0, 9.0])) - 13.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn distance_is_symmetric_zero_to_itself_and_blind_to_the_order(
            seeds: (u64, u64),
            scale in 0.1_f32..3.0,
        ) {
            let one = features(60, 8, seeds.0);
            let other: Vec<f32> = features(50, 8, seeds.1).iter().map(|x| scale * x).collect();
            let reversed: Vec<f32> = one.chunks(8).rev().flatten().copied().collect();
            let fit = |features: &[f32]| Gaussian::fit(features, 8, "test").unwrap();
            let (one, other, reversed) = (fit(&one), fit(&other), fit(&reversed));
            prop_assert!(one.distance(&one).abs() < 1e-9);
            prop_assert!(one.distance(&reversed).abs() < 1e-9);
            prop_assert!((one.distance(&other) - other.distance(&one)).abs() < 1e-9);
            prop_assert!(one.distance(&other) > 0.0);
        }
    }
}
