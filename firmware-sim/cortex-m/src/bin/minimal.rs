#![no_std]
#![no_main]
//! The smallest honest product: loads a blob, draws motion after motion, and moves something.
//!
//! In:  the blob in its partition, the workspace's width by `build.rs`.
//! Out: every channel of every pose, written to one volatile word in place of a servo.
//!
//! Why here: its size is what karakuri costs in flash. It prints nothing and formats nothing; it is measured, not run.

#![allow(unsafe_code)]

use core::panic::PanicInfo;
use core::ptr;

use cortex_m_rt::entry;
use karakuri::{ActionId, Decoder, FramePosition, Model, Pcg32, Pose, Workspace};

#[path = "../blob_partition.rs"]
mod blob_partition;

include!(concat!(env!("OUT_DIR"), "/width.rs"));

/// Stands for the register of a servo.
static mut SERVO: i32 = 0;

#[entry]
fn main() -> ! {
    let mut random = Pcg32::new(1);
    let mut workspace = Workspace::<WORKSPACE_WIDTH>::new();
    let mut pose = Pose::new();
    let blob = blob_partition::blob();
    #[cfg(feature = "forbidden")]
    core::hint::black_box(forbidden(blob));
    let model = Model::from_bytes(blob);
    if let Ok(model) = &model
        && let Ok(mut decoder) = Decoder::new(model, &mut workspace)
    {
        for action in (0..model.manifest().action_count).cycle() {
            move_once(model, ActionId(action), &mut decoder, &mut random, &mut pose);
        }
    }
    stop()
}

/// One motion of the action, as short as it was ever trained.
fn move_once(
    model: &Model<'_>,
    action: ActionId,
    decoder: &mut Decoder<'_, '_>,
    random: &mut Pcg32,
    pose: &mut Pose,
) {
    let frames = *model.trained_frames(action).start();
    let Ok(code) = model.sample(action, frames, &mut || random.next_u32()) else { return };
    decoder.start(&code);
    for frame in 0..frames {
        decoder.decode(FramePosition::from_frames(frame), pose);
        for &channel in pose.channels() {
            // SAFETY: one thread, no interrupt and no other reference to the static exist in this program.
            unsafe { ptr::write_volatile(&raw mut SERVO, channel) };
        }
    }
}

/// Panics where the compiler cannot see that it does, and multiplies floats.
#[cfg(feature = "forbidden")]
#[inline(never)]
fn forbidden(blob: &[u8]) -> f32 {
    let index = core::hint::black_box(1);
    f32::from(blob[index]) * core::hint::black_box(1.5)
}

fn stop() -> ! {
    loop {
        core::hint::spin_loop();
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    stop()
}
