//! Everything of karakuri that learns or measures: clip files in, blobs out.
//!
//! The modules stand in the order of the data's journey.

pub mod error;
pub mod layout;
pub mod skeleton;
pub mod clip;
pub mod character;
pub mod dataset;
pub mod float_model;
pub mod checkpoint;
pub mod commands {
    //! One module a verb of the program.
    pub mod character;
}
