//! Station 8: (action, length, random numbers) → code, from tables in flash.
//!
//! Three kinds of table share one shape. `NearestClips`: a component is a training clip's own code; a draw takes one of
//! the clips of the action that are nearest in length, moves a random share of the way towards another, and adds noise
//! of one σ per number, shared by all clips. `ClipCodes`: the same among the clips of a length interval.
//! `DiagonalMixture`: a component is a Gaussian with its own σ per number.
//!
//! Why here: full covariances do not fit a microcontroller, and clip codes at a few bits a number score better than
//! full mixtures of many times their size (ARCHITECTURE.md, "How motions are drawn").
//! Source: MotionINR, Algorithm 1, for length intervals and mixtures per action.

mod intensity;

use crate::code::{Code, interpolate};
use crate::dials::Dials;
use crate::error::{BlobError, SampleError};
use crate::length_interval::Interval;
use crate::little_endian::{i16s, i32s, u16s};
use crate::manifest::{COLUMN_BYTES, MEMBER_BYTES, Manifest, SamplerKind, TensorKind};
use crate::model::ActionId;
use crate::random::{below, gaussian_q12};
use crate::variety::Variety;

/// Tables of the sampler, in flash.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampler<'a> {
    kind: SamplerKind,
    sequence_code_count: usize,
    action_code_count: usize,
    /// No action beyond it is ever sampled; 0 in an empty model.
    pub action_count: u16,
    component_count: u32,
    member_count: u32,
    step_max_q16: u32,
    action_codes: &'a [u8],
    components: &'a [u8],
    component_steps: &'a [u8],
    columns: &'a [u8],
    deviations: &'a [u8],
    deviation_steps: &'a [u8],
    members: &'a [u8],
    lengths: &'a [u8],
    intervals: &'a [u8],
}

/// How one number of every clip's code is stored.
#[derive(Clone, Copy, Debug)]
struct Column {
    /// Value of 0 in code units.
    least: i16,
    bits: u8,
    filler: u8,
}

impl Column {
    fn parse(&[a, b, bits, filler]: &[u8; COLUMN_BYTES]) -> Self {
        Self { least: i16::from_le_bytes([a, b]), bits, filler }
    }
}

impl<'a> Sampler<'a> {
    /// Without any table.
    pub fn empty() -> Self {
        Self {
            kind: SamplerKind::ClipCodes,
            sequence_code_count: 0,
            action_code_count: 0,
            action_count: 0,
            component_count: 0,
            member_count: 0,
            step_max_q16: 0,
            action_codes: &[],
            components: &[],
            component_steps: &[],
            columns: &[],
            deviations: &[],
            deviation_steps: &[],
            members: &[],
            lengths: &[],
            intervals: &[],
        }
    }

    pub fn new(manifest: &Manifest<'_>) -> Self {
        Self {
            kind: manifest.sampler.kind,
            sequence_code_count: usize::from(manifest.sequence_code_count),
            action_code_count: usize::from(manifest.action_code_count),
            action_count: manifest.action_count,
            component_count: manifest.sampler.component_count,
            member_count: manifest.sampler.member_count,
            step_max_q16: manifest.sampler.step_max_q16,
            ..Self::empty()
        }
    }

    pub fn set_tensor(&mut self, kind: TensorKind, tensor: &'a [u8]) {
        match kind {
            TensorKind::ActionCodes => self.action_codes = tensor,
            TensorKind::Components => self.components = tensor,
            TensorKind::ComponentSteps => self.component_steps = tensor,
            TensorKind::Columns => self.columns = tensor,
            TensorKind::Deviations => self.deviations = tensor,
            TensorKind::DeviationSteps => self.deviation_steps = tensor,
            TensorKind::Members => self.members = tensor,
            TensorKind::Lengths => self.lengths = tensor,
            TensorKind::Intervals => self.intervals = tensor,
            _ => {}
        }
    }

    /// Every interval must name an action and existing members, every member an existing component, and the
    /// intervals of an action must be disjoint; every action must have one.
    pub fn check(&self) -> Result<(), BlobError> {
        let bad = |field, value: usize| BlobError::BadField { field, value: value as u32 };
        let is_nearest = matches!(self.kind, SamplerKind::NearestClips { .. });
        let member_count = if is_nearest { self.component_count } else { self.member_count };
        for (index, interval) in self.intervals().enumerate() {
            let end = interval.member_first.checked_add(interval.member_count);
            let members = interval.member_count > 0 && end.is_some_and(|end| end <= member_count);
            let lengths = (1..=interval.frames_max).contains(&interval.frames_min);
            let overlaps = |other: Interval| {
                other.action == interval.action
                    && (is_nearest
                        || other.frames_min <= interval.frames_max
                            && interval.frames_min <= other.frames_max)
            };
            if !members || !lengths || interval.action >= self.action_count {
                return Err(bad("interval", index));
            }
            if self.intervals().skip(index + 1).any(overlaps) {
                return Err(bad("overlapping interval", index));
            }
        }
        let without = |&action: &u16| !self.intervals().any(|interval| interval.action == action);
        if let Some(action) = (0..self.action_count).find(without) {
            return Err(bad("action without interval", usize::from(action)));
        }
        if let SamplerKind::NearestClips { row_bytes, .. } = self.kind {
            return self.check_clips(row_bytes);
        }
        let beyond = |member: (u16, u16)| u32::from(member.0) >= self.component_count;
        match self.members().position(beyond) {
            Some(index) => Err(bad("member", index)),
            None => Ok(()),
        }
    }

    /// Columns must fill a row; the clips of an action must ascend from its least length to its greatest.
    fn check_clips(&self, row_bytes: u16) -> Result<(), BlobError> {
        let bad = |field, value: usize| Err(BlobError::BadField { field, value: value as u32 });
        if let Some(index) = self.columns().position(|column| column.bits > 8 || column.filler != 0)
        {
            return bad("bits of a column", index);
        }
        let bits: usize = self.columns().map(|column| usize::from(column.bits)).sum();
        if bits.div_ceil(8) != usize::from(row_bytes) {
            return bad("bytes of a clip's code", usize::from(row_bytes));
        }
        for (index, interval) in self.intervals().enumerate() {
            let lengths = || self.lengths_of(&interval);
            let ascends = lengths().zip(lengths().skip(1)).all(|(length, next)| length <= next);
            let ends = (lengths().next(), lengths().last());
            if !ascends || ends != (Some(interval.frames_min), Some(interval.frames_max)) {
                return bad("lengths of the clips of interval", index);
            }
        }
        Ok(())
    }

    pub fn trained_frames(&self, action: ActionId) -> core::ops::RangeInclusive<u32> {
        let lengths = self.intervals().filter(|interval| interval.action == action.0);
        let (frames_min, frames_max) = lengths.fold((u16::MAX, 0), |(min, max), interval| {
            (interval.frames_min.min(min), interval.frames_max.max(max))
        });
        // Without any interval the largest minimum meets the maximum 0.
        u32::from(frames_min.min(frames_max))..=u32::from(frames_max)
    }

    pub fn sample(
        &self,
        action: ActionId,
        frames: u32,
        dials: Dials,
        random: &mut impl FnMut() -> u32,
        code: &mut Code,
    ) -> Result<(), SampleError> {
        let interval = self.interval_of(action, frames)?;
        code.values.clear();
        let variety = Variety::new(self.step_max_q16, dials.variety_q12);
        match self.kind {
            SamplerKind::ClipCodes => self.sample_clip(&interval, variety, random, code),
            SamplerKind::DiagonalMixture => self.sample_gaussian(&interval, variety, random, code),
            SamplerKind::NearestClips { clip_count, .. } => {
                let clip_count = variety.clips(u32::from(clip_count));
                let nearest = self.nearest(&interval, frames, clip_count);
                self.sample_clip(&nearest, variety, random, code);
            }
        }
        if dials.intensity_q12 != Dials::ONE_Q12 || variety.stretches() {
            self.move_from_mean(action, dials.intensity_q12, variety, random, code);
        }
        code.append(self.action_code(action));
        Ok(())
    }

    /// Whether a motion can be drawn.
    pub fn check_request(&self, action: ActionId, frames: u32) -> Result<(), SampleError> {
        self.interval_of(action, frames).map(|_| ())
    }

    fn interval_of(&self, action: ActionId, frames: u32) -> Result<Interval, SampleError> {
        if action.0 >= self.action_count {
            return Err(SampleError::UnknownAction { action: action.0, count: self.action_count });
        }
        let trained = self.trained_frames(action);
        let (frames_min, frames_max) = (*trained.start(), *trained.end());
        self.intervals()
            .find(|interval| interval.action == action.0 && interval.contains(frames))
            .ok_or(SampleError::OutsideTraining { frames, frames_min, frames_max })
    }

    /// One of the interval's members, moved towards another, with noise.
    // Never twice in an image: two kinds call it.
    #[inline(never)]
    fn sample_clip(
        &self,
        interval: &Interval,
        variety: Variety,
        random: &mut impl FnMut() -> u32,
        code: &mut Code,
    ) {
        let chosen = below(interval.member_count, random);
        // Any of the others with equal chance; the clip itself when it is alone.
        let skip = 1 + below(interval.member_count.saturating_sub(1), random);
        let neighbour = (chosen + skip) % interval.member_count.max(1);
        let fraction = (i64::from(random()) * i64::from(variety.step_max_q16)) >> 32;
        let from = self.mean(self.component_of(interval, chosen));
        let to = self.mean(self.component_of(interval, neighbour));
        let spread = i64::from(interval.spread);
        let sigmas = i32s(self.deviation_steps)
            .map(|step| variety.sigma(((i64::from(step) * spread) >> 12) as i32));
        let means = from.zip(to).map(|(from, to)| interpolate(from, to, fraction));
        let values = means.zip(sigmas);
        code.append(values.map(|(mean, sigma)| add_noise(mean, sigma, random)));
    }

    /// The `clip_count` clips of an action that are nearest in length, as many shorter as longer ones where there are.
    fn nearest(&self, action: &Interval, frames: u32, clip_count: u32) -> Interval {
        // Twice the place between the shorter and the longer ones.
        let places = self.lengths_of(action).map(|length| {
            let length = u32::from(length);
            u32::from(length < frames) + u32::from(length <= frames)
        });
        let middle = places.sum::<u32>() / 2;
        let member_count = clip_count.min(action.member_count);
        let skipped = middle.saturating_sub(member_count / 2);
        let member_first = action.member_first + skipped.min(action.member_count - member_count);
        Interval { member_first, member_count, ..*action }
    }

    fn sample_gaussian(
        &self,
        interval: &Interval,
        variety: Variety,
        random: &mut impl FnMut() -> u32,
        code: &mut Code,
    ) {
        let threshold = random() >> 16;
        let last = interval.member_count.saturating_sub(1);
        let heavy = |&member: &u32| {
            self.member(interval, member).is_some_and(|m| u32::from(m.1) >= threshold)
        };
        let chosen = (0..last).find(heavy).unwrap_or(last);
        let component = self.component_of(interval, chosen);
        let deviations =
            self.row(self.deviations, component).iter().zip(i32s(self.deviation_steps));
        let sigmas = deviations
            .map(|(&deviation, step)| variety.sigma(i32::from(deviation).saturating_mul(step)));
        let values = self.mean(component).zip(sigmas);
        code.append(values.map(|(mean, sigma)| add_noise(mean, sigma, random)));
    }

    /// A component's mean in code units.
    fn mean(&self, component: u16) -> impl Iterator<Item = i16> + use<'a> {
        let row_bytes = match self.kind {
            SamplerKind::NearestClips { row_bytes, .. } => usize::from(row_bytes),
            SamplerKind::ClipCodes | SamplerKind::DiagonalMixture => self.sequence_code_count,
        };
        let row = self.components.get(usize::from(component) * row_bytes..).unwrap_or_default();
        let columns = self.columns.as_chunks::<COLUMN_BYTES>().0;
        let mut bit = 0;
        i32s(self.component_steps).enumerate().map(move |(index, step)| {
            let byte = |index: usize| row.get(index).copied().unwrap_or(0);
            let (least, number) = match columns.get(index).map(Column::parse) {
                None => (0, i64::from(byte(index).cast_signed())),
                Some(column) => {
                    let pair = u16::from_le_bytes([byte(bit / 8), byte(bit / 8 + 1)]);
                    let number = pair >> (bit % 8) & ((1 << column.bits) - 1);
                    bit += usize::from(column.bits);
                    (i64::from(column.least), i64::from(number))
                }
            };
            saturate(least + ((number * i64::from(step) + (1 << 7)) >> 8))
        })
    }

    fn row(&self, table: &'a [u8], component: u16) -> &'a [u8] {
        let start = usize::from(component) * self.sequence_code_count;
        table.get(start..start + self.sequence_code_count).unwrap_or_default()
    }

    fn action_code(&self, action: ActionId) -> impl Iterator<Item = i16> + use<'a> {
        i16s(self.action_codes)
            .skip(usize::from(action.0) * self.action_code_count)
            .take(self.action_code_count)
    }

    fn component_of(&self, interval: &Interval, member: u32) -> u16 {
        match self.kind {
            SamplerKind::NearestClips { .. } => (interval.member_first + member) as u16,
            _ => self.member(interval, member).map_or(0, |member| member.0),
        }
    }

    /// (component, cumulative weight)
    fn member(&self, interval: &Interval, member: u32) -> Option<(u16, u16)> {
        let index = (interval.member_first + member) as usize;
        self.members.as_chunks().0.get(index).map(parse_member)
    }

    fn members(&self) -> impl Iterator<Item = (u16, u16)> + use<'a> {
        self.members.as_chunks::<MEMBER_BYTES>().0.iter().map(parse_member)
    }

    fn columns(&self) -> impl Iterator<Item = Column> + use<'a> {
        self.columns.as_chunks::<COLUMN_BYTES>().0.iter().map(Column::parse)
    }

    /// Lengths of the clips of an action of `NearestClips`.
    fn lengths_of(&self, action: &Interval) -> impl Iterator<Item = u16> + use<'a> {
        let (first, count) = (action.member_first as usize, action.member_count as usize);
        u16s(self.lengths).skip(first).take(count)
    }

    fn intervals(&self) -> impl Iterator<Item = Interval> + use<'a> {
        self.intervals.as_chunks().0.iter().map(Interval::parse)
    }
}

fn parse_member(&[a, b, c, d]: &[u8; MEMBER_BYTES]) -> (u16, u16) {
    (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]))
}

/// `value + σ · N(0, 1)`, with σ in code units · 2^8.
fn add_noise(value: i16, sigma_q8: i32, random: &mut impl FnMut() -> u32) -> i16 {
    let noise = (i64::from(gaussian_q12(random)) * i64::from(sigma_q8) + (1 << 19)) >> 20;
    saturate(i64::from(value) + noise)
}

fn saturate(value: i64) -> i16 {
    value.clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i16
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use crate::manifest::{NumberFormat, SamplerKind};
    use crate::specimen::{KINDS, specimen};
    use crate::{ActionId, Code, Dials, Model, Pcg32, SampleError};

    #[test]
    fn unknown_action_is_rejected() {
        let blob = specimen(NumberFormat::W8A16, SamplerKind::ClipCodes);
        let model = Model::from_bytes(&blob).unwrap();
        let error = model.sample(ActionId(2), 10, &mut || 0).unwrap_err();
        assert_eq!(error, SampleError::UnknownAction { action: 2, count: 2 });
    }

    #[test]
    fn length_outside_training_is_rejected_with_the_trained_range() {
        for kind in KINDS {
            let blob = specimen(NumberFormat::W8A16, kind);
            let model = Model::from_bytes(&blob).unwrap();
            for frames in [0, 9, 31, u32::MAX] {
                let error = model.sample(ActionId(0), frames, &mut || 0).unwrap_err();
                assert_eq!(
                    error,
                    SampleError::OutsideTraining { frames, frames_min: 10, frames_max: 30 }
                );
            }
        }
    }

    #[test]
    fn seed_gives_the_same_code_and_another_seed_another() {
        for kind in KINDS {
            let blob = specimen(NumberFormat::W8A16, kind);
            let model = Model::from_bytes(&blob).unwrap();
            let draw = |seed| {
                let mut random = Pcg32::new(seed);
                model.sample(ActionId(1), 44, &mut || random.next_u32()).unwrap()
            };
            assert_eq!(draw(1), draw(1));
            assert_ne!(draw(1), draw(2));
        }
    }

    /// Numbers β of a draw of `NearestClips`, free of noise.
    fn quiet_draw(frames: u32, random: &mut impl FnMut() -> u32) -> Vec<i16> {
        let blob = specimen(NumberFormat::W8A16, KINDS[2]);
        let model = Model::from_bytes(&blob).unwrap();
        // The Gaussian of 2^31 - 1 is the median.
        let mut draws = 0;
        let mut quiet = || {
            draws += 1;
            if draws <= 3 { random() } else { 0x7FFF_FFFF }
        };
        let code = model.sample(ActionId(0), frames, &mut quiet).unwrap();
        code.values()[..3].to_vec()
    }

    #[test]
    fn nearest_clips_are_those_around_the_length() {
        // Clips of action 0 have 10, 20 and 30 frames; two are drawn from, without a step towards the other.
        let firsts = |frames: u32| {
            let mut first = [0, u32::MAX].map(|which| {
                let mut draws = [which, 0, 0].into_iter();
                quiet_draw(frames, &mut || draws.next().unwrap_or(0))
            });
            first.sort();
            first
        };
        assert_eq!(firsts(10), firsts(12));
        assert_eq!(firsts(25), firsts(30));
        assert_ne!(firsts(10), firsts(30));
        assert_ne!(firsts(20)[0], firsts(20)[1]);
    }

    #[test]
    fn column_without_bits_has_its_least_value_in_every_clip() {
        for frames in 10..=30 {
            let code = quiet_draw(frames, &mut || 0);
            assert_eq!(code[1], -300, "{code:?}");
            assert!((-300..=306).contains(&code[0]), "{code:?}");
        }
    }

    fn drawn_with(kind: SamplerKind, dials: Dials, seed: u64) -> Code {
        let blob = specimen(NumberFormat::W8A16, kind);
        let model = Model::from_bytes(&blob).unwrap();
        let (mut random, mut code) = (Pcg32::new(seed), Code::new());
        let mut draw = || random.next_u32();
        model.sample_with(ActionId(0), 20, dials, &mut draw, &mut code).unwrap();
        code
    }

    #[test]
    fn motion_without_intensity_is_the_same_whatever_the_seed() {
        for kind in KINDS {
            let dials = Dials { intensity_q12: 0, ..Dials::NEUTRAL };
            assert_eq!(drawn_with(kind, dials, 1), drawn_with(kind, dials, 2));
        }
    }

    #[test]
    fn intensity_stretches_a_code_about_the_mean_of_its_action() {
        for kind in KINDS {
            let [mean, near, one, far] = [0, 2048, 4096, 6144].map(|intensity_q12| {
                drawn_with(kind, Dials { intensity_q12, ..Dials::NEUTRAL }, 5)
            });
            assert_eq!(one, drawn_with(kind, Dials::NEUTRAL, 5));
            for column in 0..3 {
                let [mean, near, one, far] =
                    [&mean, &near, &one, &far].map(|code| i32::from(code.values()[column]));
                assert!((2 * (near - mean) - (one - mean)).abs() <= 1, "{near} of {mean}, {one}");
                assert!((2 * (far - mean) - 3 * (one - mean)).abs() <= 1, "{far} of {mean}, {one}");
            }
            // α is the action's own.
            assert_eq!(mean.values()[3..], one.values()[3..]);
        }
    }

    #[test]
    fn draw_without_variety_is_the_clip_that_is_nearest_in_length() {
        let dials = Dials { variety_q12: 0, ..Dials::NEUTRAL };
        let kind = SamplerKind::NearestClips { clip_count: 2, row_bytes: 2 };
        let codes: Vec<Code> = (0..50).map(|seed| drawn_with(kind, dials, seed)).collect();
        assert!(codes.iter().all(|code| *code == codes[0]));
        let wide = Dials { variety_q12: 8192, ..Dials::NEUTRAL };
        let wide: Vec<Code> = (0..50).map(|seed| drawn_with(kind, wide, seed)).collect();
        assert!((1..50).all(|index| !wide[..index].contains(&wide[index])));
    }

    #[test]
    fn clip_codes_have_the_shared_noise_around_their_clips() {
        // Action 0 from 20 frames on has one clip: the mean is its code, σ is 30,000 / 2^8 code units.
        let blob = specimen(NumberFormat::W8A16, SamplerKind::ClipCodes);
        let model = Model::from_bytes(&blob).unwrap();
        let mut random = Pcg32::new(3);
        let draws: Vec<Vec<f64>> = (0..20_000)
            .map(|_| {
                let code = model.sample(ActionId(0), 25, &mut || random.next_u32()).unwrap();
                code.values().iter().map(|&value| f64::from(value)).collect()
            })
            .collect();
        let count = draws.len() as f64;
        for column in 0..3 {
            let mean = draws.iter().map(|draw| draw[column]).sum::<f64>() / count;
            let variance =
                draws.iter().map(|draw| (draw[column] - mean).powi(2)).sum::<f64>() / count;
            assert!((variance.sqrt() / 117.19 - 1.0).abs() < 0.02, "σ {}", variance.sqrt());
        }
    }
}
