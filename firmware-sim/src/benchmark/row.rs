//! One line of the benchmark: a network in a format on a target.
//!
//! In:  [`Measurements`] of a run, the programs that were built, the model.
//! Out: [`Row`], as JSON or in tables.

use karakuri::Model;
use karakuri::manifest::{TensorKind, tensor_plan};
use serde::Serialize;

use super::Subject;
use super::frame_rate::Estimate;
use super::measurements::Measurements;
use crate::error::Result;
use crate::executable::{Executable, Purpose};
use crate::region_counts::RegionCounts;
use crate::target::Target;

/// Everything that was counted; `_bytes` are bytes, `_instructions` are instructions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the target.
    pub target: &'static str,
    /// Number format of the blob.
    pub format: &'static str,
    /// Name of the network, or of the blob's file.
    pub network: String,
    /// What the compiler says about its version.
    pub compiler: String,
    /// Multiply-accumulates of a pose.
    pub multiply_accumulates: u64,
    /// Multiply-accumulates at the start of a motion.
    pub multiply_accumulates_per_motion: u64,
    /// Everything that `Decoder::decode` does.
    pub instructions_per_pose: u64,
    /// The quotient of the two.
    pub instructions_per_multiply_accumulate: f64,
    /// A pose at a whole frame, its sinusoids and their layer looked up; none where the blob has no time table.
    pub time_table_instructions_per_pose: Option<u64>,
    /// Half of what `PairDecoder::decode` does; none where the blob's weights have no kernels for pairs.
    pub pair_instructions_per_pose: Option<u64>,
    /// Of a pose: multiply-accumulate loops.
    pub kernel_instructions: u64,
    /// Of a pose: activation, requantisation and the loops over rows, in all layers.
    pub activation_instructions: u64,
    /// Of a pose: the compiler's routines, in all layers.
    pub library_instructions: u64,
    /// The same pose by parts: time embedding, layer 1 to n, output. Watching them costs a few instructions more.
    pub parts: Vec<PartCounts>,
    /// `Model::from_bytes`: once after reset.
    pub load_instructions: u64,
    /// `Model::sample`: once a motion.
    pub sample_instructions: u64,
    /// `Decoder::start`: once a motion.
    pub fold_instructions: u64,
    /// One standard normal number, with its random bits; a mean.
    pub gaussian_instructions: f64,
    /// All of the blob.
    pub blob_bytes: usize,
    /// Weights of all layers, with the scales of their groups.
    pub weight_bytes: u64,
    /// Products of the time half at whole frames.
    pub time_table_bytes: u64,
    /// The rest of the blob: biases, scales, the sampler's tables, names.
    pub table_bytes: u64,
    /// The smallest program with this format, without blob and vector table: `text_bytes` and `rodata_bytes`.
    pub code_bytes: u64,
    /// Its instructions.
    pub text_bytes: u64,
    /// Its constants: tables of sine, exponential function and normal distribution; texts.
    pub rodata_bytes: u64,
    /// `Workspace` of the model's width.
    pub workspace_bytes: u64,
    /// `PairWorkspace` of the model's width.
    pub pair_workspace_bytes: Option<u64>,
    /// A `Model`.
    pub model_bytes: u64,
    /// A `Code`, at its largest.
    pub motion_code_bytes: u64,
    /// A `Pose`, at its largest.
    pub pose_bytes: u64,
    /// Statics of the counting program.
    pub static_bytes: u64,
    /// Deepest stack of sampling, folding and decoding, without the objects above.
    pub stack_bytes: u64,
    /// Deepest stack of `Model::from_bytes`.
    pub load_stack_bytes: u64,
    /// Deepest stack of `Model::sample`.
    pub sample_stack_bytes: u64,
    /// Deepest stack of `Decoder::start`.
    pub fold_stack_bytes: u64,
    /// Deepest stack of `Decoder::decode`.
    pub pose_stack_bytes: u64,
    /// Poses per second; not measured.
    pub estimate: Estimate,
}

/// Instructions of one part of a pose, by purpose.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PartCounts {
    /// `time embedding`, `layer 1`, …, `output`.
    pub part: String,
    /// All of them.
    pub instructions: u64,
    /// Multiply-accumulate loops.
    pub kernel_instructions: u64,
    /// The compiler's routines: wide products, software floats, copies of memory.
    pub library_instructions: u64,
    /// Everything else; in a layer: activation, requantisation, and the loop over its rows.
    pub other_instructions: u64,
}

impl PartCounts {
    fn new(part: &str, counts: &RegionCounts, program: &Executable<'_>) -> Self {
        let of = |purpose| -> u64 {
            let addresses = counts.addresses.iter();
            let meant = addresses.filter(|(address, _)| program.purpose(*address) == purpose);
            meant.map(|(_, count)| count).sum()
        };
        Self {
            part: part.to_owned(),
            instructions: counts.instructions,
            kernel_instructions: of(Purpose::Kernel),
            library_instructions: of(Purpose::Library),
            other_instructions: of(Purpose::Other),
        }
    }

    /// Whether it multiplies and accumulates.
    pub fn is_layer(&self) -> bool {
        self.part.starts_with("layer") || self.part == "output"
    }
}

impl Row {
    pub(super) fn new(
        subject: &Subject,
        model: &Model<'_>,
        target: Target,
        compiler: &str,
        measurements: &Measurements,
        program: &Executable<'_>,
        minimal: &Executable<'_>,
    ) -> Result<Self> {
        let instructions = |name: &str| measurements.instructions(name);
        let number = |name: &str| measurements.number(name);
        let format = model.number_format();
        let instructions_per_pose = instructions("pose")?;
        let multiply_accumulates = model.multiply_accumulates_per_pose();
        let of_weights = |kind| matches!(kind, TensorKind::Weights(_) | TensorKind::GroupScales(_));
        let weight_bytes = tensor_bytes(model, of_weights);
        let time_table_bytes = tensor_bytes(model, |kind| kind == TensorKind::TimeTable);
        let time_table = (time_table_bytes > 0).then_some(());
        let [text_bytes, rodata_bytes] =
            [".text", ".rodata"].map(|section| minimal.section_bytes(section));
        let parts = parts(measurements, program);
        let in_layers = |of: fn(&PartCounts) -> u64| -> u64 {
            parts.iter().filter(|part| part.is_layer()).map(of).sum()
        };
        let sample_stack_bytes = number("stack_sample")?;
        let fold_stack_bytes = number("stack_fold")?;
        let pose_stack_bytes = number("stack_pose")?;
        Ok(Self {
            target: target.name(),
            format: format.name(),
            network: subject.network.clone(),
            compiler: compiler.to_owned(),
            multiply_accumulates,
            multiply_accumulates_per_motion: model.multiply_accumulates_per_motion(),
            instructions_per_pose,
            instructions_per_multiply_accumulate: instructions_per_pose as f64
                / multiply_accumulates as f64,
            time_table_instructions_per_pose: time_table
                .map(|_| instructions("whole frame"))
                .transpose()?,
            pair_instructions_per_pose: instructions("pair").ok().map(|pair| pair / 2),
            kernel_instructions: in_layers(|part| part.kernel_instructions),
            activation_instructions: in_layers(|part| part.other_instructions),
            library_instructions: in_layers(|part| part.library_instructions),
            parts,
            load_instructions: instructions("load")?,
            sample_instructions: instructions("sample")?,
            fold_instructions: instructions("fold")?,
            gaussian_instructions: gaussian_instructions(measurements)?,
            blob_bytes: subject.blob.len(),
            weight_bytes,
            time_table_bytes,
            table_bytes: subject.blob.len() as u64 - weight_bytes - time_table_bytes,
            code_bytes: text_bytes + rodata_bytes,
            text_bytes,
            rodata_bytes,
            workspace_bytes: number("workspace")?,
            pair_workspace_bytes: number("pair_workspace").ok(),
            model_bytes: number("model")?,
            motion_code_bytes: number("code")?,
            pose_bytes: number("pose")?,
            static_bytes: number("static")?,
            stack_bytes: sample_stack_bytes.max(fold_stack_bytes).max(pose_stack_bytes),
            load_stack_bytes: number("stack_load")?,
            sample_stack_bytes,
            fold_stack_bytes,
            pose_stack_bytes,
            estimate: Estimate::new(target, format, instructions_per_pose),
        })
    }
}

fn gaussian_instructions(measurements: &Measurements) -> Result<f64> {
    let draws = measurements.number("gaussians")?.max(1);
    Ok(measurements.instructions("gaussians")? as f64 / draws as f64)
}

/// The regions between the whole pose and the return from it.
fn parts(measurements: &Measurements, program: &Executable<'_>) -> Vec<PartCounts> {
    let is_part =
        |name: &str| name == "time embedding" || name.starts_with("layer ") || name == "output";
    let regions = measurements.regions().filter(|(name, _)| is_part(name));
    regions.map(|(name, counts)| PartCounts::new(name, counts, program)).collect()
}

/// Bytes of all tensors of a kind.
fn tensor_bytes(model: &Model<'_>, is_meant: impl Fn(TensorKind) -> bool) -> u64 {
    let plan = tensor_plan(model.manifest());
    plan.filter(|&(kind, _)| is_meant(kind)).map(|(_, length)| length).sum()
}
