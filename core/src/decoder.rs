//! Station 9: code + time → pose. The paper's equation, pose(t) = D(β, α, τ(t)).
//!
//! In:  [`Model`], [`Code`], [`FramePosition`].
//! Out: [`Pose`], in channel units.
//!
//! Why here: layer 1 is split. Its code half is constant over a motion and computed once by [`Decoder::start`], which
//! saves 18 % of the work per pose at the paper's size.
//! Source: Cervantes et al., ECCV 2022, section 3; the quantiser has folded standardisation into the last layer.

use crate::code::Code;
use crate::error::BlobError;
#[cfg(feature = "f16")]
use crate::half_float;
use crate::integer;
use crate::manifest::NumberFormat;
use crate::model::Model;
use crate::pose::Pose;
use crate::time_embedding::FramePosition;
#[cfg(feature = "f16")]
use crate::workspace::FloatBuffers;
use crate::workspace::{Buffers, Workspace};

/// What [`Decoder::decode_observed`] has just finished.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The sinusoids of the time embedding, or the look into the time table.
    TimeEmbedding,
    /// A layer with an ELU, by its index in the manifest.
    Layer(usize),
    /// The pose.
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
    Integer(Buffers<'w, 1>),
    #[cfg(feature = "f16")]
    Half(FloatBuffers<'w>),
}

impl<'m, 'w> Decoder<'m, 'w> {
    /// Binds a model to a workspace. Call [`start`](Self::start) before decoding.
    ///
    /// # Errors
    /// [`BlobError::WorkspaceTooSmall`]: `WIDTH` is less than `Model::workspace_width`.
    pub fn new<const WIDTH: usize>(
        model: &'m Model<'m>,
        workspace: &'w mut Workspace<WIDTH>,
    ) -> Result<Self, BlobError> {
        model.check_width(WIDTH)?;
        let engine = match model.number_format() {
            #[cfg(feature = "f16")]
            NumberFormat::F16 => Engine::Half(workspace.half()),
            #[cfg(not(feature = "f16"))]
            NumberFormat::F16 => return Err(BlobError::FormatNotBuilt(NumberFormat::F16)),
            _ => Engine::Integer(workspace.integer()),
        };
        Ok(Self { model, engine })
    }

    /// Begins a motion: computes the code half of layer 1.
    ///
    /// # Cost
    /// `Model::multiply_accumulates_per_motion`, once (twice that where the code half has 4-bit weights).
    pub fn start(&mut self, code: &Code) {
        match &mut self.engine {
            Engine::Integer(buffers) => integer::fold(self.model, buffers, code),
            #[cfg(feature = "f16")]
            Engine::Half(buffers) => half_float::fold(self.model, buffers, code),
        }
    }

    /// Decodes one pose of the motion that was started.
    ///
    /// # Units and formats
    /// `position`: frames, Q16.16 · `pose`: channel units, Q15.16
    ///
    /// # Cost
    /// `Model::multiply_accumulates_per_pose`; at a whole frame of the blob's time table without those of the time
    /// half.
    pub fn decode(&mut self, position: FramePosition, pose: &mut Pose) {
        self.decode_observed(position, pose, &mut |_| ());
    }

    /// Hands the products of the time half at a position to `sink`, four rows at a time, in accumulator units: what the
    /// quantiser stores in a time table. Nothing for `f16`, which has none.
    pub fn time_products(&mut self, position: FramePosition, sink: impl FnMut([i32; 4])) {
        match &mut self.engine {
            Engine::Integer(buffers) => {
                integer::time_products(self.model, buffers, position, sink);
            }
            #[cfg(feature = "f16")]
            Engine::Half(_) => {}
        }
    }

    /// [`decode`](Self::decode) for benchmarks: tells how far it is.
    #[doc(hidden)]
    pub fn decode_observed(
        &mut self,
        position: FramePosition,
        pose: &mut Pose,
        observe: &mut impl FnMut(Stage),
    ) {
        match &mut self.engine {
            Engine::Integer(buffers) => {
                integer::decode(self.model, buffers, [position], [pose], observe);
            }
            #[cfg(feature = "f16")]
            Engine::Half(buffers) => {
                half_float::decode(self.model, buffers, position, pose, observe);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;
    use crate::manifest::{Packing, SamplerKind};
    use crate::random::Pcg32;
    use crate::specimen::{
        GATED_ROWS, TURNED_ROWS, specimen, specimen_modulated, specimen_packed,
        specimen_with_table_and_phases, specimen_with_time_table,
    };
    use crate::{ActionId, NumberFormat, PairDecoder, PairWorkspace};

    fn code_of(model: &Model<'_>) -> Code {
        let mut random = Pcg32::new(5);
        model.sample(ActionId(1), 44, &mut || random.next_u32()).unwrap()
    }

    fn pose_of(blob: &[u8], position: FramePosition) -> Pose {
        pose_of_width::<16>(blob, position)
    }

    fn pose_of_width<const WIDTH: usize>(blob: &[u8], position: FramePosition) -> Pose {
        let model = Model::from_bytes(blob).unwrap();
        let mut workspace = Workspace::<WIDTH>::new();
        let mut decoder = Decoder::new(&model, &mut workspace).unwrap();
        decoder.start(&code_of(&model));
        let mut pose = Pose::new();
        decoder.decode(position, &mut pose);
        pose
    }

    fn first_pose(format: NumberFormat, position: FramePosition) -> Pose {
        pose_of(&specimen(format, SamplerKind::ClipCodes), position)
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
        let w4a8 = first_pose(NumberFormat::W4A8, FramePosition::from_bits(98_765));
        assert_eq!(w8a16.channels(), W8A16_POSE);
        assert_eq!(w8a8.channels(), W8A8_POSE);
        assert_eq!(w4a8.channels(), W4A8_POSE);
    }

    // Printed by the test above when the format was first made; a change here is a change of every device's motion.
    const W8A16_POSE: [i32; 4] = [11742, 136505, -149917, -39754];
    const W8A8_POSE: [i32; 4] = [1655508, 2152893, 1137352, -2297604];
    const W4A8_POSE: [i32; 4] = [69009, -710376, 314580, 322613];

    #[test]
    fn every_packing_gives_the_same_pose() {
        for format in [NumberFormat::W8A16, NumberFormat::W8A8] {
            let poses = [Packing::Tiles, Packing::Rows].map(|packing| {
                let blob = specimen_packed(format, SamplerKind::ClipCodes, packing);
                pose_of(&blob, FramePosition::from_bits(98_765))
            });
            assert_eq!(poses[0], poses[1], "{}", format.name());
        }
    }

    #[test]
    fn pair_gives_the_poses_of_two_single_decodings() {
        let positions = [98_765, 3 << 16].map(FramePosition::from_bits);
        for format in [NumberFormat::W8A16, NumberFormat::W8A8] {
            let blob = specimen(format, SamplerKind::ClipCodes);
            let model = Model::from_bytes(&blob).unwrap();
            let mut workspace = PairWorkspace::<8>::new();
            let mut decoder = PairDecoder::new(&model, &mut workspace).unwrap();
            decoder.start(&code_of(&model));
            let mut poses = [Pose::new(), Pose::new()];
            decoder.decode(positions, &mut poses);
            assert_eq!(poses, positions.map(|position| pose_of(&blob, position)));
        }
    }

    #[test]
    fn code_half_with_rows_that_are_neither_gates_nor_phases_is_rejected() {
        for format in NumberFormat::ALL.into_iter().filter(|format| format.is_built()) {
            for rows in 1..40 {
                let blob = specimen_modulated(format, rows);
                let expected = [6, GATED_ROWS, TURNED_ROWS].contains(&rows);
                let error = BlobError::BadField { field: "shape of layer", value: 0 };
                let found = Model::from_bytes(&blob).map(|_| ());
                assert_eq!(found, if expected { Ok(()) } else { Err(error) }, "{rows}");
            }
        }
    }

    #[test]
    fn modulated_poses_never_change() {
        let position = FramePosition::from_bits(98_765);
        let poses = [NumberFormat::W8A16, NumberFormat::W8A8, NumberFormat::W4A8].map(|format| {
            [GATED_ROWS, TURNED_ROWS]
                .map(|rows| pose_of_width::<32>(&specimen_modulated(format, rows), position))
        });
        let channels = poses.each_ref().map(|pair| pair.each_ref().map(|pose| pose.channels()));
        assert_eq!(
            channels,
            MODULATED_POSES.each_ref().map(|pair| pair.each_ref().map(|p| &p[..]))
        );
    }

    // As above: printed when gates and phases were first made. // (w8a16, w8a8, w4a8)(gates, gates and phases)
    const MODULATED_POSES: [[[i32; 4]; 2]; 3] = [
        [[41098, -30722, 12789, -24472], [-33085, 15609, -18344, 18883]],
        [[835618, -747193, -270722, 236843], [-299593, 1375414, 888632, -397442]],
        [[93312, -3543, 356154, -853423], [225566, 5076, 1005694, -1678423]],
    ];

    #[test]
    fn pair_of_modulated_poses_are_those_of_two_single_decodings() {
        let positions = [98_765, 3 << 16].map(FramePosition::from_bits);
        for format in [NumberFormat::W8A16, NumberFormat::W8A8] {
            let blob = specimen_modulated(format, TURNED_ROWS);
            let model = Model::from_bytes(&blob).unwrap();
            let mut workspace = PairWorkspace::<28>::new();
            let mut decoder = PairDecoder::new(&model, &mut workspace).unwrap();
            decoder.start(&code_of(&model));
            let mut poses = [Pose::new(), Pose::new()];
            decoder.decode(positions, &mut poses);
            assert_eq!(poses, positions.map(|position| pose_of_width::<28>(&blob, position)));
        }
    }

    #[test]
    fn workspace_must_hold_the_gates_too() {
        let blob = specimen_modulated(NumberFormat::W8A16, GATED_ROWS);
        let model = Model::from_bytes(&blob).unwrap();
        let error = Decoder::new(&model, &mut Workspace::<23>::new()).unwrap_err();
        assert_eq!(error, BlobError::WorkspaceTooSmall { width: 23, needed: 24 });
    }

    #[test]
    fn time_table_of_a_model_with_phases_is_rejected() {
        let rows = [std::vec![1; 8]];
        let blob = specimen_with_table_and_phases(&rows);
        let error = Model::from_bytes(&blob).unwrap_err();
        let field = "time table of a model with phases";
        assert_eq!(error, BlobError::BadField { field, value: 1 });
    }

    #[test]
    fn pair_of_a_model_without_pair_kernels_is_rejected() {
        let blobs = [
            specimen(NumberFormat::W4A8, SamplerKind::ClipCodes),
            specimen_packed(NumberFormat::W8A8, SamplerKind::ClipCodes, Packing::Rows),
        ];
        for blob in blobs {
            let model = Model::from_bytes(&blob).unwrap();
            let error = PairDecoder::new(&model, &mut PairWorkspace::<16>::new()).unwrap_err();
            assert_eq!(error, BlobError::NoPairKernel(model.number_format()));
        }
    }

    #[test]
    fn time_table_gives_the_same_pose_at_whole_frames() {
        for format in [NumberFormat::W8A16, NumberFormat::W8A8, NumberFormat::W4A8] {
            let blob = specimen(format, SamplerKind::ClipCodes);
            // Products of the specimen need more than 16 bits; a coarse table costs a few units of the last place.
            let shift = 11;
            let rows: Vec<Vec<i16>> = (0..3).map(|frame| table_row(&blob, frame, shift)).collect();
            let with_table = specimen_with_time_table(format, &rows, shift);
            for position in [0, 2 << 16, 98_765, 3 << 16].map(FramePosition::from_bits) {
                let (computed, looked_up) =
                    (pose_of(&blob, position), pose_of(&with_table, position));
                for (a, b) in computed.channels().iter().zip(looked_up.channels()) {
                    assert!((a - b).abs() <= 400, "{} {position:?} {a} {b}", format.name());
                }
            }
        }
    }

    #[test]
    fn time_table_beyond_the_certificate_is_rejected() {
        let rows = [std::vec![i16::MAX; 8]];
        let blob = specimen_with_time_table(NumberFormat::W4A8, &rows, 15);
        let error = Model::from_bytes(&blob).unwrap_err();
        assert_eq!(error, BlobError::BadField { field: "time table", value: 0 });
    }

    fn table_row(blob: &[u8], frame: u32, shift: u8) -> Vec<i16> {
        let model = Model::from_bytes(blob).unwrap();
        let mut workspace = Workspace::<16>::new();
        let mut decoder = Decoder::new(&model, &mut workspace).unwrap();
        let mut row = Vec::new();
        decoder.time_products(FramePosition::from_frames(frame), |products| {
            row.extend(products.map(|product| i16::try_from(product >> shift).unwrap()));
        });
        row
    }

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
}
