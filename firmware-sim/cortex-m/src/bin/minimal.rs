#![no_std]
#![no_main]
//! The smallest product: one motion after the other, each pose handed to whoever drives the servos.
//!
//! In:  blob and workspace width, put into the program by `build.rs`.
//! Out: poses, to nobody. The program is made to be looked at: size and symbols of the linked image.
//!
//! Why here: `decode_cases` prints, and printing brings panics and formatting along that a product does not have.
//! Nothing of this package's library is used, for the same reason.

use core::hint::{black_box, spin_loop};
use core::panic::PanicInfo;

use cortex_m_rt::entry;
use karakuri::{ActionId, Decoder, FramePosition, Model, Pcg32, Pose, Workspace};

/// Bytes at an address that every tensor's alignment divides.
#[repr(C, align(16))]
struct Aligned<Bytes: ?Sized>(Bytes);

include!(concat!(env!("OUT_DIR"), "/blob.rs"));

#[entry]
fn main() -> ! {
    // The compiler must not know the blob: what it could prove of this one need not hold for the next.
    play(black_box(&BLOB.0));
    loop {
        spin_loop();
    }
}

/// Plays all actions in turn; returns only if the blob is refused.
fn play(blob: &[u8]) -> Option<()> {
    #[cfg(feature = "forbidden")]
    black_box(forbidden(blob));
    let model = Model::from_bytes(blob).ok()?;
    let mut workspace = Workspace::<WORKSPACE_WIDTH>::new();
    let mut decoder = Decoder::new(&model, &mut workspace).ok()?;
    let mut random = Pcg32::new(black_box(1));
    let mut pose = Pose::new();
    for action in (0..model.manifest().action_count).map(ActionId).cycle() {
        let frames = *model.trained_frames(action).start();
        let code = model.sample(action, frames, &mut || random.next_u32()).ok()?;
        decoder.start(&code);
        for frame in 0..frames {
            decoder.decode(FramePosition::from_frames(frame), &mut pose);
            black_box(pose.channels());
        }
    }
    None
}

/// Panics where the compiler cannot see that it does, and multiplies floats.
#[cfg(feature = "forbidden")]
#[inline(never)]
fn forbidden(blob: &[u8]) -> f32 {
    let index = black_box(1);
    f32::from(blob[index]) * black_box(1.5)
}

#[panic_handler]
fn stop(_: &PanicInfo<'_>) -> ! {
    loop {
        spin_loop();
    }
}
