#![no_std]
#![no_main]
//! Goes through one motion step by step, each step marked for the instruction counter.
//!
//! In:  the blob in its partition, the workspace's width by `build.rs`.
//! Out: a line `region <name>` for each counted step, and lines `number <name> <number>`, most of them bytes.
//!
//! Why here: the device's half of `firmware-sim bench`; `firmware_sim::benchmark` joins the names with the counts.
//! Everything large lies in `main`'s frame, so that what is measured as stack is what the calls themselves need.

use core::hint::black_box;

use cortex_m_rt::entry;
use firmware::{blob_partition, or_refuse, region, stack};
use karakuri::random::gaussian_q12;
use karakuri::{
    ActionId, BlobError, Code, Decoder, FramePosition, Model, PairDecoder, PairWorkspace, Pcg32,
    Pose, SampleError, Stage, Workspace,
};
use semihosting::println;

include!(concat!(env!("OUT_DIR"), "/width.rs"));

/// Draws in the region `gaussians`, enough to meet every branch in proportion.
const GAUSSIAN_COUNT: u32 = 256;
/// A position between two frames, as a device clock gives it.
const POSITION: FramePosition = FramePosition::from_bits((11 << 16) + 0x5555);
/// A whole frame: a model with a time table need not compute its sinusoids.
const WHOLE_FRAME: FramePosition = FramePosition::from_frames(11);

#[entry]
fn main() -> ! {
    region::count("empty", || ());
    let blob = blob_partition::blob();
    let mut model = Model::empty();
    or_refuse("blob", region::count("load", || load(&mut model, blob)));
    let mut code = Code::default();
    let mut pose = Pose::new();
    let mut workspace = Workspace::<WORKSPACE_WIDTH>::new();
    let mut decoder = or_refuse("workspace", Decoder::new(&model, &mut workspace));
    count_motion(&model, &mut decoder, &mut code, &mut pose);
    count_pair(&model, &code);
    measure_stack(&model, &mut decoder, &mut code, &mut pose);
    let mut again = Model::empty();
    let load_bytes = stack::stack_bytes_of(|| {
        let _ = black_box(load(&mut again, blob));
    });
    println!("number stack_load {load_bytes}");
    print_sizes(&model);
    semihosting::process::exit(0)
}

/// From random numbers to a pose, then the same pose stage by stage.
fn count_motion(
    model: &Model<'_>,
    decoder: &mut Decoder<'_, '_>,
    code: &mut Code,
    pose: &mut Pose,
) {
    println!("number gaussians {GAUSSIAN_COUNT}");
    region::count("gaussians", draw_gaussians);
    or_refuse("code", region::count("sample", || sample(model, code)));
    region::count("fold", || decoder.start(black_box(code)));
    region::count("pose", || decoder.decode(black_box(POSITION), pose));
    region::count("whole frame", || decoder.decode(black_box(WHOLE_FRAME), pose));
    region::begin();
    decoder.decode_observed(black_box(POSITION), pose, &mut |stage| {
        match stage {
            Stage::TimeEmbedding => region::end("time embedding"),
            // The manifest's layers 0 and 1 are the two halves of layer 1.
            Stage::Layer(index) => region::end(format_args!("layer {index}")),
            Stage::Output => region::end("output"),
        }
        region::begin();
    });
    region::end("return");
}

/// Two poses in one pass over the weights; nothing for a model without such kernels.
///
/// In a function of its own, because workspace and poses are large and nobody else needs them.
#[inline(never)]
fn count_pair(model: &Model<'_>, code: &Code) {
    let mut workspace = PairWorkspace::<WORKSPACE_WIDTH>::new();
    let Ok(mut decoder) = PairDecoder::new(model, &mut workspace) else { return };
    let mut poses = [Pose::new(), Pose::new()];
    decoder.start(black_box(code));
    let positions = black_box([POSITION, WHOLE_FRAME]);
    region::count("pair", || decoder.decode(positions, &mut poses));
    black_box(&poses);
    let bytes_per_unit = size_of::<PairWorkspace<WORKSPACE_WIDTH>>() / WORKSPACE_WIDTH;
    println!("number pair_workspace {}", bytes_per_unit * model.workspace_width());
}

/// Each step for itself: a product keeps the model and calls the other steps in turn, so the deepest counts.
fn measure_stack(
    model: &Model<'_>,
    decoder: &mut Decoder<'_, '_>,
    code: &mut Code,
    pose: &mut Pose,
) {
    let sample_bytes = stack::stack_bytes_of(|| {
        let _ = black_box(sample(model, code));
    });
    let fold_bytes = stack::stack_bytes_of(|| decoder.start(black_box(code)));
    let pose_bytes = stack::stack_bytes_of(|| decoder.decode(black_box(POSITION), pose));
    println!("number stack_sample {sample_bytes}");
    println!("number stack_fold {fold_bytes}");
    println!("number stack_pose {pose_bytes}");
}

fn print_sizes(model: &Model<'_>) {
    println!("number static {}", stack::static_bytes());
    println!("number model {}", size_of::<Model<'static>>());
    println!("number code {}", size_of::<Code>());
    println!("number pose {}", size_of::<Pose>());
    // The program's own workspace serves every model; one of the model's width is smaller in proportion.
    let bytes_per_unit = size_of::<Workspace<WORKSPACE_WIDTH>>() / WORKSPACE_WIDTH;
    println!("number workspace {}", bytes_per_unit * model.workspace_width());
}

// Functions of their own, so that every step is compiled once, however often it is called.

#[inline(never)]
fn load(model: &mut Model<'static>, blob: &'static [u8]) -> Result<(), BlobError> {
    model.load(black_box(blob))
}

#[inline(never)]
fn draw_gaussians() {
    let mut random = Pcg32::new(black_box(1));
    for _ in 0..GAUSSIAN_COUNT {
        black_box(gaussian_q12(&mut || random.next_u32()));
    }
}

#[inline(never)]
fn sample(model: &Model<'_>, code: &mut Code) -> Result<(), SampleError> {
    let mut random = Pcg32::new(black_box(1));
    let frames = *model.trained_frames(ActionId(0)).start();
    model.sample_into(ActionId(0), frames, &mut || random.next_u32(), code)
}
