//! One motion to decode on both sides, and the positions at which to look at it.
//!
//! In:  `choose_cases` on the host makes the list; `build.rs` puts its bytes into the program.
//! Out: poses, by one and the same loop on host and device.
//!
//! Why here: the only file that both sides compile (the firmware takes it with `#[path]`, since a bare-metal program
//! cannot depend on a package that needs the standard library), so neither format nor loop can differ.

use karakuri::{ActionId, Decoder, FramePosition, Model, Pcg32, Pose, SampleError};

/// A motion and a row of evenly spaced positions in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Case {
    /// Index of the action.
    pub action: u16,
    /// Number of positions.
    pub pose_count: u16,
    /// Length of the motion in frames.
    pub frames: u32,
    /// Seed of the code.
    pub seed: u64,
    /// First position, Q16.16 frames.
    pub first_bits: u32,
    /// Distance of positions, Q16.16 frames.
    pub step_bits: u32,
}

impl Case {
    /// Bytes of a stored case: the fields in the order above, little-endian.
    pub const BYTES: usize = 24;

    /// The positions, first to last.
    pub fn positions(&self) -> impl Iterator<Item = FramePosition> {
        let Self { first_bits, step_bits, .. } = *self;
        (0..u32::from(self.pose_count)).map(move |index| {
            FramePosition::from_bits(first_bits.wrapping_add(index.wrapping_mul(step_bits)))
        })
    }

    /// Samples the code, folds it, and hands every pose to `on_pose`.
    ///
    /// # Errors
    /// [`SampleError`] for an action or a length that the model does not know; nothing has been decoded then.
    pub fn decode(
        &self,
        model: &Model<'_>,
        decoder: &mut Decoder<'_, '_>,
        mut on_pose: impl FnMut(&Pose),
    ) -> Result<(), SampleError> {
        let mut rng = Pcg32::new(self.seed);
        let code = model.sample(ActionId(self.action), self.frames, &mut || rng.next_u32())?;
        decoder.start(&code);
        let mut pose = Pose::new();
        for position in self.positions() {
            decoder.decode(position, &mut pose);
            on_pose(&pose);
        }
        Ok(())
    }

    /// The stored form.
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[0..2].copy_from_slice(&self.action.to_le_bytes());
        bytes[2..4].copy_from_slice(&self.pose_count.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.frames.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.seed.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.first_bits.to_le_bytes());
        bytes[20..24].copy_from_slice(&self.step_bits.to_le_bytes());
        bytes
    }

    /// Reads the stored form back.
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let word = |start: usize| {
            u32::from_le_bytes([bytes[start], bytes[start + 1], bytes[start + 2], bytes[start + 3]])
        };
        Self {
            action: word(0) as u16,
            pose_count: (word(0) >> 16) as u16,
            frames: word(4),
            seed: u64::from(word(8)) | u64::from(word(12)) << 32,
            first_bits: word(16),
            step_bits: word(20),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Case;

    #[test]
    fn stored_case_is_read_back() {
        let case = Case {
            action: 0x0102,
            pose_count: 0x0304,
            frames: 0x0506_0708,
            seed: 0x090a_0b0c_0d0e_0f10,
            first_bits: 0x1112_1314,
            step_bits: 0x1516_1718,
        };
        assert_eq!(Case::from_bytes(&case.to_bytes()), case);
    }
}
