//! The cache of station 5: `RUN/mixture.safetensors`, so that a fit is made once.
//!
//! In:  what `fit` takes, and the run's folder.
//! Out: [`MixtureSet`], fitted or read, equal bit for bit.
//!
//! Why here: the file is derived. A file that belongs to other codes or another configuration, or
//! that cannot be read, is not an error: it is made again and replaced.
//!
//! # Format One-dimensional f64 tensors `weight` (component), `mean` (component · dimension),
//! `factor` (the numbers of every component's [`Factor`]) and `log_likelihood_mean` (interval),
//! with the components in the order of their intervals. Metadata: `key`, the SHA-256 of everything
//! that `fit` depends on; `outline`, JSON of everything but numbers; `checksum`, the SHA-256 of all
//! that.

use std::collections::HashMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::vec::IntoIter;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::atomic_file::{self, Overwrite};
use crate::checkpoint::{Checkpoint, hexadecimal};
use crate::dataset::DatasetDescription;
use crate::error::{Error, Result};
use crate::float_model::CodeTable;
use crate::mixture::fit::fit;
use crate::mixture::set::{Fallback, FitReport, IntervalMixture, MixtureSet};
use crate::mixture::{Component, Covariance, Factor, Mixture, MixtureConfig};

/// The file's name within the run's folder.
pub const FILE_NAME: &str = "mixture.safetensors";
/// Part of the key; change it whenever `fit` would give other mixtures for the same input.
const FIT_VERSION: &str = "karakuri mixture 2";

/// The mixtures of a run's codes: read from its cache, or fitted and cached.
///
/// # Errors
/// See [`fit_or_read`].
pub fn of_checkpoint(run: &Path, checkpoint: &Checkpoint) -> Result<MixtureSet> {
    let config = &checkpoint.config;
    fit_or_read(run, &checkpoint.sequence_codes, &checkpoint.dataset, &config.mixture, config.seed)
}

/// Reads the run's mixtures if they were fitted to this very input, otherwise fits and writes them.
///
/// # Errors
/// * `BadInput`: see [`fit`].
/// * `Io`: the file exists but cannot be read, or cannot be written; an old file stays as it was.
pub fn fit_or_read(
    run: &Path,
    codes: &CodeTable,
    description: &DatasetDescription,
    config: &MixtureConfig,
    seed: u64,
) -> Result<MixtureSet> {
    let path = run.join(FILE_NAME);
    let key = key(codes, description, config, seed);
    if let Some(mixtures) = read(&path, &key, codes, description)? {
        return Ok(mixtures);
    }
    let mixtures = fit(codes, description, config, seed)?;
    write(&path, &key, &mixtures)?;
    Ok(mixtures)
}

/// SHA-256, in hexadecimal, of everything that a fit depends on.
pub fn key(
    codes: &CodeTable,
    description: &DatasetDescription,
    config: &MixtureConfig,
    seed: u64,
) -> String {
    let mut hash = Sha256::new();
    // Debug prints every field and every digit of a number, and cannot fail.
    hash.update(format!("{FIT_VERSION} {seed} {config:?} {}", codes.dimension_count));
    hash.update(format!("{:?} {:?}", description.actions, description.rate_hz));
    hash.update(format!("{:?}", description.clips));
    for number in codes.mean.iter().chain(&codes.log_variance) {
        hash.update(number.to_le_bytes());
    }
    hexadecimal(&hash.finalize())
}

/// One interval without its numbers.
#[derive(Serialize, Deserialize)]
struct Outline {
    action: usize,
    frames_min: usize,
    frames_max: usize,
    clips: Vec<usize>,
    covariance: Covariance,
    component_count: usize,
    attempt_count: usize,
    fallback: Option<Fallback>,
}

impl Outline {
    fn of(interval: &IntervalMixture) -> Self {
        let components = &interval.mixture.components;
        let is_full = |component: &Component| matches!(component.factor, Factor::Full(_));
        Self {
            action: interval.action,
            frames_min: interval.frames_min,
            frames_max: interval.frames_max,
            clips: interval.clips.clone(),
            covariance: match components.iter().all(is_full) {
                true => Covariance::Full,
                false => Covariance::Diagonal,
            },
            component_count: components.len(),
            attempt_count: interval.report.attempt_count,
            fallback: interval.report.fallback,
        }
    }
}

/// The file's tensors.
struct Numbers {
    weight: Vec<f64>,
    mean: Vec<f64>,
    factor: Vec<f64>,
    log_likelihood_mean: Vec<f64>,
}

impl Numbers {
    fn of(mixtures: &MixtureSet) -> Self {
        let components = || mixtures.intervals.iter().flat_map(|i| &i.mixture.components);
        let reports = mixtures.intervals.iter().map(|interval| &interval.report);
        Self {
            weight: components().map(|component| component.weight).collect(),
            mean: components().flat_map(|component| &component.mean).copied().collect(),
            factor: components().flat_map(factor_numbers).copied().collect(),
            log_likelihood_mean: reports.map(|report| report.log_likelihood_mean).collect(),
        }
    }

    fn named(&self) -> [(&'static str, &[f64]); 4] {
        [
            ("weight", &self.weight),
            ("mean", &self.mean),
            ("factor", &self.factor),
            ("log_likelihood_mean", &self.log_likelihood_mean),
        ]
    }

    fn parse(tensors: &SafeTensors) -> Option<Self> {
        let numbers = |name| {
            let bytes = tensors.tensor(name).ok()?.data();
            let numbers = bytes.as_chunks().0.iter();
            Some(numbers.map(|bytes| f64::from_le_bytes(*bytes)).collect())
        };
        Some(Self {
            weight: numbers("weight")?,
            mean: numbers("mean")?,
            factor: numbers("factor")?,
            log_likelihood_mean: numbers("log_likelihood_mean")?,
        })
    }
}

fn factor_numbers(component: &Component) -> &[f64] {
    match &component.factor {
        Factor::Full(numbers) | Factor::Diagonal(numbers) => numbers,
    }
}

fn write(path: &Path, key: &str, mixtures: &MixtureSet) -> Result<()> {
    let bytes =
        emit(key, mixtures).map_err(std::io::Error::other).map_err(Error::io("write", path))?;
    atomic_file::write(path, &bytes, Overwrite::Replace)
}

fn emit(key: &str, mixtures: &MixtureSet) -> anyhow::Result<Vec<u8>> {
    let numbers = Numbers::of(mixtures);
    let outlines: Vec<Outline> = mixtures.intervals.iter().map(Outline::of).collect();
    let outline = serde_json::to_string(&outlines)?;
    let metadata = HashMap::from([
        ("key".to_owned(), key.to_owned()),
        ("checksum".to_owned(), checksum(key, &outline, &numbers)),
        ("outline".to_owned(), outline),
    ]);
    let tensors = numbers.named().map(|(name, values)| {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        (name, values.len(), bytes)
    });
    let views = tensors
        .iter()
        .map(|(name, count, bytes)| Ok((*name, TensorView::new(Dtype::F64, vec![*count], bytes)?)))
        .collect::<anyhow::Result<Vec<_>>>()?;
    Ok(serialize(views, Some(metadata))?)
}

/// `None` when there is no file, or it is another fit's, or it is damaged.
fn read(
    path: &Path,
    key: &str,
    codes: &CodeTable,
    description: &DatasetDescription,
) -> Result<Option<MixtureSet>> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::io("read", path)(error)),
    };
    let intervals = parse(&bytes, key, codes.dimension_count);
    Ok(intervals.map(|intervals| MixtureSet {
        actions: description.actions.clone(),
        rate_hz: description.rate_hz,
        intervals,
    }))
}

fn parse(bytes: &[u8], key: &str, dimension_count: usize) -> Option<Vec<IntervalMixture>> {
    let (_, header) = SafeTensors::read_metadata(bytes).ok()?;
    let metadata = header.metadata().as_ref()?;
    let numbers = Numbers::parse(&SafeTensors::deserialize(bytes).ok()?)?;
    let outline = metadata.get("outline")?;
    if metadata.get("key")? != key || *metadata.get("checksum")? != checksum(key, outline, &numbers)
    {
        return None;
    }
    let mut reader = Reader {
        dimension_count,
        weight: numbers.weight.into_iter(),
        mean: numbers.mean.into_iter(),
        factor: numbers.factor.into_iter(),
        log_likelihood_mean: numbers.log_likelihood_mean.into_iter(),
    };
    let outlines: Vec<Outline> = serde_json::from_str(outline).ok()?;
    outlines.into_iter().map(|outline| reader.interval(outline)).collect()
}

/// Hands out the tensors' numbers in the file's order.
struct Reader {
    dimension_count: usize,
    weight: IntoIter<f64>,
    mean: IntoIter<f64>,
    factor: IntoIter<f64>,
    log_likelihood_mean: IntoIter<f64>,
}

impl Reader {
    fn interval(&mut self, outline: Outline) -> Option<IntervalMixture> {
        let components = (0..outline.component_count)
            .map(|_| self.component(outline.covariance))
            .collect::<Option<Vec<_>>>()?;
        Some(IntervalMixture {
            action: outline.action,
            frames_min: outline.frames_min,
            frames_max: outline.frames_max,
            clips: outline.clips,
            mixture: Mixture { dimension_count: self.dimension_count, components },
            report: FitReport {
                attempt_count: outline.attempt_count,
                fallback: outline.fallback,
                log_likelihood_mean: self.log_likelihood_mean.next()?,
            },
        })
    }

    fn component(&mut self, covariance: Covariance) -> Option<Component> {
        let count = self.dimension_count;
        Some(Component {
            weight: self.weight.next()?,
            mean: take(&mut self.mean, count)?,
            factor: match covariance {
                Covariance::Full => Factor::Full(take(&mut self.factor, count * (count + 1) / 2)?),
                Covariance::Diagonal => Factor::Diagonal(take(&mut self.factor, count)?),
            },
        })
    }
}

fn take(numbers: &mut IntoIter<f64>, count: usize) -> Option<Vec<f64>> {
    let taken: Vec<f64> = numbers.take(count).collect();
    (taken.len() == count).then_some(taken)
}

fn checksum(key: &str, outline: &str, numbers: &Numbers) -> String {
    let mut hash = Sha256::new();
    hash.update(key);
    hash.update(outline);
    for (name, values) in numbers.named() {
        hash.update(name);
        for value in values {
            hash.update(value.to_le_bytes());
        }
    }
    hexadecimal(&hash.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::ClipDescription;
    use crate::layout::PoseLayout;

    struct Run {
        codes: CodeTable,
        description: DatasetDescription,
        config: MixtureConfig,
        seed: u64,
    }

    fn run() -> Run {
        let clip = |row: usize| ClipDescription {
            name: format!("clip{row}"),
            action: 0,
            frame_count: 20 + 5 * row,
        };
        Run {
            codes: CodeTable {
                dimension_count: 3,
                mean: (0..36).map(|i| (1.3 * i as f32).sin()).collect(),
                log_variance: vec![-3.0; 36],
            },
            description: DatasetDescription {
                layout: PoseLayout::default(),
                rate_hz: 50.0,
                actions: vec!["bow".into()],
                clips: (0..12).map(clip).collect(),
                held_out: Vec::new(),
                mean: Vec::new(),
                scale: Vec::new(),
                skeleton: None,
            },
            config: MixtureConfig {
                components_max: 4,
                covariance: Covariance::Full,
                draws_per_clip: 10,
                interval_frames_min: 10,
                interval_clips_min: 5,
                attempts_max: 5,
                restarts: 1,
                regularization: 1e-3,
                collapse_distance: 0.0,
            },
            seed: 1,
        }
    }

    impl Run {
        fn key(&self) -> String {
            key(&self.codes, &self.description, &self.config, self.seed)
        }

        fn fit_or_read(&self, folder: &Path) -> Result<MixtureSet> {
            fit_or_read(folder, &self.codes, &self.description, &self.config, self.seed)
        }

        fn parse(&self, bytes: &[u8]) -> Option<Vec<IntervalMixture>> {
            parse(bytes, &self.key(), self.codes.dimension_count)
        }
    }

    #[test]
    fn folder_that_does_not_exist_is_an_error_that_names_the_file() {
        let message = run().fit_or_read(Path::new("/no/such/run")).unwrap_err().to_string();
        assert!(message.starts_with("/no/such/run/mixture.safetensors: cannot write"), "{message}");
    }

    #[test]
    fn file_cut_at_any_length_or_with_any_byte_changed_is_not_used() {
        let run = run();
        let mixtures = fit(&run.codes, &run.description, &run.config, run.seed).unwrap();
        let bytes = emit(&run.key(), &mixtures).unwrap();
        assert_eq!(run.parse(&bytes), Some(mixtures.intervals));
        for len in 0..bytes.len() {
            assert_eq!(run.parse(&bytes[..len]), None);
        }
        for index in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[index] ^= 0x20;
            // Spaces in the header may change without changing its meaning.
            assert!(run.parse(&damaged).is_none_or(|_| matches!(bytes[index], b' ' | 0)));
        }
    }

    #[test]
    fn damaged_file_is_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let expected = run().fit_or_read(folder.path()).unwrap();
        fs::write(folder.path().join(FILE_NAME), b"not a file of ours").unwrap();
        assert_eq!(run().fit_or_read(folder.path()).unwrap(), expected);
        let bytes = fs::read(folder.path().join(FILE_NAME)).unwrap();
        assert_eq!(run().parse(&bytes), Some(expected.intervals));
    }

    #[test]
    fn second_call_reads_what_the_first_wrote_bit_for_bit() {
        for covariance in [Covariance::Full, Covariance::Diagonal] {
            let mut run = run();
            run.config.covariance = covariance;
            let folder = tempfile::tempdir().unwrap();
            let fitted = run.fit_or_read(folder.path()).unwrap();
            let path = folder.path().join(FILE_NAME);
            let written = fs::metadata(&path).unwrap().modified().unwrap();
            assert_eq!(run.fit_or_read(folder.path()).unwrap(), fitted);
            assert_eq!(fs::metadata(&path).unwrap().modified().unwrap(), written);
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        }
    }

    #[test]
    fn key_changes_with_everything_that_the_fit_depends_on() {
        let changes: [fn(&mut Run); 7] = [
            |run| run.codes.mean[5] += 1e-6,
            |run| run.codes.log_variance[5] += 1e-6,
            |run| run.seed += 1,
            |run| run.config.regularization *= 2.0,
            |run| run.description.clips[3].frame_count += 1,
            |run| run.description.actions[0].push('s'),
            |run| run.description.rate_hz += 1.0,
        ];
        let mut keys = vec![run().key()];
        for change in changes {
            let mut run = run();
            change(&mut run);
            keys.push(run.key());
        }
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), 8);
    }
}
