//! The integer formats: packed weights, i32 accumulators, nothing but integers.
//!
//! Why here: the same bits on every machine follow from integer arithmetic with stated roundings. Sums may wrap on
//! their way, because the loader has proved for every row that none has wrapped at its end. `FRAMES` is 1, or 2 where
//! a pass over the weights serves two frames.

use crate::code::Code;
use crate::decoder::Stage;
use crate::kernel::{self, Quad};
use crate::layer::{Inputs, Layer, Order, Sums, fours};
use crate::little_endian::u32s;
use crate::manifest::{CODE_LAYER, TIME_LAYER};
use crate::model::Model;
use crate::packing::BLOCK_ROWS;
use crate::pose::Pose;
use crate::requantize::Requantizer;
use crate::time_embedding::{FramePosition, turned_sinusoids};
use crate::workspace::Buffers;

/// `folded = weights · code + bias`, in accumulators of the time half.
pub(crate) fn fold<const FRAMES: usize>(
    model: &Model<'_>,
    buffers: &mut Buffers<'_, FRAMES>,
    code: &Code,
) {
    let Some(code_half) = &model.layer(CODE_LAYER) else {
        return;
    };
    let front = buffers.front.as_flattened_mut();
    let back = buffers.back.as_flattened_mut();
    store_code(code_half, &code.values, front, back);
    let room = model.time_room();
    let starts = model.manifest().gate_row() / BLOCK_ROWS;
    let phases = model.manifest().phase_row() / BLOCK_ROWS;
    let rows = code_half.blocks().zip(code_half.biases()).zip(code_half.requantizers());
    let places = buffers.folded.iter_mut().enumerate();
    for ((index, folded), ((block, bias), requantizers)) in places.zip(rows) {
        let (min, max) = match index {
            _ if index < starts => (-room, room),
            _ if index < phases => (0, GATE_ONE),
            _ => (i32::MIN, i32::MAX),
        };
        let sums = code_products(code_half, block, front, back, bias);
        let scaled = requantizers.iter().zip(sums).map(|(scale, sum)| scale.apply(sum));
        for (folded, scaled) in folded.iter_mut().zip(scaled) {
            // Not `clamp`, which panics where it cannot see that its bounds are in order.
            *folded = scaled.max(min).min(max);
        }
    }
    if model.manifest().has_gates() {
        gate_scales(model, buffers.folded.get_mut(starts..).unwrap_or_default());
    }
}

/// 1 in the format of gates, which stands for `manifest::GATE_MAX`.
const GATE_ONE: i32 = 1 << 16;

/// Turns the gates of a motion into the scales of its hidden layers. // (block of all hidden layers)
#[inline(never)]
fn gate_scales(model: &Model<'_>, gates: &mut [Sums]) {
    let mut gates = gates.iter_mut();
    let hidden = TIME_LAYER..model.manifest().layers.len().saturating_sub(1);
    for layer in hidden.filter_map(|index| model.layer(index)) {
        for (requantizers, gates) in layer.requantizers().zip(gates.by_ref()) {
            for (scale, gate) in requantizers.into_iter().zip(gates) {
                *gate = scale.gated(gate.cast_unsigned()).to_bits().cast_signed();
            }
        }
    }
}

/// 4-bit weights take 8-bit activations: the upper bytes of the code go to `upper`, the lower ones to `lower`.
fn store_code(layer: &Layer<'_>, code: &[i16], upper: &mut [Quad], lower: &mut [Quad]) {
    let quads = layer.shape.columns_filled() / 4;
    for index in 0..quads {
        let mut values = [0; 4];
        let given = code.get(4 * index..).unwrap_or_default();
        values.iter_mut().zip(given).for_each(|(place, &value)| *place = i32::from(value));
        if layer.order.is_nibbles() {
            let above = values.map(|value| (value + 128) >> 8);
            store(layer.order, upper, index, above);
            store(layer.order, lower, index, values.map(|value| i32::from(value as i8)));
        } else {
            store(layer.order, upper, index, values);
        }
    }
}

fn code_products(
    layer: &Layer<'_>,
    block: (&[u8], &[u8]),
    upper: &[Quad],
    lower: &[Quad],
    bias: Sums,
) -> Sums {
    let mut sums = bias;
    accumulate(layer, block, upper, &mut sums);
    if layer.order.is_nibbles() {
        let mut fraction = [0; 4];
        accumulate(layer, block, lower, &mut fraction);
        sums.iter_mut().zip(fraction).for_each(|(sum, lower)| *sum = sum.wrapping_add(lower >> 8));
    }
    sums
}

/// Decodes `FRAMES` poses.
pub(crate) fn decode<const FRAMES: usize>(
    model: &Model<'_>,
    buffers: &mut Buffers<'_, FRAMES>,
    positions: [FramePosition; FRAMES],
    poses: [&mut Pose; FRAMES],
    observe: &mut impl FnMut(Stage),
) {
    let (Some(time_half), Some(next)) = (&model.layer(TIME_LAYER), model.inputs(TIME_LAYER + 1))
    else {
        return;
    };
    let (mut front, mut back) = (&mut *buffers.front, &mut *buffers.back);
    let folded: &[u8] = bytemuck::must_cast_slice(buffers.folded);
    let mut gates = match model.manifest().has_gates() {
        true => folded.get(4 * model.manifest().gate_row()..).unwrap_or_default(),
        false => &[],
    };
    let products = match time_table_rows(model, positions) {
        Some(rows) => Products::Stored(rows, model.manifest().time_table_shift),
        None => {
            embed(model, time_half, phases_of(model, folded), positions, front);
            Products::Of(inputs_of(time_half, front))
        }
    };
    observe(Stage::TimeEmbedding);
    let mut index = TIME_LAYER;
    activate(&time_half.gated(&mut gates), folded, products, next, back);
    observe(Stage::Layer(index));
    while let Some(layer) = model.layer(index + 1) {
        index += 1;
        core::mem::swap(&mut front, &mut back);
        let input = inputs_of(&layer, front);
        let Some(next) = model.inputs(index + 1) else {
            write_poses(&layer, input, poses);
            break;
        };
        let layer = layer.gated(&mut gates);
        activate(&layer, layer.bias, Products::Of(input), next, back);
        observe(Stage::Layer(index));
    }
    observe(Stage::Output);
}

/// Hands the products of the time half, without any start, to `sink`: what a time table holds.
pub(crate) fn time_products(
    model: &Model<'_>,
    buffers: &mut Buffers<'_, 1>,
    position: FramePosition,
    mut sink: impl FnMut(Sums),
) {
    let Some(time_half) = &model.layer(TIME_LAYER) else {
        return;
    };
    embed(model, time_half, &[], [position], buffers.front);
    for block in time_half.blocks() {
        let mut sums = [[0; 4]];
        accumulate_frames(time_half, block, inputs_of(time_half, buffers.front), &mut sums);
        sums.into_iter().for_each(&mut sink);
    }
}

/// What is added to the starts of a layer's sums.
#[derive(Clone, Copy)]
enum Products<'a, const FRAMES: usize> {
    /// Weights times these.
    Of(&'a [[Quad; FRAMES]]),
    /// Rows of the time table, and their shift.
    Stored([&'a [u8]; FRAMES], u8),
}

/// `activations = ELU(products + starts)`, stored as `next` expects them.
///
/// # Shapes
/// `starts` i32, little-endian. // (out)
#[inline(never)]
fn activate<const FRAMES: usize>(
    layer: &Layer<'_>,
    starts: &[u8],
    products: Products<'_, FRAMES>,
    next: Inputs,
    output: &mut [[Quad; FRAMES]],
) {
    // Both of known length first: one counter serves them.
    let numbers = fours(starts).zip(layer.requantizers());
    for (index, (block, (start, requantizers))) in layer.blocks().zip(numbers).enumerate() {
        let mut sums = [start; FRAMES];
        match products {
            Products::Of(input) => accumulate_frames(layer, block, input, &mut sums),
            Products::Stored(rows, shift) => add_stored(rows, shift, index, &mut sums),
        }
        let activation = |sum, scale: Requantizer| layer.elu.apply(scale.apply_narrow(sum));
        let [scale_a, scale_b, scale_c, scale_d] = requantizers;
        // Written out, so that all four stay in registers.
        for (frame, &[a, b, c, d]) in sums.iter().enumerate() {
            let [a, b] = [activation(a, scale_a), activation(b, scale_b)];
            let [c, d] = [activation(c, scale_c), activation(d, scale_d)];
            store_frame(next.order, output, index, frame, [a, b, c, d]);
        }
    }
    fill(layer, next, output);
}

/// Adds the stored products of the block at `index`.
// Not inlined, and `fill` neither: their variables would push those of the loop around them out of registers.
#[inline(never)]
fn add_stored<const FRAMES: usize>(
    rows: [&[u8]; FRAMES],
    shift: u8,
    index: usize,
    sums: &mut [Sums; FRAMES],
) {
    for (row, sums) in rows.into_iter().zip(sums) {
        // Whole fours: a count of what is left would be computed for every block, with or without a table.
        let blocks = row.as_chunks::<2>().0.as_chunks::<BLOCK_ROWS>().0;
        let stored = blocks.get(index).copied().unwrap_or_default();
        for (sum, product) in sums.iter_mut().zip(stored.map(i16::from_le_bytes)) {
            *sum = sum.wrapping_add(i32::from(product) << (shift & 15));
        }
    }
}

/// Activations that only fill the next layer's last tile are real zeros.
#[inline(never)]
fn fill<const FRAMES: usize>(layer: &Layer<'_>, next: Inputs, output: &mut [[Quad; FRAMES]]) {
    for index in layer.shape.rows_filled() / 4..next.quads {
        for frame in 0..FRAMES {
            store_frame(next.order, output, index, frame, [layer.elu.zero_point(); 4]);
        }
    }
}

/// `channels = weights · input + bias`, in channel units, Q15.16.
fn write_poses<const FRAMES: usize>(
    layer: &Layer<'_>,
    input: &[[Quad; FRAMES]],
    mut poses: [&mut Pose; FRAMES],
) {
    poses.iter_mut().for_each(|pose| pose.channels.clear());
    let channel_count = usize::from(layer.shape.output_count);
    let blocks = layer.blocks().zip(layer.biases()).zip(layer.requantizers());
    for ((block, bias), requantizers) in blocks {
        let mut sums = [bias; FRAMES];
        accumulate_frames(layer, block, input, &mut sums);
        for (pose, sums) in poses.iter_mut().zip(sums) {
            let room = channel_count - pose.channels.len().min(channel_count);
            for (sum, scale) in sums.into_iter().zip(&requantizers).take(room) {
                // The loader has checked that all channels fit.
                let _ = pose.channels.push(scale.apply(sum));
            }
        }
    }
}

/// The sinusoids of every frame, stored as the time half expects them.
fn embed<const FRAMES: usize>(
    model: &Model<'_>,
    time_half: &Layer<'_>,
    phases: &[u8],
    positions: [FramePosition; FRAMES],
    output: &mut [[Quad; FRAMES]],
) {
    let format = model.number_format();
    let quads = time_half.shape.columns_filled() / 4;
    for (frame, position) in positions.into_iter().enumerate() {
        let mut steps = u32s(model.frequencies);
        let mut phases = u32s(phases);
        for index in 0..quads {
            let mut pair = || {
                // Turns in Q16: the whole ones fall off.
                let phase = phases.next().unwrap_or(0) << 16;
                let turned = |step| turned_sinusoids(format, position, step, phase);
                steps.next().map_or([0; 2], turned)
            };
            let ([sine_a, cosine_a], [sine_b, cosine_b]) = (pair(), pair());
            let values = [sine_a, cosine_a, sine_b, cosine_b];
            store_frame(time_half.order, output, index, frame, values);
        }
    }
}

/// Phases of the motion that was started, i32; none where the model has none.
fn phases_of<'b>(model: &Model<'_>, folded: &'b [u8]) -> &'b [u8] {
    match model.manifest().has_phases() {
        true => folded.get(4 * model.manifest().phase_row()..).unwrap_or_default(),
        false => &[],
    }
}

/// The time table's rows, where every position has one.
fn time_table_rows<'a, const FRAMES: usize>(
    model: &Model<'a>,
    positions: [FramePosition; FRAMES],
) -> Option<[&'a [u8]; FRAMES]> {
    let mut rows = [&[][..]; FRAMES];
    for (row, position) in rows.iter_mut().zip(positions) {
        *row = model.time_table_row(position)?;
    }
    Some(rows)
}

/// The quads that a layer reads; `Decoder::new` has checked that the buffer is wide enough.
fn inputs_of<'b, const FRAMES: usize>(
    layer: &Layer<'_>,
    buffer: &'b [[Quad; FRAMES]],
) -> &'b [[Quad; FRAMES]] {
    buffer.get(..layer.shape.columns_filled() / 4).unwrap_or_default()
}

fn accumulate_frames<const FRAMES: usize>(
    layer: &Layer<'_>,
    block: (&[u8], &[u8]),
    input: &[[Quad; FRAMES]],
    sums: &mut [Sums; FRAMES],
) {
    if let Ok(pair) = <&mut [Sums; 2]>::try_from(&mut sums[..]) {
        let input = bytemuck::try_cast_slice(input.as_flattened()).unwrap_or_default();
        match layer.order {
            Order::Halfwords => kernel::w8a8_pair(block.0, input, pair),
            _ => kernel::w8a16_pair(block.0, input, pair),
        }
    } else if let [sums] = &mut sums[..] {
        accumulate(layer, block, input.as_flattened(), sums);
    }
}

// Once, not inlined at four places: the kernels' code is most of the decoder's size.
#[inline(never)]
fn accumulate(layer: &Layer<'_>, block: (&[u8], &[u8]), input: &[Quad], sums: &mut Sums) {
    let (weights, group_scales) = block;
    match layer.order {
        Order::Bytes => kernel::w8a16(weights, input, sums),
        #[cfg(any(feature = "w8a8", feature = "w4a8"))]
        Order::Halfwords => kernel::w8a8(weights, input, sums),
        #[cfg(feature = "w4a8")]
        Order::Nibbles => kernel::w4a8(weights, group_scales, input, sums),
        #[cfg(karakuri_rows)]
        Order::WideRows => kernel::rows::w8a16(weights, numbers(input), sums),
        #[cfg(karakuri_rows)]
        Order::ByteRows => kernel::rows::w8a8(weights, numbers(input), sums),
        // The loader has refused what is not built.
        _ => {
            let _ = group_scales;
        }
    }
}

/// Activations that lie one after another; whole words divide into bytes and halfwords.
#[cfg(karakuri_rows)]
fn numbers<Number: bytemuck::Pod>(quads: &[Quad]) -> &[Number] {
    bytemuck::try_cast_slice(quads).unwrap_or_default()
}

fn store_frame<const FRAMES: usize>(
    order: Order,
    output: &mut [[Quad; FRAMES]],
    index: usize,
    frame: usize,
    values: [i32; 4],
) {
    store(order, output.as_flattened_mut(), index * FRAMES + frame, values);
}

/// Four activations into the quad, or the word, of their index.
#[inline]
fn store(order: Order, quads: &mut [Quad], index: usize, values: [i32; 4]) {
    let pack = |low: i32, high: i32| (low as u16 as u32) | (high as u32) << 16;
    let [a, b, c, d] = values;
    let quad = match order {
        Order::Halfwords => [pack(256 * a - b, 256 * c - d), pack(b, d)],
        #[cfg(karakuri_rows)]
        Order::WideRows => [pack(a, b), pack(c, d)],
        #[cfg(karakuri_rows)]
        Order::ByteRows => {
            let bytes = values.map(|value| value as u8);
            if let Some(word) = quads.as_flattened_mut().get_mut(index) {
                *word = u32::from_le_bytes(bytes);
            }
            return;
        }
        _ => [pack(a, c), pack(b, d)],
    };
    if let Some(place) = quads.get_mut(index) {
        *place = quad;
    }
}
