//! Prints the test vectors of docs/heightfield.md, from the smallest part to the whole.
//!
//! Run: `cargo run -p tombolo-terrain --example test_vectors`

use std::fmt::Write as _;
use terrain::hash::{hash2, mix, stream_seed};
use terrain::ring::{mod_floor, mod_trunc};
use terrain::weights::weights;
use terrain::{Land, Octaves, Position};

/// Seed, x and z in units, octaves kept: lattice lines, both signs, single octaves, the beach from
/// both sides and at its edges, rims, islands of other cells, an empty cell, open sea, the corners
/// of the world.
const PLACES: [(u64, i32, i32, usize); 30] = [
    (0, 0, 0, 8),
    (0, 0, 0, 0),
    (0, 0, 0, 1),
    (0, 0, 0, 4),
    (0, 1, -1, 8),
    (0, -512, 512, 8),
    (0, 100_096, -100_097, 8),
    (0, 262_144 - 633 * 256, -391 * 256, 8),
    (0, 262_143 - 633 * 256, -391 * 256 - 1, 8),
    (0, 1_234_567, -765_432, 8),
    (0, 1_234_567, -765_432, 3),
    (0, 858_636, -888_607, 8),
    (0, -943_132, 736_735, 8),
    (0, 924_433, -865_587, 8),
    (0, -692_470, -958_500, 8),
    (0, -614_349, 1_018_895, 8),
    (0, 800_917, 926_127, 8),
    (0, 1_700_000, 0, 8),
    (0, 2_097_152, -2_097_152, 8),
    (0, 2_596_864 + 70_001, -32_256 - 50_003, 8),
    (0, -572_928 + 512_345, 3_560_960 - 98_765, 8),
    (0, -4_586_496 - 333_333, 8_598_016 + 222_222, 8),
    (3, 4_890_112 + 123_456, -848_896 + 65_432, 8),
    (3, 5 << 22, -9 << 22, 8),
    (1, 300_000, 300_000, 8),
    (1, -300_000, 300_000, 1),
    (0xffff_ffff_ffff_ffff, -77_777, 88_888, 8),
    (1 << 32, -77_777, 88_888, 8),
    (42, 1 << 30, 1 << 30, 8),
    (42, -(1 << 30), (1 << 30) - 12_345_678, 8),
];

/// Dividend and divisor: both signs, zero, and the ends of i32.
const REMAINDERS: [(i32, i32); 12] = [
    (7, 3),
    (-7, 3),
    (7, -3),
    (-7, -3),
    (1, 768),
    (-1, 768),
    (-5, 0),
    (i32::MIN, -1),
    (i32::MIN, 3),
    (i32::MAX, i32::MIN),
    (-1, i32::MIN),
    (i32::MIN, i32::MIN),
];

/// The tables as they are on the page.
pub fn tables() -> String {
    let mut page = String::new();
    parts(&mut page)
        .and_then(|()| heights(&mut page))
        .and_then(|()| remainders(&mut page))
        .expect("writing to a string does not fail");
    page
}

fn parts(page: &mut String) -> std::fmt::Result {
    writeln!(page, "| part | value |\n| --- | --- |")?;
    writeln!(page, "| mix(1) | {:#010x} |", mix(1))?;
    writeln!(page, "| hash2(1, 2, -3) | {:#010x} |", hash2(1, 2, -3))?;
    for (seed, stream) in [(0, 0), (0, 7), (1 << 32, 0), (5, 0x1517)] {
        writeln!(page, "| stream_seed({seed}, {stream}) | {:#010x} |", stream_seed(seed, stream))?;
    }
    for fraction in [0, 1, 100_000, 262_143] {
        let weights = weights(fraction);
        writeln!(page, "| line, step of fraction {fraction} | {:?}, {:?} |", weights.line, weights.step)?;
    }
    for (seed, x, z) in [(0u64, 1, 0), (0, -2, -2), (3, 2, -1), (3, 5, -9)] {
        let island = Land::new(seed).archipelago().island(x, z);
        let island = island.map_or("none".into(), |island| {
            format!("centre {:?}, radius {} m, dome {} m", island.centre, island.radius_m, island.dome_m)
        });
        writeln!(page, "| island of seed {seed} in cell ({x}, {z}) | {island} |")?;
    }
    writeln!(page)
}

fn heights(page: &mut String) -> std::fmt::Result {
    writeln!(page, "| seed | x | z | octaves | hills | folds | height |")?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- | --- |")?;
    for (seed, x, z, kept) in PLACES {
        let (land, octaves) = (Land::new(seed), Octaves::new(kept).expect("at most eight"));
        let relief = land.fbm().at(x, z, octaves);
        let height = land.height_keeping(Position::new(x, z).expect("inside the world"), octaves);
        writeln!(page, "| {seed} | {x} | {z} | {kept} | {} | {} | {height} |", relief.hills, relief.folds)?;
    }
    Ok(())
}

fn remainders(page: &mut String) -> std::fmt::Result {
    writeln!(page, "\n| a | m | mod_trunc | mod_floor |\n| --- | --- | --- | --- |")?;
    for (a, m) in REMAINDERS {
        writeln!(page, "| {a} | {m} | {} | {} |", mod_trunc(a, m), mod_floor(a, m))?;
    }
    Ok(())
}

#[cfg_attr(test, expect(dead_code, reason = "the test that compares the page takes the tables alone"))]
fn main() {
    print!("{}", tables());
}
