//! Station 9: code + time → pose. The paper's equation, pose(t) = D(β, α, τ(t)).
//!
//! In:  [`Model`], [`Code`], [`FramePosition`].
//! Out: [`Pose`], in channel units.
//!
//! Why here: layer 1 is split. Its code half is constant over a motion and computed once by [`Decoder::start`], which
//! saves 18 % of the work per pose at the paper's size.
//! Source: Cervantes et al., ECCV 2022, section 3; the quantiser has folded standardisation into the last layer.

use crate::arithmetic::Arithmetic;
use crate::code::Code;
use crate::error::BlobError;
#[cfg(feature = "f16")]
use crate::half_float::Half;
use crate::integer::Integer;
use crate::layer::Layer;
use crate::manifest::NumberFormat;
use crate::model::Model;
use crate::pose::Pose;
use crate::time_embedding::{FramePosition, embed};
use crate::workspace::{Buffers, Workspace};

/// A part of decoding a pose that is done; for measurements only.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The sinusoids.
    TimeEmbedding,
    /// A layer with an activation, counted from 1; the time half of layer 1 is layer 1.
    Layer(u8),
    /// The last layer.
    Output,
}

/// A model with a workspace: decodes one motion at a time, any frame in any order.
#[derive(Debug)]
pub struct Decoder<'m, 'w> {
    model: &'m Model<'m>,
    engine: Engine<'w>,
}

#[derive(Debug)]
enum Engine<'w> {
    Integer(Integer, Buffers<'w, i32, i16>),
    #[cfg(feature = "f16")]
    Half(Half, Buffers<'w, f32, f32>),
}

impl<'m, 'w> Decoder<'m, 'w> {
    /// Binds a model to a workspace. Call [`start`](Self::start) before decoding.
    ///
    /// # Errors
    /// * [`BlobError::WorkspaceTooSmall`]: `WIDTH` is less than `Model::workspace_width`.
    /// * [`BlobError::FormatNotBuilt`]: an `f16` model in a build without the feature `f16`.
    pub fn new<const WIDTH: usize>(
        model: &'m Model<'m>,
        workspace: &'w mut Workspace<WIDTH>,
    ) -> Result<Self, BlobError> {
        let needed = model.workspace_width();
        if WIDTH < needed {
            return Err(BlobError::WorkspaceTooSmall { width: WIDTH, needed });
        }
        let engine = match model.number_format() {
            format @ (NumberFormat::W8A16 | NumberFormat::W8A8) => {
                Engine::Integer(Integer(format), workspace.integer())
            }
            #[cfg(feature = "f16")]
            NumberFormat::F16 => {
                let code_unit = 1.0 / (1u32 << model.manifest().code_fraction_bits) as f32;
                Engine::Half(Half { code_unit }, workspace.half())
            }
            #[cfg(not(feature = "f16"))]
            NumberFormat::F16 => return Err(BlobError::FormatNotBuilt(NumberFormat::F16)),
        };
        Ok(Self { model, engine })
    }

    /// Begins a motion: computes the code half of layer 1.
    ///
    /// # Cost
    /// `Model::multiply_accumulates_per_motion`, once.
    pub fn start(&mut self, code: &Code) {
        match &mut self.engine {
            Engine::Integer(arithmetic, buffers) => fold(self.model, arithmetic, buffers, code),
            #[cfg(feature = "f16")]
            Engine::Half(arithmetic, buffers) => fold(self.model, arithmetic, buffers, code),
        }
    }

    /// Decodes one pose of the motion that was started.
    ///
    /// # Units and formats
    /// `position`: frames, Q16.16 · `pose`: channel units, Q15.16
    ///
    /// # Cost
    /// `Model::multiply_accumulates_per_pose`.
    pub fn decode(&mut self, position: FramePosition, pose: &mut Pose) {
        self.decode_observed(position, pose, &mut |_| ());
    }

    /// [`decode`](Self::decode), and a call after every stage.
    #[doc(hidden)]
    pub fn decode_observed(
        &mut self,
        position: FramePosition,
        pose: &mut Pose,
        observe: &mut impl FnMut(Stage),
    ) {
        match &mut self.engine {
            Engine::Integer(arithmetic, buffers) => {
                decode(self.model, arithmetic, buffers, position, pose, observe)
            }
            #[cfg(feature = "f16")]
            Engine::Half(arithmetic, buffers) => {
                decode(self.model, arithmetic, buffers, position, pose, observe)
            }
        }
    }
}

fn fold<A: Arithmetic>(
    model: &Model<'_>,
    arithmetic: &A,
    buffers: &mut Buffers<'_, A::Sum, A::Value>,
    code: &Code,
) {
    if let [code_half, time_half, ..] = model.layers.as_slice() {
        arithmetic.fold(code_half, time_half, &code.values, buffers.folded);
    }
}

fn decode<A: Arithmetic>(
    model: &Model<'_>,
    arithmetic: &A,
    buffers: &mut Buffers<'_, A::Sum, A::Value>,
    position: FramePosition,
    pose: &mut Pose,
    observe: &mut impl FnMut(Stage),
) {
    let [_, time_half, hidden @ .., last] = model.layers.as_slice() else {
        return;
    };
    let (mut front, mut back) = (&mut *buffers.front, &mut *buffers.back);
    embed(position, model.frequencies, front, |q15| arithmetic.sinusoid(q15));
    observe(Stage::TimeEmbedding);
    arithmetic.time_half(time_half, inputs_of(time_half, front), buffers.folded, back);
    observe(Stage::Layer(1));
    for (layer, number) in hidden.iter().zip(2..) {
        core::mem::swap(&mut front, &mut back);
        arithmetic.hidden(layer, inputs_of(layer, front), back);
        observe(Stage::Layer(number));
    }
    pose.channels.clear();
    arithmetic.output(last, inputs_of(last, back), |channel| {
        // The loader has checked that all channels fit.
        let _ = pose.channels.push(channel);
    });
    observe(Stage::Output);
}

/// The part of a buffer that a layer reads; `Decoder::new` has checked that the buffer is wide enough.
fn inputs_of<'b, Value>(layer: &Layer<'_>, buffer: &'b [Value]) -> &'b [Value] {
    buffer.get(..layer.input_count()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::SamplerKind;
    use crate::random::Pcg32;
    use crate::specimen::specimen;
    use crate::{ActionId, NumberFormat};

    fn first_pose(format: NumberFormat, position: FramePosition) -> Pose {
        let blob = specimen(format, SamplerKind::ClipCodes);
        let model = Model::from_bytes(&blob).unwrap();
        let mut workspace = Workspace::<8>::new();
        let mut decoder = Decoder::new(&model, &mut workspace).unwrap();
        let mut random = Pcg32::new(5);
        decoder.start(&model.sample(ActionId(1), 44, &mut || random.next_u32()).unwrap());
        let mut pose = Pose::new();
        decoder.decode(position, &mut pose);
        pose
    }

    #[test]
    fn workspace_that_is_too_narrow_is_rejected() {
        let blob = specimen(NumberFormat::W8A8, SamplerKind::ClipCodes);
        let model = Model::from_bytes(&blob).unwrap();
        let error = Decoder::new(&model, &mut Workspace::<7>::new()).unwrap_err();
        assert_eq!(error, BlobError::WorkspaceTooSmall { width: 7, needed: 8 });
    }

    #[test]
    fn integer_poses_never_change() {
        let w8a16 = first_pose(NumberFormat::W8A16, FramePosition::from_bits(98_765));
        let w8a8 = first_pose(NumberFormat::W8A8, FramePosition::from_bits(98_765));
        assert_eq!(w8a16.channels(), W8A16_POSE);
        assert_eq!(w8a8.channels(), W8A8_POSE);
    }

    // Printed by the test above when the format was first made; a change here is a change of every device's motion.
    const W8A16_POSE: [i32; 4] = [-7170, -13531, -26812, -1079];
    const W8A8_POSE: [i32; 4] = [9217, -7765, -354, -1740];

    #[test]
    fn pose_depends_on_time_and_has_every_channel() {
        for format in NumberFormat::ALL {
            #[cfg(not(feature = "f16"))]
            if format == NumberFormat::F16 {
                continue;
            }
            let (early, late) = (
                first_pose(format, FramePosition::default()),
                first_pose(format, FramePosition::from_frames(9)),
            );
            assert_eq!(early.channels().len(), 4);
            assert_ne!(early, late, "{}", format.name());
        }
    }

    #[cfg(not(feature = "f16"))]
    #[test]
    fn f16_model_is_rejected_by_name_without_the_feature() {
        let blob = specimen(NumberFormat::F16, SamplerKind::ClipCodes);
        let model = Model::from_bytes(&blob).unwrap();
        let error = Decoder::new(&model, &mut Workspace::<8>::new()).unwrap_err();
        assert_eq!(error, BlobError::FormatNotBuilt(NumberFormat::F16));
    }
}
