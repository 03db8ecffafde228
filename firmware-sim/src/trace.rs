//! Station 11: one motion as the servos are told it, in virtual time.
//!
//! In:  a [`Model`], [`Options`].
//! Out: a [`Trace`]: every tick's `ServoCommand`, as CSV and in summary.
//!
//! Why here: what a robot will do can be read, drawn and compared before there is a robot, and
//! without waiting for the clock: time is counted, not measured.

mod calibration;
mod summary;

use karakuri::{
    ActionId, Code, Decoder, FramePosition, Model, Pcg32, Pose, ServoCommand, ServoMap, ServoStage,
};
use serde::Serialize;

use crate::error::{Error, Result};
use crate::host::widest_workspace;

pub use calibration::{PULSES_US, US_PER_S_MAX, US_PER_S2_MAX, US_PER_UNIT, own_servos, stand_ins};
pub use summary::{ServoSummary, Summary};

/// Default rate of commands: an analogue servo's own.
pub const TICK_HZ: u32 = 50;

/// What to trace, and on which servos.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Options {
    /// Name of the action.
    pub action: String,
    /// Length of the motion.
    pub seconds: f64,
    /// Seed of the motion.
    pub seed: u64,
    /// Move a length outside training to the nearest trained one instead of refusing it.
    #[serde(skip)]
    pub clamp: bool,
    /// Commands per second.
    pub tick_hz: u32,
    /// Drive stand-ins although the blob has servos of its own; true where it has none.
    pub stand_in: bool,
    /// Stand-ins: pulse width per degree of an angle, or per unit of any other channel; negative reverses all
    /// servos. Channels that are pulse widths are taken as they are.
    pub us_per_unit: f64,
    /// Speed limit of every stand-in.
    pub us_per_s_max: u32,
    /// Acceleration limit of every stand-in.
    pub us_per_s2_max: u32,
}

impl Options {
    /// Which servos are driven, for people.
    pub fn servos(&self) -> String {
        let Self { us_per_unit, us_per_s_max, us_per_s2_max, .. } = self;
        match self.stand_in {
            true => {
                format!("{us_per_unit} us per unit, {us_per_s_max} us/s, {us_per_s2_max} us/s2")
            }
            false => "servos as calibrated in the blob".to_owned(),
        }
    }
}

/// A motion as a list of commands.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// What was traced, with the seconds that it really took.
    pub options: Options,
    /// The blob's number format and the hash of the configuration that made it.
    pub provenance: String,
    /// Names of the servos, in the order of every command.
    pub servos: Vec<String>,
    /// Their calibration.
    pub maps: Vec<ServoMap>,
    /// First to last; at time 0 the servos have come softly from the park pose to the first pose.
    pub ticks: Vec<Tick>,
}

/// One instant of a trace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Since the start of the motion.
    pub time_us: u32,
    /// What the servos are told then.
    pub command: ServoCommand,
}

/// Decodes a motion and passes its scalar channels through core's servo stage.
///
/// # Errors
/// [`Error::BadInput`]: an unknown action, a length outside training, a model without scalar
/// channels or with too many, numbers beyond what a servo's calibration can hold.
pub fn trace(model: &Model<'_>, options: &Options) -> Result<Trace> {
    let own = calibration::own_servos(model).filter(|_| !options.stand_in);
    let stand_in = own.is_none();
    let (servos, maps) = match own {
        Some(servos) => servos,
        None => calibration::stand_ins(model.groups(), options)?,
    };
    let mut stage = ServoStage::new(&maps).map_err(|error| {
        Error::bad_input("model", "scalar channels", error, "servos that fit", "train on fewer")
    })?;
    let action = find_action(model, options)?;
    let frames = trained_frames(model, action, options)?;
    let code = sample(model, action, frames, options)?;
    let mut workspace = widest_workspace();
    let mut decoder = Decoder::new(model, &mut workspace)?;
    decoder.start(&code);
    let (mut pose, mut ticks, mut last_us) = (Pose::new(), Vec::new(), 0);
    for time_us in tick_times_us(model, frames, options)? {
        decoder.decode(FramePosition::after_us(time_us, model.rate_millihz()), &mut pose);
        if time_us == 0 {
            start_softly(&mut stage, &pose);
        }
        stage.aim(&pose);
        let command = stage.tick(time_us - last_us).clone();
        ticks.push(Tick { time_us, command });
        last_us = time_us;
    }
    let seconds = f64::from(frames) * 1000.0 / f64::from(model.rate_millihz());
    let options = Options { seconds, stand_in, ..options.clone() };
    Ok(Trace { options, provenance: provenance(model), servos, maps, ticks })
}

/// From the park pose to `pose`, in ticks of their own; with time left for slow servos.
fn start_softly(stage: &mut ServoStage, pose: &Pose) {
    const START_TICK_US: u32 = 20_000;
    stage.enable();
    for _ in 0..2 * ServoStage::SOFT_START_US / START_TICK_US {
        stage.aim(pose);
        stage.tick(START_TICK_US);
    }
}

fn find_action(model: &Model<'_>, options: &Options) -> Result<ActionId> {
    model.action_by_name(&options.action).ok_or_else(|| {
        let names = model.actions().collect::<Vec<_>>().join(", ");
        let remedy = "choose one of these, or train with clips of it";
        Error::bad_input(
            "--action",
            "the action",
            &options.action,
            format!("one of {names}"),
            remedy,
        )
    })
}

/// The length in frames; with `clamp` the nearest trained one, the shorter of two.
fn trained_frames(model: &Model<'_>, action: ActionId, options: &Options) -> Result<u32> {
    let seconds = options.seconds;
    if !(seconds.is_finite() && seconds > 0.0) {
        let remedy = "give the length in seconds, such as 2.4";
        return Err(Error::bad_input(
            "--seconds",
            "the length",
            seconds,
            "a positive number",
            remedy,
        ));
    }
    let rate_hz = f64::from(model.rate_millihz()) / 1000.0;
    let frames = (seconds * rate_hz).round().min(f64::from(u16::MAX)) as u32;
    if !options.clamp {
        return Ok(frames);
    }
    // Intervals of lengths may leave gaps between them.
    let is_trained = |&frames: &u32| model.sample(action, frames, &mut || 0).is_ok();
    let outwards = (0..=u32::from(u16::MAX))
        .flat_map(|distance| [frames.checked_sub(distance), frames.checked_add(distance)]);
    Ok(outwards.flatten().find(is_trained).unwrap_or(frames))
}

fn sample(model: &Model<'_>, action: ActionId, frames: u32, options: &Options) -> Result<Code> {
    let mut random = Pcg32::new(options.seed);
    model.sample(action, frames, &mut || random.next_u32()).map_err(|_| {
        let trained = model.trained_frames(action);
        let [min_s, max_s] = [trained.start(), trained.end()]
            .map(|&frames| f64::from(frames) * 1000.0 / f64::from(model.rate_millihz()));
        Error::bad_input(
            "--seconds",
            format!("the length of {}", options.action),
            format!("{} s", options.seconds),
            format!("a length of the clips, {min_s:.2} to {max_s:.2} s"),
            "ask for a trained length, or add --clamp to take the nearest",
        )
    })
}

/// From 0 to the last frame. // (tick)
fn tick_times_us(model: &Model<'_>, frames: u32, options: &Options) -> Result<Vec<u32>> {
    let tick_hz = u64::from(options.tick_hz);
    let last_frame = u64::from(frames.saturating_sub(1));
    let last_tick = last_frame * 1000 * tick_hz / u64::from(model.rate_millihz());
    let time_us = |tick: u64| u32::try_from(tick * 1_000_000 / tick_hz.max(1)).ok();
    (0..=last_tick).map(time_us).collect::<Option<_>>().ok_or_else(|| {
        let expected = format!("at most {} s", u32::MAX / 1_000_000);
        let remedy = "the device counts microseconds in 32 bits: ask for a shorter motion";
        Error::bad_input("--seconds", "the length", options.seconds, expected, remedy)
    })
}

fn provenance(model: &Model<'_>) -> String {
    let hash = model.provenance().config_hash;
    let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{} in core's {}, config {hash}", model.manifest().name, model.number_format().name())
}

impl Trace {
    /// Comment lines, a header `time_s,jaw_us,…`, one row a tick: what `host-trainer` imports as
    /// servo tracks.
    ///
    /// # Errors
    /// [`Error::Io`] if the memory for it is refused.
    pub fn csv(&self) -> Result<Vec<u8>> {
        let one_line = |text: &str| text.replace(['\r', '\n'], " ");
        let Options { action, seconds, seed, tick_hz, .. } = &self.options;
        let comments = format!(
            "# {}\n# action {}, {seconds} s, seed {seed}, {tick_hz} Hz, {}\n",
            one_line(&self.provenance),
            one_line(action),
            self.options.servos()
        );
        let mut table = csv::Writer::from_writer(comments.into_bytes());
        let header = self.servos.iter().map(|name| format!("{name}_us"));
        let failed = |error: csv::Error| Error::io("encode", "trace")(error.into());
        table.write_record(std::iter::once("time_s".to_owned()).chain(header)).map_err(failed)?;
        for tick in &self.ticks {
            let time_s = format!("{:.6}", f64::from(tick.time_us) / 1e6);
            let pulses_us = tick.command.pulses_us().iter().map(u16::to_string);
            table.write_record(std::iter::once(time_s).chain(pulses_us)).map_err(failed)?;
        }
        table.into_inner().map_err(|error| Error::io("encode", "trace")(error.into_error()))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use karakuri::NumberFormat;

    pub fn options() -> Options {
        Options {
            action: "bow".to_owned(),
            seconds: 0.8,
            seed: 7,
            clamp: false,
            tick_hz: TICK_HZ,
            stand_in: false,
            us_per_unit: US_PER_UNIT,
            us_per_s_max: US_PER_S_MAX,
            us_per_s2_max: US_PER_S2_MAX,
        }
    }

    fn trace_fixture(options: &Options) -> Result<Trace> {
        let blob = Fixture::new(1).blob(NumberFormat::W8A16);
        trace(&Model::from_bytes(&blob).unwrap(), options)
    }

    /// The text of a refusal of bad input.
    fn refusal(options: &Options) -> String {
        let error = trace_fixture(options).unwrap_err();
        assert_eq!(error.exit_code(), 3, "{error}");
        error.to_string()
    }

    #[test]
    fn unknown_action_names_those_there_are() {
        let text = refusal(&Options { action: "nod".to_owned(), ..options() });
        assert!(text.contains("nod") && text.contains("bow, write"), "{text}");
    }

    #[test]
    fn length_outside_training_is_rejected_unless_clamped() {
        for (seconds, frames) in [(0.02, 30.0), (99.0, 60.0)] {
            let long = Options { seconds, ..options() };
            assert!(refusal(&long).contains("0.60 to 1.20 s"));
            let trace = trace_fixture(&Options { clamp: true, ..long }).unwrap();
            assert_eq!(trace.options.seconds, frames / 50.0);
        }
    }

    #[test]
    fn length_that_is_no_positive_number_is_rejected() {
        for seconds in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let text = refusal(&Options { seconds, clamp: true, ..options() });
            assert!(text.contains("a positive number"), "{text}");
        }
    }

    #[test]
    fn same_seed_gives_the_same_trace_and_another_seed_another() {
        let csv = |seed| trace_fixture(&Options { seed, ..options() }).unwrap().csv().unwrap();
        assert_eq!(csv(7), csv(7));
        assert_ne!(csv(7), csv(8));
    }

    #[test]
    fn ticks_run_from_the_first_to_the_last_frame_at_their_own_rate() {
        for (tick_hz, count, last_us) in [(50, 40, 780_000), (60, 47, 766_666), (10, 8, 700_000)] {
            let trace = trace_fixture(&Options { tick_hz, ..options() }).unwrap();
            assert_eq!(trace.ticks.len(), count);
            assert_eq!(trace.ticks[0].time_us, 0);
            assert_eq!(trace.ticks.last().unwrap().time_us, last_us);
        }
    }

    #[test]
    fn csv_says_where_it_comes_from_and_has_a_row_for_every_tick() {
        let text = String::from_utf8(trace_fixture(&options()).unwrap().csv().unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let hash = "a5".repeat(32);
        assert_eq!(lines[0], format!("# fixture in core's w8a16, config {hash}"));
        assert_eq!(
            lines[1],
            "# action bow, 0.8 s, seed 7, 50 Hz, 10 us per unit, 6000 us/s, 60000 us/s2"
        );
        assert_eq!(lines[2], "time_s,neck_us");
        assert!(lines[3].starts_with("0.000000,"), "{}", lines[3]);
        assert_eq!(lines.len(), 3 + 40);
    }

    #[test]
    fn unlimited_servo_follows_the_pose_to_the_microsecond() {
        let blob = Fixture::new(1).blob(NumberFormat::W8A16);
        let model = Model::from_bytes(&blob).unwrap();
        let (us_per_s_max, us_per_s2_max) = (1_600_000, u32::MAX);
        let unlimited = Options { us_per_s_max, us_per_s2_max, ..options() };
        let trace = trace(&model, &unlimited).unwrap();
        let mut random = Pcg32::new(7);
        let code = model.sample(ActionId(0), 40, &mut || random.next_u32()).unwrap();
        let mut workspace = widest_workspace();
        let mut decoder = Decoder::new(&model, &mut workspace).unwrap();
        decoder.start(&code);
        let mut pose = Pose::new();
        for (frame, tick) in trace.ticks.iter().enumerate() {
            decoder.decode(FramePosition::from_frames(frame as u32), &mut pose);
            let exact_us = 1500.0 + US_PER_UNIT * pose.values().next().unwrap();
            assert!((f64::from(tick.command.pulses_us()[0]) - exact_us).abs() < 0.503);
        }
    }
}
