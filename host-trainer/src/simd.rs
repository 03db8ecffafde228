//! Loops over slices at the width of the processor that runs them.
//!
//! Why here: programs are compiled for the oldest processor of their kind, where a register holds four f32. `pulp`
//! compiles a loop once per instruction set and picks one at run time. The results are the same bits on all of them:
//! the compiler neither reorders sums nor fuses multiplications.

use pulp::{Arch, Simd, WithSimd};

/// Runs a closure that loops over slices; it has to be small enough to be inlined.
#[inline(always)]
pub fn vectorized<R>(action: impl FnOnce() -> R) -> R {
    Arch::new().dispatch(Loop(action))
}

struct Loop<F>(F);

impl<R, F: FnOnce() -> R> WithSimd for Loop<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> R {
        (self.0)()
    }
}

/// `target += source`, element by element.
pub fn add(target: &mut [f32], source: &[f32]) {
    vectorized(|| {
        for (target, source) in target.iter_mut().zip(source) {
            *target += source;
        }
    });
}
