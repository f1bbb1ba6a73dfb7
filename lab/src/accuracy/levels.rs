//! Levels: do coarse levels keep all octaves, or drop those that their grid cannot carry?
//!
//! Three rules are compared on the same chunks: keep **all**; keep an octave while its **cell** is
//! at least the vertex spacing (the land's rule, [`Octaves::at_level`]); keep it while **half** its
//! cell is (the sampling theorem's). Below seven octaves, from level 5 on by the land's rule and from
//! level 4 on by the last one, the base field is not a spline of its nodes: that step is measured
//! with the octaves. For each:
//!
//! - distance of its vertices from the full heights;
//! - distance from the land's local mean (a box of one spacing), the aliasing of a vertex;
//! - distance of the drawn triangles from level 0, which screen error is computed from;
//! - roughness: the second difference of neighbouring vertices over their spacing, which flickers
//!   when a camera moves;
//! - bytes of a chunk on the wire, and time.

use crate::curve::{Curve, Sheet};
use crate::sample::{self, word};
use crate::stats::{Figures, interleaved, median_s};
use chart::{Panel, linear, log};
use protocol::chunk_codec;
use rayon::prelude::*;
use std::convert::Infallible;
use std::hint::black_box;
use std::time::Instant;
use terrain::chunk::drawn_height_scaled;
use terrain::constants::{CELLS, OCTAVES, SPACING_BITS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES, WORLD_HALF};
use terrain::{Chunk, ChunkKey, GrassSeed, Land, Octaves, Position, WorldDigest};

/// Levels measured: a level-10 chunk is 131 km wide.
const LEVELS: u8 = 11;

/// Chunks per level, around places inside islands; [`ERRORS`] states the number.
const CHUNKS: u32 = 24;

/// Vertices per chunk whose local mean is taken, and samples per side of its box.
const MEAN_VERTICES: u32 = 256;
const MEAN_SIDE: i32 = 8;

/// Level-0 vertices per chunk that the drawn surface is compared with.
const DRAWN_POINTS: u32 = 4_000;

const ERRORS: &str = "\
     rules all, cell, half on 24 chunks per level over islands. apart: vertices by rule cell \
     against full heights; mean: RMS distance of vertices from the land's mean over one spacing; drawn: RMS \
     of triangles against level-0 vertices; worst: the largest of it.";
const COSTS: &str = "\
     rough: RMS second difference of neighbouring vertices over their spacing; bytes: a chunk in \
     the protocol's exact coding; cost: time per vertex against all octaves, point by point.";

/// A rule for the octaves that a level keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    All,
    Cell,
    Half,
}

/// Figures of a rule at a level.
struct Found {
    octaves: Octaves,
    apart_m: Figures,
    from_mean_m: Figures,
    drawn_m: Figures,
    roughness: f64,
    bytes: f64,
    cost: f64,
}

impl Rule {
    fn octaves(self, level: u8) -> Octaves {
        match self {
            Self::All => Octaves::ALL,
            Self::Cell => Octaves::at_level(level),
            Self::Half => Octaves::at_level(level + 1),
        }
    }
}

/// The rules: name in the tables, name in diagrams.
const RULES: [(Rule, &str, &str); 3] = [
    (Rule::All, "all", "all octaves"),
    (Rule::Cell, "cell", "cell at least the spacing (the land's rule)"),
    (Rule::Half, "half", "cell at least two spacings"),
];

struct Row {
    level: u8,
    /// By rule.
    found: [Found; 3],
}

pub fn measure(world_seed: u64) -> Curve {
    let land = Land::new(world_seed);
    let row = |level| {
        // The same places on every level, so that neighbouring levels can be compared.
        let places = sample::land_vertices(world_seed, CHUNKS, 40);
        let chunks: Vec<_> = places.map(|(x, z)| ChunkKey::containing(level, x, z)).collect();
        Row { level, found: RULES.map(|(rule, ..)| measure_rule(&land, &chunks, rule.octaves(level))) }
    };
    let rows: Vec<Row> = (0..LEVELS).map(row).collect();
    let units = |value: u32| f64::from(value) / f64::from(UNITS_PER_METRE);
    let mut errors = Sheet::new("levels", ERRORS, rows.iter().collect());
    errors.column("level", |row| row.level.into());
    errors.column("spacing, m", |row| units(1 << (SPACING_BITS + u32::from(row.level))));
    errors.column("octaves", |row| row.found[1].octaves.count() as f64);
    errors.column("apart max, m", |row| row.found[1].apart_m.max);
    errors.column("apart p99, m", |row| row.found[1].apart_m.p99);
    by_rule(&mut errors, "mean", ", m", |found| found.from_mean_m.rms);
    by_rule(&mut errors, "drawn", ", m", |found| found.drawn_m.rms);
    errors.column("worst all, m", |row| row.found[0].drawn_m.max);
    errors.column("worst cell, m", |row| row.found[1].drawn_m.max);
    let mut costs = Sheet::new("levels_cost", COSTS, rows.iter().collect());
    costs.column("level", |row| row.level.into());
    by_rule(&mut costs, "rough", "", |found| found.roughness);
    by_rule(&mut costs, "bytes", "", |found| found.bytes);
    by_rule(&mut costs, "cost", "", |found| found.cost);

    let x = linear("level");
    // The rules differ by parts of a tenth over four decades: shares of keeping all show it.
    let shares = |title, y, name: &str| {
        let points = |rule: &str| errors.points("level", &format!("{name} {rule}, m"));
        let share = |rule: &str| {
            let pairs = points(rule).into_iter().zip(points("all"));
            pairs.filter(|(_, all)| all.1 > 0.0).map(|(own, all)| (own.0, own.1 / all.1)).collect::<Vec<_>>()
        };
        RULES.iter().fold(Panel::new(title, x, y), |panel, (_, rule, label)| panel.line(*label, share(rule)))
    };
    let of_rules = |title, y, name: &str| {
        let columns = RULES.map(|(_, rule, label)| (label, format!("{name} {rule}")));
        costs.lines(Panel::new(title, x, y), "level", columns)
    };
    let apart = [("largest found", "apart max, m"), ("99th percentile", "apart p99, m")];
    let panels = vec![
        errors.lines(Panel::new("Vertices against full heights", x, log("height error, m")), "level", apart),
        shares(
            "Aliasing: vertices against the local mean",
            linear("RMS distance, share of all octaves"),
            "mean",
        ),
        shares("Drawn triangles against the land", linear("RMS error, share of all octaves"), "drawn"),
        of_rules("Roughness from vertex to vertex", linear("RMS second difference over spacing"), "rough"),
        of_rules("Chunk on the wire", linear("bytes"), "bytes"),
        of_rules("Cost per vertex", linear("time, share of all octaves"), "cost"),
    ];
    let title = "Levels: all octaves, or only those that the grid carries";
    Curve { name: "levels", title, tables: vec![errors.into(), costs.into()], panels }
}

fn by_rule(sheet: &mut Sheet<&Row>, name: &str, unit: &str, value: fn(&Found) -> f64) {
    for (index, (_, rule, _)) in RULES.into_iter().enumerate() {
        sheet.column(format!("{name} {rule}{unit}"), |row| value(&row.found[index]));
    }
}

fn measure_rule(land: &Land, chunks: &[ChunkKey], octaves: Octaves) -> Found {
    let (mut apart, mut from_mean, mut drawn, mut seconds, mut bytes) = (vec![], vec![], vec![], vec![], 0);
    for key in chunks {
        let heights = heights(land, *key, octaves);
        let full = self::heights(land, *key, Octaves::ALL);
        apart.extend(heights.iter().zip(full.iter()).map(|(a, b)| metres(a - b)));
        from_mean.extend(distances_from_mean(land, *key, &heights));
        drawn.extend(distances_of_drawn(land, *key, &heights));
        seconds.extend(second_differences(*key, &heights));
        let grass = GrassSeed::grow(land.world_seed(), *key, &heights);
        let chunk = Chunk::from_parts(*key, heights, 0, grass);
        bytes += chunk_codec::encode(&chunk, &WorldDigest([0; 32])).len();
    }
    Found {
        octaves,
        apart_m: Figures::of(apart),
        from_mean_m: Figures::of(from_mean),
        drawn_m: Figures::of(drawn),
        roughness: Figures::of(seconds).rms,
        bytes: bytes as f64 / chunks.len() as f64,
        cost: cost(land, chunks, octaves),
    }
}

fn metres(units: i32) -> f64 {
    f64::from(units.abs()) / f64::from(UNITS_PER_METRE)
}

/// Heights of a chunk's vertices with any number of octaves, more than its level keeps included.
fn heights(land: &Land, key: ChunkKey, octaves: Octaves) -> Box<[i32; VERTEX_COUNT]> {
    let heights: Vec<i32> = (0..VERTEX_COUNT)
        .into_par_iter()
        .map(|index| at(land, vertex(key, index % VERTICES, index / VERTICES), octaves))
        .collect();
    heights.into_boxed_slice().try_into().expect("as many as a chunk has")
}

/// Height at a place; places beyond the border count as on it.
fn at(land: &Land, (x, z): (i64, i64), octaves: Octaves) -> i32 {
    let clamp = |v: i64| v.clamp(-i64::from(WORLD_HALF), i64::from(WORLD_HALF)) as i32;
    let position = Position::new(clamp(x), clamp(z)).expect("clamped into the world");
    land.height_keeping(position, octaves)
}

fn vertex(key: ChunkKey, column: usize, row: usize) -> (i64, i64) {
    let (x, z) = key.origin();
    let step = |low: i32, index: usize| i64::from(low) + ((index as i64) * i64::from(key.spacing()));
    (step(x, column), step(z, row))
}

/// Distances, metres, of some vertices from the mean of the full land over a box of one spacing
/// around each.
fn distances_from_mean(land: &Land, key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Vec<f64> {
    (0..MEAN_VERTICES)
        .into_par_iter()
        .map(|n| {
            let index = word(0x3ea4, n) as usize % VERTEX_COUNT;
            let (x, z) = vertex(key, index % VERTICES, index / VERTICES);
            let offset = |step: i32| {
                // Middles of the box's parts: symmetric around the vertex.
                i64::from(key.spacing()) * i64::from(2 * step + 1 - MEAN_SIDE) / i64::from(2 * MEAN_SIDE)
            };
            let sum: i64 = (0..MEAN_SIDE * MEAN_SIDE)
                .map(|part| (x + offset(part % MEAN_SIDE), z + offset(part / MEAN_SIDE)))
                .map(|place| i64::from(at(land, place, Octaves::ALL)))
                .sum();
            let mean = sum as f64 / f64::from(MEAN_SIDE * MEAN_SIDE);
            (f64::from(heights[index]) - mean).abs() / f64::from(UNITS_PER_METRE)
        })
        .collect()
}

/// Vertical distances, metres, of the drawn triangles from level-0 vertices under them.
fn distances_of_drawn(land: &Land, key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Vec<f64> {
    let (x0, z0) = key.origin();
    let side = (CELLS as u32) << key.level();
    (0..DRAWN_POINTS)
        .into_par_iter()
        .map(|n| {
            let (column, row) = (word(0xd4a3, 2 * n) % (side + 1), word(0xd4a3, 2 * n + 1) % (side + 1));
            let drawn = drawn_height_scaled(heights, column as usize, row as usize, key.level()) as f64
                / f64::from(1u32 << key.level());
            let place = |low: i32, step: u32| i64::from(low) + (i64::from(step) << SPACING_BITS);
            let reference = at(land, (place(x0, column), place(z0, row)), Octaves::ALL);
            (drawn - f64::from(reference)).abs() / f64::from(UNITS_PER_METRE)
        })
        .collect()
}

/// Second differences along the rows, over the spacing.
fn second_differences(key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Vec<f64> {
    heights
        .chunks_exact(VERTICES)
        .flat_map(|row| row.windows(3))
        .map(|w| f64::from((w[0] - 2 * w[1] + w[2]).abs()) / f64::from(key.spacing()))
        .collect()
}

/// Time per vertex over that with all octaves, of the point-by-point definition: the kernels of
/// grids above level 2 cannot compute all octaves.
fn cost(land: &Land, chunks: &[ChunkKey], octaves: Octaves) -> f64 {
    const ROUNDS: usize = 15;
    if octaves.count() == OCTAVES {
        return 1.0;
    }
    let Ok(times) = interleaved(ROUNDS, 2, |index| {
        let begun = Instant::now();
        for key in chunks {
            for place in (0..VERTEX_COUNT).step_by(41) {
                let vertex = vertex(*key, place % VERTICES, place / VERTICES);
                black_box(at(land, vertex, [octaves, Octaves::ALL][index]));
            }
        }
        Ok::<_, Infallible>(begun.elapsed())
    });
    median_s(&times[0]) / median_s(&times[1]).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_agree_on_levels_that_carry_all_octaves_and_differ_above() {
        for level in 0..=2 {
            assert_eq!(Rule::Cell.octaves(level), Octaves::ALL);
        }
        assert_eq!([3, 4, 5, 9].map(|level| Rule::Cell.octaves(level).count()), [8, 7, 6, 1]);
        assert_eq!([2, 3, 4, 9].map(|level| Rule::Half.octaves(level).count()), [8, 7, 6, 0]);
    }

    #[test]
    fn the_drawn_surface_of_level_0_is_the_land() {
        let land = Land::new(4);
        let key = ChunkKey::containing(0, 40_000, -70_000);
        let heights = heights(&land, key, Octaves::ALL);
        assert!(distances_of_drawn(&land, key, &heights).iter().all(|distance| *distance == 0.0));
    }
}
