//! The small tables of a synthetic model: frequencies, and the sampler's clips and lengths.

use crate::network::Shape;

/// Actions of every synthetic model.
pub const ACTION_COUNT: u16 = 12;
/// Clips of an action.
pub const CLIPS_PER_ACTION: u16 = 8;
/// Turns per frame · 2^32 of the fastest frequency: 1 rad.
const FIRST_FREQUENCY: f64 = 683_565_275.576;

/// Steps of every frequency.
pub fn frequencies(shape: &Shape) -> Vec<u8> {
    let steps =
        std::iter::successors(Some(FIRST_FREQUENCY), |step| Some(step * shape.frequency_ratio));
    steps
        .take(usize::from(shape.frequency_count))
        .flat_map(|step| (step as u32).to_le_bytes())
        .collect()
}

/// Every component once, in order, equally likely within its interval.
pub fn members() -> Vec<u8> {
    let member = |component: u16| {
        let place = u32::from(component % CLIPS_PER_ACTION) + 1;
        let cumulative = (65_535 * place / u32::from(CLIPS_PER_ACTION)) as u16;
        [component, cumulative].map(u16::to_le_bytes).concat()
    };
    (0..ACTION_COUNT * CLIPS_PER_ACTION).flat_map(member).collect()
}

/// One interval an action: 40 to 60 frames, its own clips, noise as it is (4096 is 1).
pub fn intervals() -> Vec<u8> {
    let interval = |action: u16| {
        let halves = [action, 40, 60, 4096].map(u16::to_le_bytes).concat();
        let first = u32::from(action * CLIPS_PER_ACTION);
        [halves, [first, u32::from(CLIPS_PER_ACTION)].map(u32::to_le_bytes).concat()].concat()
    };
    (0..ACTION_COUNT).flat_map(interval).collect()
}
