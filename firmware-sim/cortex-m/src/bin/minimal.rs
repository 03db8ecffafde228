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
use karakuri::{ActionId, Code, Decoder, FramePosition, Model, Pcg32, Pose, Workspace};

#[path = "../blob_partition.rs"]
mod blob_partition;

include!(concat!(env!("OUT_DIR"), "/width.rs"));

/// Stands for the register of a servo.
static mut SERVO: i32 = 0;

/// What moves.
struct Motion<'m> {
    random: Pcg32,
    code: &'m mut Code,
    pose: &'m mut Pose,
}

#[entry]
fn main() -> ! {
    // `entry` hands these out as exclusive references: what is large lies in statics, not on the stack.
    static mut WORKSPACE: Workspace<WORKSPACE_WIDTH> = Workspace::new();
    static mut CODE: Code = Code::new();
    static mut POSE: Pose = Pose::new();
    let mut motion = Motion { random: Pcg32::new(1), code: CODE, pose: POSE };
    let blob = blob_partition::blob();
    #[cfg(feature = "forbidden")]
    core::hint::black_box(forbidden(blob));
    let mut model = Model::empty();
    if model.load(blob).is_ok()
        && let Ok(mut decoder) = Decoder::new(&model, WORKSPACE)
    {
        for action in (0..model.manifest().action_count).cycle() {
            move_once(&model, ActionId(action), &mut decoder, &mut motion);
        }
    }
    stop()
}

/// One motion of the action, as short as it was ever trained.
fn move_once(
    model: &Model<'_>,
    action: ActionId,
    decoder: &mut Decoder<'_, '_>,
    Motion { random, code, pose }: &mut Motion<'_>,
) {
    let frames = *model.trained_frames(action).start();
    if model.sample_into(action, frames, &mut || random.next_u32(), code).is_err() {
        return;
    }
    decoder.start(code);
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
