//! How real generated motions are, by the papers' measures and by the same rule for everything that makes motions.
//!
//! In:  a [`MotionSource`] (a float run or a blob), the recorded clips, a classifier, and a [`Protocol`].
//! Out: an [`Evaluation`]: the row of the generated motions and the row of real ones beside it.
//!
//! Why here: the papers' figures depend on choices that they do not print. They are made once, in `protocol` and `crop`,
//! and every draw is fresh in every repetition. \[published code\] seeds its mixtures anew in every call, so all its
//! repetitions score one and the same set of motions.
//!
//! Source: Cervantes et al., ECCV 2022, section 4; Guo et al., ACM MM 2020; Lu et al., ECCV 2022 (uniform actions, APD).

pub mod crop;
pub mod estimate;
pub mod frechet;
pub mod judge;
pub mod protocol;
pub mod real;
pub mod report;
pub mod source;
pub mod spread;
pub mod text;
mod row;
#[cfg(test)]
pub mod specimen;

use rand::{Rng, RngExt};

use crate::error::{Error, Result};
use crate::random::{Purpose, stream};
use crate::train::{BAR_LENGTH, Progress, progress_bar};
use crop::{Crops, Window};
use frechet::motions_min;
use judge::Judge;
use protocol::{ActionShares, Protocol, Role};
use real::{RealMotion, RealMotions};
use report::{DataDescription, Evaluation};
use row::{RealScores, RowValues, Scored};
use source::{MotionRequest, MotionSource};

/// Measures a source of motions.
///
/// The same arguments give the same figures, with any number of threads.
///
/// # Errors
/// * `BadInput`: a source of other actions, joints or rate than the data; fewer motions than a metric needs; an action
///   without clips; whatever the source refuses.
pub fn evaluate(
    source: &dyn MotionSource,
    data: &RealMotions,
    judge: &Judge<'_>,
    protocol: &Protocol,
    progress: Progress,
) -> Result<Evaluation> {
    Measurement::new(source, data, judge, protocol)?.run(progress)
}

struct Measurement<'a> {
    source: &'a dyn MotionSource,
    data: &'a RealMotions,
    judge: &'a Judge<'a>,
    protocol: &'a Protocol,
    /// The source's index of every action of the data. // (action)
    source_actions: Vec<usize>,
    /// The clips of every action, and the same of those held out. // (action)
    training_of_action: Vec<Vec<usize>>,
    held_out_of_action: Vec<Vec<usize>>,
    remarks: Vec<String>,
}

impl<'a> Measurement<'a> {
    fn new(
        source: &'a dyn MotionSource,
        data: &'a RealMotions,
        judge: &'a Judge<'a>,
        protocol: &'a Protocol,
    ) -> Result<Self> {
        let of_action = |clips: &[RealMotion]| {
            let mut of_action = vec![Vec::new(); data.actions.len()];
            clips.iter().enumerate().for_each(|(clip, motion)| of_action[motion.action].push(clip));
            of_action
        };
        let source_actions = check_source(source, data)?;
        Ok(Self {
            source,
            data,
            judge,
            protocol,
            source_actions,
            training_of_action: of_action(&data.training),
            held_out_of_action: of_action(&data.held_out),
            remarks: Vec::new(),
        })
    }

    fn run(mut self, progress: Progress) -> Result<Evaluation> {
        let uses_held_out = self.settle_held_out();
        let bar = progress_bar(progress);
        let (mut generated, mut real_again) = (RowValues::default(), RowValues::default());
        let repetitions = self.protocol.repetitions;
        for repetition in 0..repetitions {
            bar.set_message(format!("repetition {} of {repetitions}", repetition + 1));
            let held_out = uses_held_out.then(|| self.score_real(Role::HeldOut, repetition));
            let real = RealScores {
                training: self.score_real(Role::Real, repetition)?,
                held_out: held_out.transpose()?.map(|scored| scored.gaussian),
            };
            let feature_count = self.judge.feature_count();
            let again = self.score_real(Role::RealAgain, repetition)?;
            let mut pairs = self.pair_stream(Role::RealAgain, repetition);
            real_again.push(&again, &real, feature_count, &mut pairs);
            let motions = self.score_generated(repetition)?;
            let mut pairs = self.pair_stream(Role::Generated, repetition);
            generated.push(&motions, &real, feature_count, &mut pairs);
            bar.set_position((repetition + 1) as u64 * BAR_LENGTH / repetitions as u64);
        }
        bar.finish_and_clear();
        let data = self.data;
        Ok(Evaluation {
            source: self.source.description(),
            classifier: self.judge.description().clone(),
            data: DataDescription {
                training_clip_count: data.training.len(),
                held_out_clip_count: data.held_out.len(),
                actions: data.actions.clone(),
                joint_count: data.joints.len(),
                rate_hz: data.rate_hz,
            },
            protocol: self.protocol.clone(),
            generated: generated.figures(&data.actions),
            real: real_again.figures(&data.actions),
            remarks: self.remarks,
        })
    }

    /// Whether there are enough held-out clips to compare with; says why not.
    fn settle_held_out(&mut self) -> bool {
        let count = self.data.held_out.len();
        let needed = motions_min(self.judge.feature_count());
        let is_uniform = self.protocol.actions != ActionShares::Data;
        let missing = self.held_out_of_action.iter().position(Vec::is_empty);
        let reason = match missing {
            _ if count == 0 => {
                "no clip was held out of the training, so the FID against the training set cannot tell memory from \
                 realism"
                    .to_owned()
            }
            _ if count < needed => format!("{count} clips were held out, {needed} are needed"),
            Some(action) if is_uniform => {
                format!("no clip of `{}` was held out", self.data.actions[action])
            }
            _ => return true,
        };
        self.remarks.push(format!("no held-out FID: {reason}"));
        false
    }

    fn stream(&self, purpose: Purpose, role: Role, repetition: usize) -> impl Rng + use<> {
        stream(self.protocol.seed, purpose, role.stream_index(repetition))
    }

    fn pair_stream(&self, role: Role, repetition: usize) -> impl Rng + use<> {
        self.stream(Purpose::Pairs, role, repetition)
    }

    /// The clips that stand for one role: their actions and lengths. // (motion)
    fn roster(&self, role: Role, rng: &mut impl Rng) -> Vec<&'a RealMotion> {
        let (clips, of_action) = match role {
            Role::HeldOut => (&self.data.held_out, &self.held_out_of_action),
            _ => (&self.data.training, &self.training_of_action),
        };
        match self.protocol.actions {
            ActionShares::Data => clips.iter().collect(),
            ActionShares::Uniform { motions_per_action } => of_action
                .iter()
                .flat_map(|of_action| std::iter::repeat_n(of_action, motions_per_action))
                .map(|of_action| &clips[of_action[rng.random_range(0..of_action.len())]])
                .collect(),
        }
    }

    fn score_real(&self, role: Role, repetition: usize) -> Result<Scored> {
        let mut rng = self.stream(Purpose::Crop, role, repetition);
        let roster = self.roster(role, &mut rng);
        let channel_count = self.data.channel_count();
        let mut crops = Crops::new(self.protocol.frames, channel_count);
        for clip in &roster {
            let window = Window::draw(clip.frame_count, self.protocol.frames, &mut rng);
            let start = window.first * channel_count;
            crops.push(window, &clip.positions[start..start + window.count * channel_count]);
        }
        let of = if role == Role::HeldOut { "held-out clips" } else { "training clips" };
        self.score(role, repetition, &crops, &roster, of)
    }

    fn score_generated(&self, repetition: usize) -> Result<Scored> {
        let mut rng = self.stream(Purpose::Crop, Role::Generated, repetition);
        let roster = self.roster(Role::Generated, &mut rng);
        let requests: Vec<MotionRequest> = roster
            .iter()
            .map(|clip| MotionRequest {
                action: self.source_actions[clip.action],
                frame_count: clip.frame_count,
                window: Window::draw(clip.frame_count, self.protocol.frames, &mut rng),
                seed: rng.random(),
            })
            .collect();
        let motions = self.source.joint_positions(&requests)?;
        let mut crops = Crops::new(self.protocol.frames, self.data.channel_count());
        for (request, poses) in requests.iter().zip(&motions) {
            crops.push(request.window, poses);
        }
        self.score(Role::Generated, repetition, &crops, &roster, "generated motions")
    }

    fn score(
        &self,
        role: Role,
        repetition: usize,
        crops: &Crops,
        roster: &[&RealMotion],
        of: &str,
    ) -> Result<Scored> {
        let actions = roster.iter().map(|clip| clip.action).collect();
        let verdict = self.judge.score(crops, self.protocol.hidden_start(role, repetition));
        let counts = [self.judge.feature_count(), self.data.actions.len()];
        Scored::new(crops, actions, verdict, counts, of)
    }
}

/// The source's index of every action of the data.
fn check_source(source: &dyn MotionSource, data: &RealMotions) -> Result<Vec<usize>> {
    let name = source.description().name;
    let remedy = "give the clips that it was made of, read by the same flags";
    if source.joint_count() != data.joints.len() {
        let expected = format!("{}, as the clips have", data.joints.len());
        return Err(Error::bad_input(name, "joints", source.joint_count(), expected, remedy));
    }
    if (source.rate_hz() - data.rate_hz).abs() > 1e-3 {
        let expected = format!("{} Hz, as the clips have", data.rate_hz);
        return Err(Error::bad_input(
            name,
            "rate",
            format!("{} Hz", source.rate_hz()),
            expected,
            remedy,
        ));
    }
    if source.actions().len() != data.actions.len() {
        let expected = format!("{}, as the clips show", data.actions.join(", "));
        return Err(Error::bad_input(
            name,
            "actions",
            source.actions().join(", "),
            expected,
            remedy,
        ));
    }
    let index_of = |action: &String| {
        source.actions().iter().position(|other| other == action).ok_or_else(|| {
            let expected = format!("`{action}` among them, as the clips show");
            Error::bad_input(&name, "actions", source.actions().join(", "), expected, remedy)
        })
    };
    data.actions.iter().map(index_of).collect()
}
