//! How real generated motions are, by the papers' measures and by the same rule for everything that makes motions.
//!
//! In:  a [`MotionSource`] (a float run or a blob), the recorded clips, a classifier, and a [`Protocol`].
//! Out: an [`Evaluation`]: the row of the generated motions, and the row of real ones beside it.
//!
//! Why here: the papers' figures depend on choices that they do not print. They are made once, in `protocol` and
//! `crop`, and every draw is fresh in every repetition. \[published code\] seeds its mixtures anew in every call, so
//! all its repetitions score one and the same set of motions.
//!
//! Source: Cervantes et al., ECCV 2022, section 4; Guo et al., ACM MM 2020; Lu et al., ECCV 2022 (APD).

pub mod protocol;
pub mod real;
pub mod crop;
pub mod source;
pub mod judge;
mod roster;
pub mod estimate;
pub mod frechet;
pub mod spread;
pub mod nearest_clip;
pub mod physical;
mod row;
pub mod real_side;
pub mod papers;
pub mod report;
pub mod text;
pub mod picture;
#[cfg(test)]
pub mod specimen;

use crate::classifier::example::Input;
use crate::error::{Error, Result};
use crate::train::{BAR_LENGTH, Progress, progress_bar};
use crop::Crops;
use judge::Judge;
use nearest_clip::Quantiles;
use protocol::{Protocol, Role};
use real::RealMotions;
use real_side::RealSide;
use report::{Evaluation, NearestTrainingClip};
use row::{Row, Scored};
use source::{MotionRequest, MotionSource};

/// Measures a source of motions. For several sources of the same data see [`evaluate_beside`].
///
/// The same arguments give the same figures, with any number of threads.
///
/// # Errors
/// Those of [`RealSide::measure`] and [`evaluate_beside`].
pub fn evaluate(
    source: &dyn MotionSource,
    data: &RealMotions,
    judge: &Judge<'_>,
    protocol: &Protocol,
    progress: Progress,
) -> Result<Evaluation> {
    // Before the work on real motions.
    check_source(source, data)?;
    evaluate_beside(source, &RealSide::measure(data, judge, protocol, progress)?, progress)
}

/// Measures a source of motions beside real ones that are measured already.
///
/// # Errors
/// `BadInput`: a source of other actions, joints or rate than the data; fewer motions than a metric needs; whatever the
/// source refuses.
pub fn evaluate_beside(
    source: &dyn MotionSource,
    real: &RealSide<'_>,
    progress: Progress,
) -> Result<Evaluation> {
    let source_actions = check_source(source, real.data)?;
    let repetitions = real.protocol.repetitions;
    let bar = progress_bar(progress);
    bar.set_message("generated motions");
    let (mut row, mut nearest_mm) = (Row::default(), Vec::new());
    for (repetition, scores) in real.scores.iter().enumerate() {
        let (crops, motions) = score_generated(source, &source_actions, real, repetition)?;
        let mut pairs = real.roster.pair_stream(Role::Generated, repetition);
        row.push(&motions, scores, real.judge.feature_count(), &mut pairs);
        if let Some(clips) = &real.clips {
            nearest_mm.extend(clips.nearest_mm(&crops, |_| None));
        }
        bar.set_position((repetition + 1) as u64 * BAR_LENGTH / repetitions as u64);
    }
    bar.finish_and_clear();
    let (data, classifier) = (real.description(), real.judge.description().clone());
    let mut remarks = real.remarks.clone();
    let papers = papers::comparable(&data, &classifier, real.protocol).unwrap_or_else(|reason| {
        remarks.push(format!("no papers' rows: {reason}"));
        Vec::new()
    });
    let generated = Quantiles::of(nearest_mm);
    Ok(Evaluation {
        source: source.description(),
        classifier,
        data,
        protocol: real.protocol.clone(),
        generated: row.figures(&real.data.actions),
        real: real.figures.clone(),
        nearest_training_clip_mm: NearestTrainingClip { generated, ..real.nearest },
        papers,
        remarks,
    })
}

/// Makes the motions of one repetition and scores them.
fn score_generated(
    source: &dyn MotionSource,
    source_actions: &[usize],
    real: &RealSide<'_>,
    repetition: usize,
) -> Result<(Crops, Scored)> {
    let chosen = real.roster.choose(Role::Generated, repetition);
    let drawn = chosen.clips.iter().zip(&chosen.windows).zip(&chosen.seeds);
    let requests: Vec<MotionRequest> = drawn
        .map(|((clip, &window), &seed)| MotionRequest {
            action: source_actions[clip.action],
            frame_count: clip.frame_count,
            window,
            seed,
        })
        .collect();
    let mut crops = Crops::new(real.protocol.frames, real.data.channel_count(), real.data.input);
    for (request, poses) in requests.iter().zip(source.poses(&requests)?) {
        crops.push(request.window, &poses);
    }
    let start = real.protocol.hidden_start(Role::Generated, repetition);
    let verdict = real.judge.score(&crops, start);
    let counts = [real.judge.feature_count(), real.data.actions.len()];
    let ruler = real.ruler.as_ref();
    let scored =
        Scored::new(&crops, chosen.actions(), verdict, counts, ruler, "generated motions")?;
    Ok((crops, scored))
}

/// The source's index of every action of the data. // (action)
fn check_source(source: &dyn MotionSource, data: &RealMotions) -> Result<Vec<usize>> {
    let name = source.description().name;
    let refused = |field: &str, value: String, expected: String| {
        let remedy = "give the clips that it was made of, read by the same flags";
        Error::bad_input(&name, field, value, expected, remedy)
    };
    if (source.input(), source.channel_count()) != (data.input, data.channel_count()) {
        let of = |input, channel_count| match input {
            Input::Joints => format!("{} joints", channel_count / 3),
            Input::Channels => format!("{channel_count} channels"),
        };
        let expected = format!("{}, as the clips have", of(data.input, data.channel_count()));
        return Err(refused("poses", of(source.input(), source.channel_count()), expected));
    }
    if (source.rate_hz() - data.rate_hz).abs() > 1e-3 {
        let expected = format!("{} Hz, as the clips have", data.rate_hz);
        return Err(refused("rate", format!("{} Hz", source.rate_hz()), expected));
    }
    let index_of = |action: &String| source.actions().iter().position(|other| other == action);
    let indices: Option<Vec<usize>> = data.actions.iter().map(index_of).collect();
    indices.filter(|indices| indices.len() == source.actions().len()).ok_or_else(|| {
        let expected = format!("{}, as the clips show", data.actions.join(", "));
        refused("actions", source.actions().join(", "), expected)
    })
}
