//! Motions → keyframes, the other way to store motion: straight lines or cubic curves between chosen samples.
//!
//! In:  the samples of one channel at a fixed rate, the largest error that is allowed.
//! Out: keys, to `bake` (Bottango plays cubics) and to `plan` (what keyframes of the same clips would take).
//!
//! Why here: a model is worth its flash only against the best that keyframes can do, so both are fitted with care and
//! their error is measured at every sample.

pub mod cubic;
pub mod linear;
