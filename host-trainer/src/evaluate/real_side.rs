//! Everything about real motions that rows of generated ones are compared with: measured once, used by every row.
//!
//! In:  the data, a judge, a protocol.
//! Out: [`RealSide`], to `evaluate`.

use super::crop::Crops;
use super::frechet::motions_min;
use super::judge::Judge;
use super::nearest_clip::{Quantiles, TrainingClips};
use super::physical::ruler::Ruler;
use super::protocol::{Protocol, Role};
use super::real::RealMotions;
use super::report::{DataDescription, Figures, NearestTrainingClip};
use super::roster::{Chosen, Roster};
use super::row::{RealScores, Row, Scored};
use crate::classifier::example::Input;
use crate::error::Result;
use crate::train::{BAR_LENGTH, Progress, progress_bar};

/// Real motions, scored in every repetition.
pub struct RealSide<'a> {
    pub(super) data: &'a RealMotions,
    pub(super) judge: &'a Judge<'a>,
    pub(super) protocol: &'a Protocol,
    pub(super) roster: Roster<'a>,
    /// Of bodies.
    pub(super) clips: Option<TrainingClips>,
    pub(super) ruler: Option<Ruler>,
    /// // (repetition)
    pub(super) scores: Vec<RealScores>,
    pub(super) figures: Figures,
    pub(super) nearest: NearestTrainingClip,
    pub(super) remarks: Vec<String>,
}

impl<'a> RealSide<'a> {
    /// Scores training clips, the same clips in other windows, and held-out clips.
    ///
    /// # Errors
    /// `BadInput`: an action without training clips; fewer training clips than a metric needs.
    pub fn measure(
        data: &'a RealMotions,
        judge: &'a Judge<'a>,
        protocol: &'a Protocol,
        progress: Progress,
    ) -> Result<Self> {
        judge.check_frames(protocol.frames)?;
        let roster = Roster::new(data, protocol)?;
        let is_body = data.input == Input::Joints;
        let clips = is_body.then(|| TrainingClips::new(&data.training, data.joints.len()));
        let ruler = is_body.then(|| Ruler::new(data));
        let why_not_held_out = why_not_held_out(data, judge, &roster);
        let bar = progress_bar(progress);
        bar.set_message("real motions");
        let mut row = Row::default();
        let (mut scores, mut held_out_mm, mut training_mm) = (Vec::new(), Vec::new(), Vec::new());
        for repetition in 0..protocol.repetitions {
            let score = |role| {
                let ruler = ruler.as_ref().filter(|_| role != Role::HeldOut);
                score_real(&roster, judge, protocol, data, ruler, (role, repetition))
            };
            let (_, _, training) = score(Role::Real)?;
            let mut real = RealScores { training, held_out: None };
            if why_not_held_out.is_none() {
                let (_, crops, held_out) = score(Role::HeldOut)?;
                if let Some(clips) = &clips {
                    held_out_mm.extend(clips.nearest_mm(&crops, |_| None));
                }
                real.held_out = Some(held_out.gaussian);
            }
            let (chosen, crops, again) = score(Role::RealAgain)?;
            if let Some(clips) = &clips {
                let own = |motion: usize| Some(chosen.indices[motion]);
                training_mm.extend(clips.nearest_mm(&crops, own));
            }
            let mut pairs = roster.pair_stream(Role::RealAgain, repetition);
            row.push(&again, &real, judge.feature_count(), &mut pairs);
            scores.push(real);
            bar.set_position((repetition + 1) as u64 * BAR_LENGTH / protocol.repetitions as u64);
        }
        bar.finish_and_clear();
        let no_millimetres = (!is_body).then(|| {
            "no distances to the nearest training clip: only of bodies are they millimetres; APD is in channel units"
                .to_owned()
        });
        Ok(Self {
            figures: row.figures(&data.actions),
            nearest: NearestTrainingClip {
                generated: None,
                held_out: Quantiles::of(held_out_mm),
                training: Quantiles::of(training_mm),
            },
            remarks: why_not_held_out.into_iter().chain(no_millimetres).collect(),
            data,
            judge,
            protocol,
            roster,
            clips,
            ruler,
            scores,
        })
    }

    /// The clips, for the report.
    pub(super) fn description(&self) -> DataDescription {
        DataDescription {
            training_clip_count: self.data.training.len(),
            held_out_clip_count: self.data.held_out.len(),
            actions: self.data.actions.clone(),
            input: self.data.input,
            joint_count: self.data.joints.len(),
            rate_hz: self.data.rate_hz,
        }
    }
}

fn score_real<'a>(
    roster: &Roster<'a>,
    judge: &Judge<'_>,
    protocol: &Protocol,
    data: &RealMotions,
    ruler: Option<&Ruler>,
    (role, repetition): (Role, usize),
) -> Result<(Chosen<'a>, Crops, Scored)> {
    let chosen = roster.choose(role, repetition);
    let crops = chosen.real_crops(protocol.frames, data);
    let verdict = judge.score(&crops, protocol.hidden_start(role, repetition));
    let counts = [judge.feature_count(), data.actions.len()];
    let of = if role == Role::HeldOut { "held-out clips" } else { "training clips" };
    let scored = Scored::new(&crops, chosen.actions(), verdict, counts, ruler, of)?;
    Ok((chosen, crops, scored))
}

/// Why there is no FID against held-out clips; `None` if there is one.
fn why_not_held_out(data: &RealMotions, judge: &Judge<'_>, roster: &Roster<'_>) -> Option<String> {
    let count = data.held_out.len();
    let needed = motions_min(judge.feature_count());
    let reason = match roster.missing_action(Role::HeldOut) {
        _ if count == 0 => "no clip was held out of the training, so these figures cannot tell memory from realism; \
             train with hold_out = 0.2 to know (for a blob give --run)"
            .to_owned(),
        _ if count < needed => format!("{count} clips were held out, {needed} are needed"),
        Some(action) => format!("no clip of `{}` was held out", data.actions[action]),
        None => return None,
    };
    Some(format!("no held-out FID: {reason}"))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::body::skeleton::Skeleton;
    use crate::classifier::Classifier;
    use crate::evaluate::report::ClassifierDescription;
    use crate::hold_out::hold_out;
    use crate::import::labels::LabelOptions;
    use crate::import::{self, ImportOptions};

    /// A path below `shared/data`, or `None` with a loud word when this machine has no such data.
    fn shared(path: &str) -> Option<PathBuf> {
        let roots = ["/../../shared", "/../../../shared"];
        let at = |up| PathBuf::from(format!("{}{up}/data/{path}", env!("CARGO_MANIFEST_DIR")));
        let found = roots.into_iter().map(at).find(|path| path.exists());
        if found.is_none() {
            assert!(std::env::var_os("CI").is_none(), "CI needs shared/data/{path}");
            eprintln!("SKIPPED: shared/data/{path} is not on this machine");
        }
        found
    }

    /// HumanAct12's real motions with a share held out.
    fn humanact12(share: f64) -> Option<(Figures, DataDescription)> {
        let labels =
            LabelOptions { action_column: Some("coarse".to_owned()), ..LabelOptions::default() };
        let options = ImportOptions { labels, rate_hz: Some(20.0), ..ImportOptions::default() };
        let mut clip_set = import::read(&shared("humanact12/clips")?, &options).unwrap();
        clip_set.skeleton = Some(Skeleton::smpl24());
        let (training, held_out) = hold_out(clip_set, share, 1).unwrap();
        let data = RealMotions::new(&training, held_out.as_ref()).unwrap();
        let file = shared("a2m_classifiers/humanact12.safetensors")?;
        let classifier = Classifier::load(&file).unwrap();
        let description = ClassifierDescription { file: String::new(), sha256: String::new() };
        let judge = Judge::new(&classifier, description, &data, None).unwrap();
        let protocol = Protocol { repetitions: 1, ..Protocol::default() };
        let real = RealSide::measure(&data, &judge, &protocol, Progress::Hidden).unwrap();
        Some((real.figures.clone(), real.description()))
    }

    #[test]
    fn real_clips_of_humanact12_have_the_papers_figures() {
        let Some((figures, data)) = humanact12(0.0) else { return };
        assert_eq!((data.training_clip_count, data.joint_count), (1191, 24));
        assert!(figures.fid.mean <= 0.03, "{figures:?}");
        assert!(figures.accuracy.mean >= 0.995, "{figures:?}");
        // Diversity is a mean of 200 pairs, so it varies by about 0.15.
        assert!((figures.diversity.mean - 6.85).abs() < 0.5, "{figures:?}");
        assert!((figures.multimodality.mean - 2.45).abs() < 0.3, "{figures:?}");
        assert!((figures.mms.mean - 0.33).abs() < 0.02, "{figures:?}");
        assert!((figures.apd_normalized.mean - 100.0).abs() < 2.0, "{figures:?}");
    }

    #[test]
    fn held_out_clips_of_humanact12_are_a_fifth_of_a_fid_away() {
        let Some((figures, data)) = humanact12(0.2) else { return };
        assert_eq!(data.training_clip_count + data.held_out_clip_count, 1191);
        let distance = figures.fid_held_out.unwrap().mean;
        assert!((0.12..0.28).contains(&distance), "{distance}");
    }
}
