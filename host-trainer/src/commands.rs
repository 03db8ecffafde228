//! What the user types, one file per verb: arguments in, library calls, text out.

pub mod bake;
pub mod bench;
pub mod calibrate;
pub mod character;
pub mod check;
pub mod classify;
pub mod clips;
pub mod demo;
pub mod evaluate;
pub mod generate;
pub mod inspect;
pub mod inspect_clips;
pub mod motions;
pub mod perform;
pub mod plan;
pub mod quantize;
pub mod reconstruct;
pub mod reproduce;
pub mod sampler_args;
pub mod samplers;
pub mod train;
pub mod tune;
