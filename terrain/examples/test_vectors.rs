//! Prints the test vectors of docs/heightfield.md, from the smallest part to the whole.
//!
//! Run: `cargo run -p tombolo-terrain --example test_vectors`

use std::fmt::Write as _;
use terrain::curves::{fade, fade_slope, smoothstep, window};
use terrain::hash::{hash2, mix, stream_seed};
use terrain::island::Mass;
use terrain::ring::{mod_floor, mod_trunc};
use terrain::spline;
use terrain::weights::weights;
use terrain::{Land, Octaves, Position};

/// Seed, x and z in units, octaves kept: lattice lines, both signs, few octaves, a beach, a cliff,
/// a mountain, the rim of an island, open sea, the edges and corners of the world.
const PLACES: [(u64, i32, i32, usize); 26] = [
    (0, 0, 0, 9),
    (0, 0, 0, 0),
    (0, 0, 0, 1),
    (0, 0, 0, 4),
    (0, 0, 0, 6),
    (0, 0, 0, 7),
    (0, 1, -1, 9),
    (0, -512, 512, 9),
    (0, 8_192, -8_192, 9),
    (0, 8_191, -8_193, 9),
    (0, 100_096, -100_097, 9),
    (0, -9_472, -23_808, 9),
    (0, 412_160, 250_880, 9),
    (0, 412_160, 250_880, 5),
    (0, -366_592, 121_344, 9),
    (0, -366_592, 121_344, 3),
    (1, 300_000, 300_000, 9),
    (1, -300_000, 300_000, 2),
    (3, 655_360, -131_072, 9),
    (3, 20_971_520, -37_748_736, 9),
    (u64::MAX, -77_777, 88_888, 9),
    (1 << 32, -77_777, 88_888, 9),
    (1 << 63, 512_000, -256_000, 9),
    (42, 1 << 30, 1 << 30, 9),
    (42, -(1 << 30), (1 << 30) - 12_345_678, 9),
    (7, -1_073_520_640, 1_073_217_536, 9),
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
    for t in [0, 1 << 9, 1_234_567_168, i32::MAX - 511] {
        writeln!(page, "| fade, fade' of {t} | {}, {} |", fade(t), fade_slope(t))?;
    }
    for x in [0, 1, 400_000_000, (1 << 30) - 1] {
        writeln!(page, "| smooth, window of {x} | {}, {} |", smoothstep(x), window(x))?;
    }
    for fraction in [0, 1, 12_500, 32_767] {
        let weights = weights(fraction);
        writeln!(page, "| line, step of fraction {fraction} | {:?}, {:?} |", weights.line, weights.step)?;
    }
    for fraction in [0, 1, 5_000, 8_191] {
        writeln!(page, "| spline weights of fraction {fraction} | {:?} |", spline::weights(fraction))?;
    }
    for (seed, x, z) in
        [(0u64, 0, 0), (0, 1, 2), (3, 1, -20), (3, 1, -7), (3, 1, -19), (3, 1, -6), (9, -7, 8)]
    {
        let (land, mut lobes) = (Land::new(seed), Vec::new());
        land.archipelago().lobes_of(x, z, &mut lobes);
        let kind = land.archipelago().kind(x, z).map_or("none".into(), |(kind, _)| format!("{kind:?}"));
        writeln!(page, "| island of seed {seed} in cell ({x}, {z}) | {kind}, {} lobes |", lobes.len())?;
        for lobe in lobes {
            let terrain::island::Lobe { centre, reach_m, long, short, mass, height, plateau, crater } = lobe;
            writeln!(
                page,
                "| - lobe at {centre:?} | reach {reach_m} m, long {long:?}, short {short:?}, mass {mass:?}, \
                 height {height}, plateau {plateau}, crater {crater} |"
            )?;
        }
    }
    writeln!(page)
}

fn heights(page: &mut String) -> std::fmt::Result {
    writeln!(page, "| seed | x | z | warp | mass, height | first octave: value, (dX, dZ) |")?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- |")?;
    for (seed, x, z, _) in PLACES.into_iter().filter(|(_, _, _, kept)| *kept == 9) {
        let land = Land::new(seed);
        let (base, lobes) = (land.base(), land.archipelago().lobes_near(x, z, 1));
        let (warp, octave) = (base.warp(x, z), base.octave(0, x, z));
        let Mass { mass, height } = Mass::at(&lobes, (x, z), warp);
        let (value, gradient) = (octave.value, octave.gradient);
        writeln!(page, "| {seed} | {x} | {z} | {warp:?} | {mass}, {height} | {value}, {gradient:?} |")?;
    }
    writeln!(page, "\n| seed | x | z | octaves | base: height, roughness, exposure | fine | height |")?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- | --- |")?;
    for (seed, x, z, kept) in PLACES {
        let (land, octaves) = (Land::new(seed), Octaves::new(kept).expect("at most nine"));
        let lobes = land.archipelago().lobes_near(x, z, 1);
        let node = land.base().at(&lobes, (x, z), octaves.base());
        let base = format!("{}, {}, {}", node.height, node.roughness, node.exposure);
        let fine = land.fbm().at(x, z, octaves);
        let height = land.height_keeping(Position::new(x, z).expect("inside the world"), octaves);
        writeln!(page, "| {seed} | {x} | {z} | {kept} | {base} | {fine} | {height} |")?;
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
