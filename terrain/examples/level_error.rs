//! Measures the vertical error of every level against level 0 by brute force.
//!
//! For each level, chunks over the home islands of several seeds are compared with every level-0
//! vertex under them. The worst value found, plus a quarter, is the table in `terrain::lod`.
//!
//! Run: `cargo run --release -p tombolo-terrain --example level_error`

use terrain::chunk::drawn_height_scaled;
use terrain::constants::{CELLS, VERTICES};
use terrain::{ChunkKey, Land};

/// Seeds per level whose home island is searched all over: fewer where one chunk covers most of an
/// island.
const SEEDS: [u64; 7] = [0, 64, 64, 48, 24, 12, 6];
/// Seeds per level of which only the four chunks around the origin are searched, where ridges are
/// highest.
const SUMMITS: [u64; 7] = [0, 12_000, 8_000, 3_000, 1_000, 250, 60];

fn main() {
    println!("level  chunks  worst units  worst m");
    for level in 1..=6u8 {
        let (mut worst, mut chunks) = (0, 0);
        let mut look = |land: &Land, key| {
            worst = worst.max(error(land, key));
            chunks += 1;
        };
        for seed in 0..SEEDS[usize::from(level)] {
            let land = Land::new(seed);
            // A spread of chunks over the square of ±5 km around the origin, at most 5 x 5.
            let reach = 5_000 * 256;
            let step = (1usize << (15 + u32::from(level))).max(2 * 5_000 * 256 / 5);
            for x in (-reach..reach).step_by(step) {
                for z in (-reach..reach).step_by(step) {
                    look(&land, ChunkKey::containing(level, x, z));
                }
            }
        }
        for seed in 0..SUMMITS[usize::from(level)] {
            let land = Land::new(seed);
            for (x, z) in [(0, 0), (-1, 0), (0, -1), (-1, -1)] {
                look(&land, ChunkKey::new(level, x, z).expect("chunks around the origin exist"));
            }
        }
        println!("{level:>5}  {chunks:>6}  {worst:>11}  {:>7.3}", f64::from(worst) / 256.0);
    }
}

/// Exact error of one chunk in units, rounded up.
fn error(land: &Land, key: ChunkKey) -> u32 {
    let depth = key.level();
    let coarse = land.chunk_heights(key);
    let across = 1i32 << depth;
    let (x0, z0) = (key.x() * across, key.z() * across);
    let mut worst = 0i64;
    for (dx, dz) in (0..across).flat_map(|dz| (0..across).map(move |dx| (dx, dz))) {
        let fine = land.chunk_heights(ChunkKey::new(0, x0 + dx, z0 + dz).expect("descendants exist"));
        for (index, height) in fine.iter().enumerate() {
            let column = dx as usize * CELLS + index % VERTICES;
            let row = dz as usize * CELLS + index / VERTICES;
            let drawn = drawn_height_scaled(&coarse, column, row, depth);
            worst = worst.max(((i64::from(*height) << depth) - drawn).abs());
        }
    }
    (worst as u64).div_ceil(1 << depth) as u32
}
