//! What decoding writes to: buffers that the caller owns and every motion reuses.

use crate::kernel::Quad;
use crate::layer::Sums;

/// Buffers for models up to `WIDTH` wide (`Model::workspace_width`, a multiple of 4): 8 bytes a unit of width, and 12
/// more with `f16`.
#[derive(Clone, Debug)]
pub struct Workspace<const WIDTH: usize> {
    folded: [i32; WIDTH],
    front: Halfwords<WIDTH, 1>,
    back: Halfwords<WIDTH, 1>,
    #[cfg(feature = "f16")]
    half: [[f32; WIDTH]; 3],
}

/// Buffers for a [`PairDecoder`](crate::PairDecoder): 12 bytes a unit of width.
#[derive(Clone, Debug)]
pub struct PairWorkspace<const WIDTH: usize> {
    folded: [i32; WIDTH],
    front: Halfwords<WIDTH, 2>,
    back: Halfwords<WIDTH, 2>,
}

/// Activations of `FRAMES` frames, aligned for loads of whole words.
#[derive(Clone, Debug)]
#[repr(C, align(4))]
struct Halfwords<const WIDTH: usize, const FRAMES: usize>([[i16; WIDTH]; FRAMES]);

impl<const WIDTH: usize, const FRAMES: usize> Halfwords<WIDTH, FRAMES> {
    const ZERO: Self = Self([[0; WIDTH]; FRAMES]);

    /// Quads of all frames, as many as fit.
    fn quads(&mut self) -> &mut [[Quad; FRAMES]] {
        let halfwords = self.0.as_flattened_mut();
        let whole = halfwords.len() - halfwords.len() % (4 * FRAMES);
        let whole = halfwords.get_mut(..whole).unwrap_or_default();
        bytemuck::try_cast_slice_mut(whole).unwrap_or_default()
    }
}

/// Folded code half of layer 1, and two activation buffers that take turns.
#[derive(Debug)]
pub(crate) struct Buffers<'w, const FRAMES: usize> {
    pub folded: &'w mut [Sums],
    pub front: &'w mut [[Quad; FRAMES]],
    pub back: &'w mut [[Quad; FRAMES]],
}

/// The same for `f16`, a number each.
#[cfg(feature = "f16")]
#[derive(Debug)]
pub(crate) struct FloatBuffers<'w> {
    pub folded: &'w mut [f32],
    pub front: &'w mut [f32],
    pub back: &'w mut [f32],
}

fn fours<const WIDTH: usize>(numbers: &mut [i32; WIDTH]) -> &mut [Sums] {
    let whole = numbers.get_mut(..WIDTH - WIDTH % 4).unwrap_or_default();
    bytemuck::try_cast_slice_mut(whole).unwrap_or_default()
}

impl<const WIDTH: usize> Workspace<WIDTH> {
    /// All zeros; `const`, so that it can be a `static`.
    pub const fn new() -> Self {
        Self {
            folded: [0; WIDTH],
            front: Halfwords::ZERO,
            back: Halfwords::ZERO,
            #[cfg(feature = "f16")]
            half: [[0.0; WIDTH]; 3],
        }
    }

    pub(crate) fn integer(&mut self) -> Buffers<'_, 1> {
        Buffers {
            folded: fours(&mut self.folded),
            front: self.front.quads(),
            back: self.back.quads(),
        }
    }

    #[cfg(feature = "f16")]
    pub(crate) fn half(&mut self) -> FloatBuffers<'_> {
        let [folded, front, back] = &mut self.half;
        FloatBuffers { folded, front, back }
    }
}

impl<const WIDTH: usize> PairWorkspace<WIDTH> {
    /// All zeros; `const`, so that it can be a `static`.
    pub const fn new() -> Self {
        Self { folded: [0; WIDTH], front: Halfwords::ZERO, back: Halfwords::ZERO }
    }

    pub(crate) fn buffers(&mut self) -> Buffers<'_, 2> {
        Buffers {
            folded: fours(&mut self.folded),
            front: self.front.quads(),
            back: self.back.quads(),
        }
    }
}

impl<const WIDTH: usize> Default for Workspace<WIDTH> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const WIDTH: usize> Default for PairWorkspace<WIDTH> {
    fn default() -> Self {
        Self::new()
    }
}
