//! How far the device's arithmetic is from the float model that was trained.
//!
//! In:  a [`Checkpoint`] and the blob that `host-trainer quantize` made of it.
//! Out: [`Comparison`], a table over training clips and one over mixture draws.
//!
//! Why here: `core` runs on the host bit for bit as on the chip (`parity.rs`), so no emulator is needed to see what a
//! number format costs.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use indicatif::ProgressBar;
use karakuri::{ActionId, Code, Decoder, FramePosition, Model, Pcg32, Pose};
use serde::Serialize;

use crate::belonging::check_belonging;
use crate::checkpoint::Checkpoint;
use crate::choose_cases::choose_cases;
use crate::error::Result;
use crate::error_table::{ErrorRow, PosePair, Rows, error_rows};
use crate::host::widest_workspace;
use crate::reference::Reference;

/// Poses looked at per training clip unless told otherwise: a paper-size model needs 1.4 million f64 products for each.
pub const POSES_PER_CLIP: usize = 16;
/// Poses of mixture draws looked at unless told otherwise.
pub const DRAW_POSE_COUNT: usize = 4_000;

/// How much to look at, and how to show it.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Poses per training clip, evenly spaced whole frames; shorter clips give all of theirs.
    pub poses_per_clip: usize,
    /// Poses of mixture draws, at least.
    pub draw_pose_count: usize,
    /// Per kind of group, or per group.
    pub rows: Rows,
}

/// Result of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Number format of the blob.
    pub number_format: &'static str,
    /// Every training clip, with its mean code; the error includes the rounding of the code.
    pub training_clips: ErrorTable,
    /// Motions that the device draws; the float model gets the very code.
    pub mixture_draws: ErrorTable,
}

/// Errors over one set of motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorTable {
    /// Motions.
    pub motion_count: usize,
    /// Frames of these motions, looked at or not.
    pub frame_count: usize,
    /// Poses compared.
    pub pose_count: usize,
    /// One row per kind of group, or per group.
    pub rows: Vec<ErrorRow>,
}

/// One motion to be decoded twice.
struct Motion {
    device_code: Code,
    /// // (β then α)
    float_code: Vec<f64>,
    positions: Vec<FramePosition>,
    frame_count: usize,
}

/// Compares a blob with the float model that it was made of.
///
/// `progress` counts motions; `ProgressBar::hidden()` for none.
///
/// # Errors
/// [`Error::Blob`], or [`Error::BadInput`] when blob and checkpoint do not belong together.
pub fn compare(
    checkpoint: &Checkpoint,
    blob: &[u8],
    options: Options,
    progress: &ProgressBar,
) -> Result<Comparison> {
    let model = Model::from_bytes(blob)?;
    check_belonging(checkpoint, &model)?;
    let clips = training_motions(checkpoint, &model, options.poses_per_clip);
    let draws = drawn_motions(&model, options.draw_pose_count);
    progress.set_length((clips.len() + draws.len()) as u64);
    let table = |motions: &[Motion]| -> Result<ErrorTable> {
        let pairs = decode_twice(checkpoint, &model, motions, progress)?;
        Ok(ErrorTable {
            motion_count: motions.len(),
            frame_count: motions.iter().map(|motion| motion.frame_count).sum(),
            pose_count: pairs.len(),
            rows: error_rows(&checkpoint.dataset.layout.groups, &pairs, options.rows),
        })
    };
    Ok(Comparison {
        number_format: model.number_format().name(),
        training_clips: table(&clips)?,
        mixture_draws: table(&draws)?,
    })
}

/// Every clip with its mean code.
fn training_motions(
    checkpoint: &Checkpoint,
    model: &Model<'_>,
    poses_per_clip: usize,
) -> Vec<Motion> {
    let clips = checkpoint.dataset.clips.iter().zip(checkpoint.sequence_codes.rows());
    clips
        .map(|(clip, sequence_code)| {
            let action_code = checkpoint.action_codes.row(clip.action);
            let float_code = [sequence_code, action_code].concat();
            let rounded: Vec<f32> = float_code.iter().map(|&value| value as f32).collect();
            Motion {
                device_code: model.code_from_f32(&rounded),
                float_code,
                positions: evenly_spaced_frames(clip.frame_count, poses_per_clip),
                frame_count: clip.frame_count,
            }
        })
        .collect()
}

/// At most `count` of `frame_count` frames, first and last among them.
fn evenly_spaced_frames(frame_count: usize, count: usize) -> Vec<FramePosition> {
    let count = count.min(frame_count);
    let last = frame_count.saturating_sub(1);
    let frame = |index: usize| (index * last / (count - 1).max(1)) as u32;
    (0..count).map(|index| FramePosition::from_frames(frame(index))).collect()
}

/// The motions of `choose_cases`, with the codes that the device would draw.
fn drawn_motions(model: &Model<'_>, pose_count: usize) -> Vec<Motion> {
    let motion = |case: &crate::case::Case| {
        let mut rng = Pcg32::new(case.seed);
        let action = ActionId(case.action);
        let code = model.sample(action, case.frames, &mut || rng.next_u32()).ok()?;
        Some(Motion {
            float_code: model.code_to_f32(&code).map(f64::from).collect(),
            device_code: code,
            positions: case.positions().collect(),
            frame_count: case.frames as usize,
        })
    };
    choose_cases(model, pose_count).iter().filter_map(motion).collect()
}

/// Decodes every motion on both sides, on all cores of this machine; the order of the result is that of `motions`.
fn decode_twice(
    checkpoint: &Checkpoint,
    model: &Model<'_>,
    motions: &[Motion],
    progress: &ProgressBar,
) -> Result<Vec<PosePair>> {
    let next = AtomicUsize::new(0);
    let found: Mutex<Vec<(usize, Vec<PosePair>)>> = Mutex::default();
    let work = || -> Result<()> {
        let mut workspace = widest_workspace();
        let mut decoder = Decoder::new(model, &mut workspace)?;
        while let Some((index, motion)) = take_next(&next, motions) {
            let pairs = motion.decode(&mut decoder, Reference::new(checkpoint));
            found.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push((index, pairs));
            progress.inc(1);
        }
        Ok(())
    };
    let thread_count = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        let threads: Vec<_> = (0..thread_count).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|thread| match thread.join() {
            Ok(outcome) => outcome,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    })?;
    let mut found = found.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    found.sort_unstable_by_key(|(index, _)| *index);
    Ok(found.into_iter().flat_map(|(_, pairs)| pairs).collect())
}

fn take_next<'m>(next: &AtomicUsize, motions: &'m [Motion]) -> Option<(usize, &'m Motion)> {
    let index = next.fetch_add(1, Ordering::Relaxed);
    motions.get(index).map(|motion| (index, motion))
}

impl Motion {
    fn decode(&self, decoder: &mut Decoder<'_, '_>, reference: Reference<'_>) -> Vec<PosePair> {
        let frames = |position: &FramePosition| f64::from(position.to_bits()) / 65_536.0;
        let positions: Vec<f64> = self.positions.iter().map(frames).collect();
        let floats = reference.decode(&self.float_code, &positions);
        decoder.start(&self.device_code);
        let mut pose = Pose::new();
        let pairs = self.positions.iter().zip(floats);
        pairs
            .map(|(&position, float)| {
                decoder.decode(position, &mut pose);
                PosePair { device: pose.values().collect(), float }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::fixture::Fixture;
    use karakuri::NumberFormat;

    const OPTIONS: Options =
        Options { poses_per_clip: 8, draw_pose_count: 64, rows: Rows::PerKind };

    fn compare_fixtures(run: &Fixture, blob: &[u8]) -> Result<Comparison> {
        let checkpoint = Checkpoint::read(run.run().path())?;
        compare(&checkpoint, blob, OPTIONS, &ProgressBar::hidden())
    }

    #[test]
    fn bytes_that_are_no_blob_are_rejected() {
        let error = compare_fixtures(&Fixture::new(1), b"KRKR").unwrap_err();
        assert!(matches!(error, Error::Blob { .. }), "{error}");
    }

    #[test]
    fn result_does_not_depend_on_the_order_in_which_threads_finish() {
        let fixture = Fixture::new(2);
        let blob = fixture.blob(NumberFormat::W8A16);
        let [first, second] = [(); 2].map(|()| compare_fixtures(&fixture, &blob).unwrap());
        assert_eq!(first, second);
    }

    #[test]
    fn frames_of_a_clip_are_spread_from_first_to_last() {
        let frames = |frame_count, count| -> Vec<u32> {
            let positions = evenly_spaced_frames(frame_count, count);
            positions.iter().map(|position| position.to_bits() >> 16).collect()
        };
        assert!(frames(0, 4).is_empty());
        assert_eq!(frames(1, 4), [0]);
        assert_eq!(frames(3, 4), [0, 1, 2]);
        assert_eq!(frames(10, 4), [0, 3, 6, 9]);
    }

    /// In order of what the formats promise: f16 is exact here but for its f32 sums and sinusoids of 16 bits.
    #[test]
    fn errors_of_every_format_stay_within_its_resolution() {
        let fixture = Fixture::new(1);
        for (format, signal_to_noise_db_min) in
            [(NumberFormat::F16, 80.0), (NumberFormat::W8A16, 60.0), (NumberFormat::W8A8, 15.0)]
        {
            let comparison = compare_fixtures(&fixture, &fixture.blob(format)).unwrap();
            for table in [&comparison.training_clips, &comparison.mixture_draws] {
                for row in &table.rows {
                    println!("{row:?}");
                    assert!(row.signal_to_noise_db.unwrap() > signal_to_noise_db_min, "{row:?}");
                }
            }
        }
    }
}
