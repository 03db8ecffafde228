//! What decoding writes to: buffers that the caller owns and every motion reuses.

/// Buffers for models up to `WIDTH` wide (`Model::workspace_width`): 8 bytes a unit of width, and 12 more with `f16`.
#[derive(Clone, Debug)]
pub struct Workspace<const WIDTH: usize> {
    integer: Scratch<i32, i16, WIDTH>,
    #[cfg(feature = "f16")]
    half: Scratch<f32, f32, WIDTH>,
}

/// Folded code half of layer 1, and two activation buffers that take turns.
#[derive(Clone, Debug)]
struct Scratch<Sum, Value, const WIDTH: usize> {
    folded: [Sum; WIDTH],
    front: [Value; WIDTH],
    back: [Value; WIDTH],
}

/// [`Workspace`] with its width forgotten.
#[derive(Debug)]
pub(crate) struct Buffers<'w, Sum, Value> {
    pub folded: &'w mut [Sum],
    pub front: &'w mut [Value],
    pub back: &'w mut [Value],
}

impl<Sum, Value, const WIDTH: usize> Scratch<Sum, Value, WIDTH> {
    fn buffers(&mut self) -> Buffers<'_, Sum, Value> {
        Buffers { folded: &mut self.folded, front: &mut self.front, back: &mut self.back }
    }
}

impl<const WIDTH: usize> Workspace<WIDTH> {
    /// All zeros; `const`, so that it can be a `static`.
    pub const fn new() -> Self {
        Self {
            integer: Scratch { folded: [0; WIDTH], front: [0; WIDTH], back: [0; WIDTH] },
            #[cfg(feature = "f16")]
            half: Scratch { folded: [0.0; WIDTH], front: [0.0; WIDTH], back: [0.0; WIDTH] },
        }
    }

    pub(crate) fn integer(&mut self) -> Buffers<'_, i32, i16> {
        self.integer.buffers()
    }

    #[cfg(feature = "f16")]
    pub(crate) fn half(&mut self) -> Buffers<'_, f32, f32> {
        self.half.buffers()
    }
}

impl<const WIDTH: usize> Default for Workspace<WIDTH> {
    fn default() -> Self {
        Self::new()
    }
}
