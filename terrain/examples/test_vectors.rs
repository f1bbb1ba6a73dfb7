//! Prints the test vectors of docs/heightfield.md.
//!
//! Run: `cargo run -p terrain --example test_vectors`

use terrain::{Land, Octaves, Position};

/// Seed, x and z in units, octaves kept. Lattice lines, both signs, the sea, other islands, the corners of the world.
const PLACES: [(u64, i32, i32, usize); 16] = [
    (0, 0, 0, 8),
    (0, 0, 0, 0),
    (0, 1, -1, 8),
    (0, -512, 512, 8),
    (0, 100_096, -100_097, 8),
    (0, 262_144 - 633 * 256, -391 * 256, 8),
    (0, 262_143 - 633 * 256, -391 * 256 - 1, 8),
    (0, 1_234_567, -765_432, 8),
    (0, 1_234_567, -765_432, 3),
    (0, 1_700_000, 0, 8),
    (0, 2_097_152, -2_097_152, 8),
    (1, 300_000, 300_000, 8),
    (1, -300_000, 300_000, 1),
    (0xffff_ffff_ffff_ffff, -77_777, 88_888, 8),
    (42, 1 << 30, 1 << 30, 8),
    (42, -(1 << 30), (1 << 30) - 12_345_678, 8),
];

fn main() {
    println!("| seed | x | z | octaves | hills | folds | height |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for (seed, x, z, kept) in PLACES {
        let (land, octaves) = (Land::new(seed), Octaves::new(kept).expect("at most eight"));
        let relief = land.fbm().at(x, z, octaves);
        let height = land.height_keeping(Position::new(x, z).expect("inside the world"), octaves);
        println!("| {seed} | {x} | {z} | {kept} | {} | {} | {height} |", relief.hills, relief.folds);
    }
}
