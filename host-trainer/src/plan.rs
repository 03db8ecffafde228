//! Before anything is built: does the model fit the board, how fast is it there, and would keyframes be smaller?
//!
//! In:  a blob, boards, clips as curves.
//! Out: [`Plan`], as text or JSON.
//!
//! Why here: hand-made keyframes are small, and a model only pays beyond some seconds of motion. A tool that says so
//! before the soldering is worth more than one that is praised until then.

pub mod board;
pub mod core_cost;
pub mod hinges;
pub mod keyframe_bytes;
mod text;
pub mod tick_cost;

use karakuri::manifest::{TIME_LAYER, TensorKind, tensor_plan};
use karakuri::{GroupKind, Model};
use serde::Serialize;

use board::Board;
use core_cost::PoseWork;
use keyframe_bytes::{KeyframeCost, KeyframeReport};
use tick_cost::TickCost;

/// Share of a processor that motion may take; the rest is the user's.
pub const SAFE_SHARE: f64 = 0.7;
/// Decoded poses per second that are compared.
pub const POSE_RATES_HZ: [f64; 3] = [12.5, 25.0, 50.0];
/// Ticks of the servo loop per second that are compared.
pub const TICK_RATES_HZ: [f64; 3] = [50.0, 100.0, 200.0];
/// Flash of a player of keyframes, which a model is spared; an estimate.
pub const KEYFRAME_PLAYER_BYTES: usize = 1024;
/// Stated with every plan.
pub const VERDICT: &str = "Use keyframes if library < T*; use the model if you need variation, arbitrary duration, or \
    blending.";

/// Everything that a plan says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// What the model was trained on.
    pub name: String,
    /// Its number format.
    pub format: &'static str,
    /// All of the blob.
    pub blob_bytes: usize,
    /// Weights that are read for every pose.
    pub weight_bytes_per_pose: u64,
    /// Products of a pose.
    pub multiply_accumulates_per_pose: u64,
    /// Channels of a pose.
    pub channels: usize,
    /// Servos: one a scalar channel, three a rotation.
    pub servos: usize,
    /// One a board.
    pub boards: Vec<BoardPlan>,
    /// The same motions as keyframes.
    pub keyframes: KeyframeReport,
    /// Where the model becomes the smaller one, for every tolerance of the keyframes.
    pub break_even: Vec<BreakEven>,
    /// What follows, in a sentence.
    pub verdict: String,
}

/// The model on one board.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardPlan {
    /// The part.
    pub part: &'static str,
    /// Its processor.
    pub core: &'static str,
    /// Its clock.
    pub clock_mhz: u32,
    /// Blob and code.
    pub flash_bytes: usize,
    /// Of the part.
    pub flash_bytes_max: usize,
    /// Model, workspace, player with its servo stage, stack.
    pub ram_bytes: usize,
    /// Of the part.
    pub ram_bytes_max: usize,
    /// Whether both fit.
    pub fits: bool,
    /// Of one pose.
    pub instructions_per_pose: u64,
    /// Of one tick without a pose, at 50 ticks a second.
    pub instructions_per_tick: u64,
    /// Cycles of an instruction; assumed.
    pub cycles_per_instruction: f64,
    /// Time of one pose, weights in flash.
    pub pose_ms: f64,
    /// Time of one pose, the blob in RAM; none where it has no room there.
    pub pose_ms_from_ram: Option<f64>,
    /// Poses per second at a tick each that take [`SAFE_SHARE`] of the processor, weights in flash.
    pub safe_poses_per_s: f64,
    /// Share of the processor. // (`POSE_RATES_HZ`, `TICK_RATES_HZ`)
    pub load: [[f64; 3]; 3],
}

/// Library length at which model and keyframes take the same flash.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BreakEven {
    /// Largest error of the keyframes.
    pub tolerance_deg: f64,
    /// Seconds against straight lines, smaller and larger way to store a key.
    pub linear_s: [f64; 2],
    /// Seconds against cubics.
    pub cubic_s: [f64; 2],
    /// The longest of them: below it, some keyframes are smaller.
    pub seconds: f64,
    /// Bytes of the smallest keyframes of these motions.
    pub keyframe_bytes: u64,
    /// Whether these motions are smaller as keyframes.
    pub keyframes_win: bool,
}

impl Plan {
    /// Plans a blob of `blob_bytes` for boards, against keyframes of its motions.
    pub fn new(
        model: &Model<'_>,
        blob_bytes: usize,
        boards: &[Board],
        keyframes: KeyframeReport,
    ) -> Self {
        let servos = servo_count(model);
        let boards: Vec<BoardPlan> =
            boards.iter().map(|board| board_plan(model, *board, blob_bytes, servos)).collect();
        let code_bytes = boards.iter().map(|board| board.flash_bytes - blob_bytes).max();
        let model_bytes =
            blob_bytes + code_bytes.unwrap_or(0).saturating_sub(KEYFRAME_PLAYER_BYTES);
        let break_even = break_even(&keyframes, model_bytes);
        Self {
            name: model.manifest().name.into(),
            format: model.number_format().name(),
            blob_bytes,
            weight_bytes_per_pose: weight_bytes(model),
            multiply_accumulates_per_pose: model.multiply_accumulates_per_pose(),
            channels: model.channel_count(),
            servos,
            boards,
            verdict: verdict(&keyframes, &break_even, model_bytes),
            keyframes,
            break_even,
        }
    }
}

fn servo_count(model: &Model<'_>) -> usize {
    let of_kind = |kind| match kind {
        GroupKind::Scalar => 1,
        GroupKind::Rotation6d => 3,
        GroupKind::Translation | GroupKind::Position => 0,
    };
    model.groups().map(|group| of_kind(group.kind)).sum()
}

/// Weights, and scales of their groups, of all layers after the code half.
fn weight_bytes(model: &Model<'_>) -> u64 {
    let is_read = |kind: &TensorKind| match kind {
        TensorKind::Weights(layer) | TensorKind::GroupScales(layer) => *layer >= TIME_LAYER,
        _ => false,
    };
    tensor_plan(model.manifest()).filter(|(kind, _)| is_read(kind)).map(|(_, bytes)| bytes).sum()
}

/// Widest-layer buffers of the format's arithmetic.
fn workspace_bytes(model: &Model<'_>) -> usize {
    let per_width = match model.number_format() {
        karakuri::NumberFormat::F16 => 20,
        _ => 8,
    };
    model.workspace_width() * per_width
}

fn board_plan(model: &Model<'_>, board: Board, blob_bytes: usize, servos: usize) -> BoardPlan {
    let (part, format) = (board.part(), model.number_format());
    let cost = part.core.cost(format);
    let pose = part.core.pose_instructions(format, &PoseWork::of_model(model));
    let tick = TickCost::new(part.core, model.channel_count(), servos);
    let cycles_per_instruction = part.core.cycles_per_instruction(format);
    let pose_cycles = pose * cycles_per_instruction;
    let flash_cycles = pose_cycles + weight_bytes(model) as f64 * part.flash_cycles_per_byte;
    // Ticks are integer code whatever the format.
    let cycles_per_tick_instruction =
        part.core.cycles_per_instruction(karakuri::NumberFormat::W8A16);
    let tick_cycles = tick.per_tick as f64 * cycles_per_tick_instruction;
    let step_cycles_per_s = tick.per_s as f64 * cycles_per_tick_instruction;
    let clock_hz = f64::from(part.clock_mhz) * 1e6;
    let ram_bytes = workspace_bytes(model)
        + size_of::<Model<'_>>()
        + tick_cost::player_ram_bytes(model.channel_count())
        + cost.stack_bytes as usize;
    let flash_bytes = blob_bytes + cost.code_bytes as usize;
    BoardPlan {
        part: part.name,
        core: part.core.name(),
        clock_mhz: part.clock_mhz,
        flash_bytes,
        flash_bytes_max: part.flash_bytes,
        ram_bytes,
        ram_bytes_max: part.ram_bytes,
        fits: flash_bytes <= part.flash_bytes && ram_bytes <= part.ram_bytes,
        instructions_per_pose: pose.round() as u64,
        instructions_per_tick: tick.instructions_at(50),
        cycles_per_instruction,
        pose_ms: flash_cycles / clock_hz * 1e3,
        pose_ms_from_ram: (ram_bytes + blob_bytes <= part.ram_bytes)
            .then_some(pose_cycles / clock_hz * 1e3),
        safe_poses_per_s: (SAFE_SHARE * clock_hz - step_cycles_per_s).max(0.0)
            / (flash_cycles + tick_cycles),
        load: POSE_RATES_HZ.map(|poses| {
            TICK_RATES_HZ.map(|ticks| {
                (poses * flash_cycles + ticks * tick_cycles + step_cycles_per_s) / clock_hz
            })
        }),
    }
}

fn break_even(keyframes: &KeyframeReport, model_bytes: usize) -> Vec<BreakEven> {
    let seconds = |cost: &KeyframeCost| {
        cost.bytes_per_s
            .map(|per_s| if per_s > 0.0 { model_bytes as f64 / per_s } else { f64::INFINITY })
    };
    let row = |row: &keyframe_bytes::KeyframeRow| {
        let (linear_s, cubic_s) = (seconds(&row.linear), seconds(&row.cubic));
        let keyframe_bytes = row.linear.bytes[0].min(row.cubic.bytes[0]);
        BreakEven {
            tolerance_deg: row.tolerance_deg,
            linear_s,
            cubic_s,
            seconds: linear_s[0].max(cubic_s[0]),
            keyframe_bytes,
            keyframes_win: keyframe_bytes < model_bytes as u64,
        }
    };
    keyframes.rows.iter().map(row).collect()
}

/// At the tolerance of a hobby servo's own accuracy and wider: 2°.
fn verdict(keyframes: &KeyframeReport, break_even: &[BreakEven], model_bytes: usize) -> String {
    let Some(at) = break_even.iter().find(|row| row.tolerance_deg == 2.0) else {
        return VERDICT.to_owned();
    };
    let winner = match at.keyframes_win {
        true => "keyframes win: they are smaller, and they decode faster",
        false => "the model wins on flash",
    };
    let thousands = crate::table::thousands;
    format!(
        "{:.0} s of motion within 2° are {} bytes as keyframes, the model is {}: {winner}. T* = {:.0} s. {VERDICT}",
        keyframes.seconds,
        thousands(at.keyframe_bytes),
        thousands(model_bytes as u64),
        at.seconds
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;
    use hinges::Hinges;

    fn plan(clips: usize) -> Plan {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/creature-tiny-w8a16.kara");
        let blob = std::fs::read(path).unwrap();
        let motions = specimen::character(clips);
        let hinges: Vec<Hinges> =
            motions.iter().map(|motion| Hinges::new(&motion.layout, &motion.poses)).collect();
        let keyframes = KeyframeReport::new("test".into(), &hinges, 50.0);
        let boards = [Board::Rp2040, Board::Stm32f4, Board::Stm32h7];
        let model = Model::from_bytes(&blob).unwrap();
        Plan::new(&model, blob.len(), &boards, keyframes)
    }

    #[test]
    fn few_clips_are_smaller_as_keyframes_and_the_plan_says_so() {
        let plan = plan(3);
        assert!(
            plan.break_even
                .iter()
                .all(|row| row.keyframes_win && row.seconds > plan.keyframes.seconds)
        );
        assert!(plan.verdict.contains("keyframes win") && plan.verdict.ends_with(VERDICT));
        // A coarser error takes fewer bytes a second, so the model pays later.
        assert!(plan.break_even.is_sorted_by(|a, b| a.seconds < b.seconds));
    }

    #[test]
    fn without_motions_nothing_breaks_even() {
        let plan = plan(0);
        assert!(plan.break_even.iter().all(|row| row.seconds.is_infinite()));
    }

    #[test]
    fn boards_are_ordered_by_what_they_can_do() {
        let plan = plan(1);
        let [slow, middle, fast] = [0, 1, 2].map(|index| &plan.boards[index]);
        assert!(slow.safe_poses_per_s < middle.safe_poses_per_s);
        assert!(middle.safe_poses_per_s < fast.safe_poses_per_s);
        for board in &plan.boards {
            assert!(board.fits && board.pose_ms_from_ram.unwrap() < board.pose_ms);
            // More poses and more ticks are more work.
            assert!(board.load.is_sorted_by(|a, b| a[0] < b[0]));
            assert!(board.load.iter().all(|row| row.is_sorted()));
        }
    }

    #[test]
    fn text_has_every_board_and_tolerance() {
        let text = plan(2).to_string();
        for words in
            ["RP2040", "STM32F411", "0.5°", "4°", "T*", "counts under QEMU", "Use keyframes if"]
        {
            assert!(text.contains(words), "{words} is missing in\n{text}");
        }
    }
}
