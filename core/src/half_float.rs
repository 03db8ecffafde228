//! `f16`: binary16 weights, f32 activations and accumulators; for parts with an FPU.
//!
//! # Accuracy
//! Every operation is an IEEE operation in a stated order (no fused multiply-add) and the ELU's exponential is the
//! integers' (within 2.6e-5 of the exact one), so hosts and Cortex-M give the same bits wherever f32 follows IEEE 754.

use crate::code::Code;
use crate::decoder::Stage;
use crate::elu::{POWER_BITS, one_minus_exp2};
use crate::kernel;
use crate::layer::Layer;
use crate::little_endian::{i32s, u32s};
use crate::manifest::{CODE_LAYER, GATE_MAX, TIME_LAYER};
use crate::model::Model;
use crate::pose::Pose;
use crate::time_embedding::{FramePosition, sinusoids};
use crate::workspace::FloatBuffers;

/// `folded = weights · code + bias`.
pub(crate) fn fold(model: &Model<'_>, buffers: &mut FloatBuffers<'_>, code: &Code) {
    let Some(layer) = &model.layer(CODE_LAYER) else {
        return;
    };
    let unit = 1.0 / (1u32 << (model.manifest().code_fraction_bits & 31)) as f32;
    for (place, &value) in buffers.front.iter_mut().zip(&code.values) {
        *place = f32::from(value) * unit;
    }
    let (starts, phases) = (model.manifest().gate_row(), model.manifest().phase_row());
    dense(layer, floats(layer.bias), buffers.front, |row, sum| {
        let folded = match row {
            _ if (starts..phases).contains(&row) => gate_of(sum),
            _ => sum,
        };
        set(buffers.folded, row, folded);
    });
}

/// A gate from its row, a share of the largest.
fn gate_of(row: f32) -> f32 {
    // Comparisons and not `clamp`, which panics where it cannot see that its bounds are in order.
    let share = if row > 0.0 { row } else { 0.0 };
    (if share < 1.0 { share } else { 1.0 }) * GATE_MAX as f32
}

/// Decodes one pose.
pub(crate) fn decode(
    model: &Model<'_>,
    buffers: &mut FloatBuffers<'_>,
    position: FramePosition,
    pose: &mut Pose,
    observe: &mut impl FnMut(Stage),
) {
    let Some(time_half) = &model.layer(TIME_LAYER) else {
        return;
    };
    let (mut front, mut back) = (&mut *buffers.front, &mut *buffers.back);
    let mut phases = match model.manifest().has_phases() {
        true => buffers.folded.get(model.manifest().phase_row()..).unwrap_or_default().iter(),
        false => [].iter(),
    };
    for (pair, step) in front.chunks_exact_mut(2).zip(u32s(model.frequencies)) {
        // Turns in Q16: the whole ones fall off.
        let phase = phases.next().map_or(0, |&turns| (turns * 65_536.0) as i32 as u32) << 16;
        let values = sinusoids(position, step, phase).map(|q15| q15 as f32 * (1.0 / 32_767.0));
        pair.iter_mut().zip(values).for_each(|(place, value)| *place = value);
    }
    observe(Stage::TimeEmbedding);
    let starts = buffers.folded.iter().copied();
    let mut gates = match model.manifest().has_gates() {
        true => buffers.folded.get(model.manifest().gate_row()..).unwrap_or_default(),
        false => &[],
    };
    activate(time_half, starts, front, back, &mut gates);
    let mut index = TIME_LAYER;
    observe(Stage::Layer(index));
    while let Some(layer) = &model.layer(index + 1) {
        index += 1;
        core::mem::swap(&mut front, &mut back);
        if index + 1 == model.manifest().layers.len() {
            write_pose(layer, front, pose);
            break;
        }
        activate(layer, floats(layer.bias), front, back, &mut gates);
        observe(Stage::Layer(index));
    }
    observe(Stage::Output);
}

/// `output = ELU(gate · (weights · input + start))`; takes the layer's gates off the front, if there are any.
fn activate(
    layer: &Layer<'_>,
    starts: impl Iterator<Item = f32>,
    input: &[f32],
    output: &mut [f32],
    gates: &mut &[f32],
) {
    match gates.split_at_checked(layer.shape.rows_filled()) {
        Some((own, rest)) if !own.is_empty() => {
            *gates = rest;
            dense(layer, starts, input, |row, sum| {
                let gate = own.get(row).copied().unwrap_or(0.0);
                set(output, row, elu(sum * gate));
            });
        }
        _ => dense(layer, starts, input, |row, sum| set(output, row, elu(sum))),
    }
}

fn write_pose(layer: &Layer<'_>, input: &[f32], pose: &mut Pose) {
    pose.channels.clear();
    dense(layer, floats(layer.bias), input, |row, sum| {
        if row < usize::from(layer.shape.output_count) {
            // The loader has checked that all channels fit.
            let _ = pose.channels.push(q16(sum));
        }
    });
}

/// Hands `weights · input + start` of every row to `sink`, in order.
fn dense(
    layer: &Layer<'_>,
    mut starts: impl Iterator<Item = f32>,
    input: &[f32],
    mut sink: impl FnMut(usize, f32),
) {
    for (index, (block, _)) in layer.blocks().enumerate() {
        let mut sums = [(); 4].map(|()| starts.next().unwrap_or(0.0));
        kernel::f16(block, input, &mut sums);
        for (row, sum) in sums.into_iter().enumerate() {
            sink(4 * index + row, sum);
        }
    }
}

fn set(buffer: &mut [f32], index: usize, value: f32) {
    if let Some(place) = buffer.get_mut(index) {
        *place = value;
    }
}

fn elu(x: f32) -> f32 {
    // Octaves in Q5.27, rounded down; `as` saturates, so that −∞ falls by 1.
    const POWER: f32 = core::f32::consts::LOG2_E * (1u32 << POWER_BITS) as f32;
    if x >= 0.0 { x } else { -(one_minus_exp2((-x * POWER) as u32) as f32) * (1.0 / 65_536.0) }
}

/// Nearest Q15.16, saturated: even an absurd weight cannot do more than reach the end of the range.
fn q16(value: f32) -> i32 {
    let scaled = value * 65_536.0;
    (if scaled < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as i32
}

fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    i32s(bytes).map(|bits| f32::from_bits(bits.cast_unsigned()))
}
