//! Mixtures at one byte a number: full, shared, low-rank or diagonal covariances.
//!
//! In:  mixtures with full covariances, from `mixture::fit`.
//! Out: sequence codes.
//!
//! Why here: what a covariance costs in flash and what it gains can only be told at the precision of the flash.

use faer::{Mat, Side};
use rand_chacha::ChaCha8Rng;

use super::StoredSampler;
use super::interval_clips::round_columns;
use crate::error::{Error, Result};
use crate::evaluate::source::CodeSampler;
use crate::mixture::set::MixtureSet;
use crate::mixture::{Component, Factor};

/// Bytes of a component's weight and of an interval.
const RECORD_BYTES: [usize; 2] = [4, 16];

/// What is kept of a component's covariance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// All of it.
    Full,
    /// One covariance for all components of all intervals: their weighted mean.
    Shared,
    /// So many principal axes, and the variance along the axes of the code that they leave.
    LowRank(usize),
    /// The variance along the axes of the code.
    Diagonal,
}

/// Noise = axes · N(0, 1) + deviations · N(0, 1).
#[derive(Clone, Debug)]
struct Spread {
    /// // (axis)(dimension)
    axes: Vec<Vec<f64>>,
    /// // (dimension)
    deviations: Vec<f64>,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct StoredMixture {
    set: MixtureSet,
    /// One a component of `set`, or one for all. // (component)
    spreads: Vec<Spread>,
    /// First component of every interval of `set`.
    firsts: Vec<usize>,
    kept: Kept,
    bytes: usize,
}

impl StoredMixture {
    /// Rounds means and covariances as a blob would.
    ///
    /// # Errors
    /// A covariance that has no eigenvalues, which means numbers that are not finite.
    pub fn new(mixtures: &MixtureSet, kept: Kept) -> Result<Self> {
        let mut set = mixtures.clone();
        round_means(&mut set);
        let components = || set.intervals.iter().flat_map(|i| &i.mixture.components);
        let covariances: Vec<Mat<f64>> = components().map(covariance).collect();
        let mut spreads = match kept {
            Kept::Shared => vec![spread(&mean_covariance(&set, &covariances), Kept::Full)?],
            _ => covariances.iter().map(|c| spread(c, kept)).collect::<Result<Vec<_>>>()?,
        };
        round_spreads(&mut spreads);
        let mut firsts = Vec::new();
        let mut component_count = 0;
        for interval in &set.intervals {
            firsts.push(component_count);
            component_count += interval.mixture.components.len();
        }
        let dimensions = covariances.first().map_or(0, Mat::nrows);
        let [member, record] = RECORD_BYTES;
        let means = component_count * (dimensions + member) + record * set.intervals.len();
        let bytes = means + spreads.len() * numbers(kept, dimensions) + 8 * dimensions;
        Ok(Self { set, spreads, firsts, kept, bytes })
    }
}

/// Stored numbers of a covariance.
fn numbers(kept: Kept, dimensions: usize) -> usize {
    match kept {
        Kept::Full | Kept::Shared => dimensions * (dimensions + 1) / 2,
        Kept::LowRank(rank) => (rank + 1) * dimensions,
        Kept::Diagonal => dimensions,
    }
}

fn round_means(set: &mut MixtureSet) {
    let components = set.intervals.iter().flat_map(|i| &i.mixture.components);
    let mut means: Vec<Vec<f64>> = components.map(|component| component.mean.clone()).collect();
    round_columns(&mut means);
    let components = set.intervals.iter_mut().flat_map(|i| &mut i.mixture.components);
    components.zip(means).for_each(|(component, mean)| component.mean = mean);
}

fn round_spreads(spreads: &mut [Spread]) {
    for axis in 0..spreads.first().map_or(0, |spread| spread.axes.len()) {
        let mut rows: Vec<Vec<f64>> = spreads.iter().map(|s| s.axes[axis].clone()).collect();
        round_columns(&mut rows);
        spreads.iter_mut().zip(rows).for_each(|(spread, row)| spread.axes[axis] = row);
    }
    let mut rows: Vec<Vec<f64>> = spreads.iter().map(|s| s.deviations.clone()).collect();
    round_columns(&mut rows);
    spreads.iter_mut().zip(rows).for_each(|(spread, row)| spread.deviations = row);
}

fn covariance(component: &Component) -> Mat<f64> {
    let dimensions = component.mean.len();
    let factor =
        match &component.factor {
            Factor::Full(lower) => Mat::from_fn(dimensions, dimensions, |row, column| {
                if column > row { 0.0 } else { lower[row * (row + 1) / 2 + column] }
            }),
            Factor::Diagonal(deviations) => Mat::from_fn(dimensions, dimensions, |row, column| {
                if row == column { deviations[row] } else { 0.0 }
            }),
        };
    &factor * factor.transpose()
}

fn mean_covariance(set: &MixtureSet, covariances: &[Mat<f64>]) -> Mat<f64> {
    let dimensions = covariances.first().map_or(0, Mat::nrows);
    let clips = set.intervals.iter().flat_map(|interval| {
        let clips = interval.clips.len() as f64;
        interval.mixture.components.iter().map(move |component| clips * component.weight)
    });
    let weights: Vec<f64> = clips.collect();
    let all: f64 = weights.iter().sum();
    let mut mean = Mat::zeros(dimensions, dimensions);
    for (covariance, weight) in covariances.iter().zip(weights) {
        mean += covariance * faer::Scale(weight / all);
    }
    mean
}

/// Principal axes, the widest first, each as long as its deviation.
fn spread(covariance: &Mat<f64>, kept: Kept) -> Result<Spread> {
    let dimensions = covariance.nrows();
    let rank = match kept {
        Kept::Full | Kept::Shared => dimensions,
        Kept::LowRank(rank) => rank.min(dimensions),
        Kept::Diagonal => 0,
    };
    let mut rest: Vec<f64> = (0..dimensions).map(|i| covariance[(i, i)]).collect();
    let mut axes = Vec::new();
    if rank > 0 {
        let eigen = covariance.self_adjoint_eigen(Side::Lower).map_err(|_| {
            let remedy = "train again; the codes are broken";
            Error::bad_input("mixture", "covariance", "numbers", "finite numbers", remedy)
        })?;
        for index in (dimensions - rank..dimensions).rev() {
            let deviation = eigen.S()[index].max(0.0).sqrt();
            let axis = (0..dimensions).map(|row| eigen.U()[(row, index)] * deviation);
            axes.push(axis.collect::<Vec<f64>>());
        }
    }
    for axis in &axes {
        rest.iter_mut().zip(axis).for_each(|(rest, x)| *rest -= x * x);
    }
    let deviations = match kept {
        Kept::Full | Kept::Shared => vec![0.0; dimensions],
        _ => rest.iter().map(|rest| rest.max(0.0).sqrt()).collect(),
    };
    Ok(Spread { axes, deviations })
}

impl CodeSampler for StoredMixture {
    fn name(&self) -> String {
        let of_interval = self.set.intervals.iter().map(|i| i.mixture.components.len());
        let most = of_interval.max().unwrap_or(0);
        let kept = match self.kept {
            Kept::Full => "full covariances".to_owned(),
            Kept::Shared => "one shared covariance".to_owned(),
            Kept::LowRank(rank) => format!("covariances of rank {rank}"),
            Kept::Diagonal => "diagonal covariances".to_owned(),
        };
        format!("mixtures of {most}, {kept}")
    }

    fn sample(&self, action: usize, frames: usize, random: &mut ChaCha8Rng) -> Result<Vec<f32>> {
        use rand::RngExt;
        use rand_distr::{Distribution, StandardNormal};
        let interval = self.set.interval(action, frames)?;
        let place = self.set.intervals.iter().position(|other| std::ptr::eq(other, interval));
        let components = &interval.mixture.components;
        let mut position: f64 = random.random();
        let chosen = components.iter().position(|component| {
            position -= component.weight;
            position < 0.0
        });
        let chosen = chosen.unwrap_or(components.len() - 1);
        let index = self.firsts[place.unwrap_or(0)] + chosen;
        let spread = &self.spreads[index.min(self.spreads.len() - 1)];
        let mut code = components[chosen].mean.clone();
        for axis in &spread.axes {
            let noise: f64 = StandardNormal.sample(random);
            code.iter_mut().zip(axis).for_each(|(value, x)| *value += noise * x);
        }
        let with_noise = code.iter().zip(&spread.deviations);
        Ok(with_noise.map(|(v, d)| super::nearest_clips::add_noise(*v, *d, random)).collect())
    }
}

impl StoredSampler for StoredMixture {
    fn bytes(&self) -> usize {
        self.bytes
    }
}
