#![no_std]
#![no_main]
//! Runs the multiply-accumulate loops chosen for this processor beside the portable ones and compares every bit.
//!
//! In:  nothing; weights, activations and start values are random or extreme, from a fixed seed.
//! Out: a line `family <name>`, then for every kernel `<name> cases <n> mismatches <n>`.
//!
//! Why here: assembly can be wrong in ways that no blob happens to meet: the last turns of an unrolled loop, sums that
//! wrap, sides of different length, weights at an odd address.

use core::array;

use cortex_m_rt::entry;
use karakuri::Pcg32;
use karakuri::kernel::{self, GROUP_SCALE_BYTES, GROUP_TILES, Quad, TILE_BYTES, portable};
use semihosting::println;

/// Lengths up to here are all tried, so every remainder of an unrolled loop is met.
const TILES_DENSE: usize = 36;
/// Longer blocks: those of the paper's network, and an odd one.
const TILES_LONG: [usize; 5] = [50, 64, 125, 201, 250];
/// Room for the longest block and for what [`Edge`] adds.
const TILES_MAX: usize = 256;

/// A word of a pattern is `random & mask | bits`.
const WEIGHT_PATTERNS: [(u32, u32); 6] = [
    (!0, 0),
    (0, 0x8080_8080),
    (0, 0x7F7F_7F7F),
    (0, 0x7F80_7F80),
    (0x8080_8080, 0),
    (0x0F0F_0F0F, 0x8080_8080),
];
const ACTIVATION_PATTERNS: [(u32, u32); 5] =
    [(!0, 0), (0, 0x7FFF_7FFF), (0, 0x8000_8000), (0, 0x8001_7FFF), (0x8000_8000, 0x0001_0001)];

/// How the slices of a case differ from whole, equally long and aligned ones.
#[derive(Clone, Copy, Default)]
struct Edge {
    more_tiles: usize,
    more_activations: usize,
    stray_bytes: usize,
    /// Bytes from an aligned address.
    offset: usize,
}

const NO_EDGE: Edge = Edge { more_tiles: 0, more_activations: 0, stray_bytes: 0, offset: 0 };
const EDGES: [Edge; 7] = [
    NO_EDGE,
    Edge { more_tiles: 3, ..NO_EDGE },
    Edge { more_activations: 3, ..NO_EDGE },
    // The scales end before both.
    Edge { more_tiles: 3, more_activations: 3, ..NO_EDGE },
    Edge { stray_bytes: 15, ..NO_EDGE },
    Edge { offset: 1, ..NO_EDGE },
    Edge { offset: 2, ..NO_EDGE },
];

#[repr(C, align(16))]
struct Aligned<Bytes>(Bytes);

/// Everything that any kernel reads.
struct Inputs {
    weights: Aligned<[u8; TILES_MAX * TILE_BYTES]>,
    activations: [u32; TILES_MAX * 4],
    scales: Aligned<[u8; (TILES_MAX / GROUP_TILES + 1) * GROUP_SCALE_BYTES]>,
    sums: [[i32; 4]; 2],
}

impl Inputs {
    const ZERO: Self = Self {
        weights: Aligned([0; _]),
        activations: [0; _],
        scales: Aligned([0; _]),
        sums: [[0; 4]; 2],
    };

    fn fill(&mut self, random: &mut Pcg32, weights: (u32, u32), activations: (u32, u32)) {
        for bytes in self.weights.0.as_chunks_mut().0 {
            *bytes = (random.next_u32() & weights.0 | weights.1).to_le_bytes();
        }
        for word in &mut self.activations {
            *word = random.next_u32() & activations.0 | activations.1;
        }
        for bytes in self.scales.0.as_chunks_mut().0 {
            let extreme = [0, 0, i16::MAX as u16, 1][(random.next_u32() >> 30) as usize];
            let scale = if extreme == 0 { random.next_u32() as u16 >> 1 } else { extreme };
            *bytes = scale.to_le_bytes();
        }
        let mut start = || [0, i32::MAX, i32::MIN, 1][(random.next_u32() >> 30) as usize];
        self.sums = array::from_fn(|_| array::from_fn(|_| start()));
        self.sums[0][0] ^= random.next_u32() as i32;
    }
}

/// One call of each kernel.
struct Case<'a> {
    inputs: &'a Inputs,
    tiles: usize,
    edge: Edge,
}

impl Case<'_> {
    fn weights(&self, tile_bytes: usize) -> &[u8] {
        let Edge { more_tiles, stray_bytes, offset, .. } = self.edge;
        &self.inputs.weights.0[offset..][..(self.tiles + more_tiles) * tile_bytes + stray_bytes]
    }

    /// As many as belong to the tiles, `words` a tile.
    fn activations<const SIZE: usize>(&self, words: usize) -> &[[u32; SIZE]] {
        let count = (self.tiles + self.edge.more_activations) * words;
        self.inputs.activations[..count].as_chunks().0
    }

    /// At an even offset: cut elsewhere, the bytes would make scales above the largest allowed, 32767.
    fn scales(&self) -> &[u8] {
        let groups = self.tiles.div_ceil(GROUP_TILES);
        &self.inputs.scales.0[self.edge.offset & !1..][..groups * GROUP_SCALE_BYTES]
    }
}

type Single = fn(&[u8], &[Quad], &mut [i32; 4]);
type Pair = fn(&[u8], &[[Quad; 2]], &mut [[i32; 4]; 2]);

fn single(case: &Case, kernel: Single) -> [i32; 4] {
    let mut sums = case.inputs.sums[0];
    kernel(case.weights(TILE_BYTES), case.activations(2), &mut sums);
    sums
}

fn pair(case: &Case, kernel: Pair) -> [[i32; 4]; 2] {
    let mut sums = case.inputs.sums;
    let (pairs, _) = case.activations::<2>(4).as_chunks();
    kernel(case.weights(TILE_BYTES), pairs, &mut sums);
    sums
}

fn nibbles(case: &Case, kernel: fn(&[u8], &[u8], &[Quad], &mut [i32; 4])) -> [i32; 4] {
    let mut sums = case.inputs.sums[0];
    kernel(case.weights(TILE_BYTES), case.scales(), case.activations(4), &mut sums);
    sums
}

/// Weights are made finite, and numbers smaller than 2: no sum is a NaN, whose bits nobody promises.
fn floats(case: &Case, kernel: fn(&[u8], &[f32], &mut [f32; 4])) -> [u32; 4] {
    let small = |word: u32| f32::from_bits(word & 0xBFFF_FFFF);
    let mut weights = Aligned([0; TILES_MAX * 8]);
    let bytes = case.weights(8);
    let weights = &mut weights.0[case.edge.offset..][..bytes.len()];
    weights.copy_from_slice(bytes);
    for half in weights.as_chunks_mut::<2>().0 {
        if half[1] & 0x7C == 0x7C {
            half[1] &= 0xBF;
        }
    }
    let activations: [f32; TILES_MAX] =
        array::from_fn(|column| small(case.inputs.activations[column]));
    let mut sums = case.inputs.sums[0].map(|sum| small(sum as u32));
    kernel(weights, &activations[..case.tiles + case.edge.more_activations], &mut sums);
    sums.map(f32::to_bits)
}

/// A kernel's name, and whether both implementations agree on a case.
type Check = (&'static str, fn(&Case) -> bool);

const CHECKS: [Check; 6] = [
    ("w8a16", |case| single(case, kernel::w8a16) == single(case, portable::w8a16)),
    ("w8a16_pair", |case| pair(case, kernel::w8a16_pair) == pair(case, portable::w8a16_pair)),
    ("w8a8", |case| single(case, kernel::w8a8) == single(case, portable::w8a8)),
    ("w8a8_pair", |case| pair(case, kernel::w8a8_pair) == pair(case, portable::w8a8_pair)),
    ("w4a8", |case| nibbles(case, kernel::w4a8) == nibbles(case, portable::w4a8)),
    ("f16", |case| floats(case, kernel::f16) == floats(case, portable::f16)),
];

#[entry]
fn main() -> ! {
    let mut inputs = Inputs::ZERO;
    let mut random = Pcg32::new(1);
    let mut cases = 0;
    let mut mismatches = [0; CHECKS.len()];
    for tiles in (0..=TILES_DENSE).chain(TILES_LONG) {
        for weights in WEIGHT_PATTERNS {
            for activations in ACTIVATION_PATTERNS {
                inputs.fill(&mut random, weights, activations);
                for edge in EDGES {
                    let case = Case { inputs: &inputs, tiles, edge };
                    cases += 1;
                    for (count, (_, agree)) in mismatches.iter_mut().zip(CHECKS) {
                        *count += u32::from(!agree(&case));
                    }
                }
            }
        }
    }
    println!("family {}", kernel::FAMILY);
    for ((name, _), count) in CHECKS.iter().zip(mismatches) {
        println!("{name} cases {cases} mismatches {count}");
    }
    semihosting::process::exit(0)
}
