//! Levels: do coarse levels keep all octaves, or drop those that their grid cannot carry?
//!
//! Three rules are compared on the same chunks: keep **all**; keep an octave while its **cell** is
//! at least the vertex spacing (the land's rule, [`Octaves::at_level`]); keep it while **half** its
//! cell is (the sampling theorem's). For each:
//!
//! - how far its vertices are from the full heights at the same places, beside the proved bound;
//! - how far they are from the land's local mean (a box of one spacing), which is what a vertex
//!   that stands for its surroundings should show: what is left of it is aliasing;
//! - how far the drawn triangles are from the level-0 land under them: what screen error is charged
//!   for;
//! - roughness: the second difference of neighbouring vertices over their spacing, which flickers
//!   when a camera moves;
//! - bytes of a chunk on the wire, and time.

use super::Curve;
use super::errors::Figures;
use super::octaves::median;
use crate::chart::{Panel, linear, log, measured, stated};
use crate::sample::{self, word};
use crate::table::Table;
use protocol::chunk_codec;
use rayon::prelude::*;
use std::hint::black_box;
use std::time::Instant;
use terrain::chunk::drawn_height_scaled;
use terrain::constants::{CELLS, OCTAVES, SPACING_BITS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES, WORLD_HALF};
use terrain::{Chunk, ChunkKey, GrassSeed, Land, Octaves, Position, WorldDigest};

/// Levels measured: a level-10 chunk is 131 km wide.
const LEVELS: u8 = 11;

/// Chunks per level, around places inside islands.
const CHUNKS: u32 = 24;

/// Vertices per chunk whose local mean is taken, and samples per side of its box.
const MEAN_VERTICES: u32 = 256;
const MEAN_SIDE: i32 = 8;

/// Level-0 vertices per chunk that the drawn surface is held against.
const DRAWN_POINTS: u32 = 4_000;

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

/// Measures all levels and rules.
#[must_use]
pub fn measure(world_seed: u64) -> Curve {
    let land = Land::new(world_seed);
    let mut accuracy = Table::new(
        "levels",
        format!(
            "rules all, cell, half on {CHUNKS} chunks per level over islands. apart: vertices by rule cell against full heights; mean: RMS distance of vertices from the land's mean over one spacing; drawn: RMS of triangles against level-0 vertices; worst: the largest of it."
        ),
        &[
            "level",
            "spacing, m",
            "octaves",
            "apart max, m",
            "apart p99, m",
            "proved, m",
            "mean all, m",
            "mean cell, m",
            "mean half, m",
            "drawn all, m",
            "drawn cell, m",
            "drawn half, m",
            "worst all, m",
            "worst cell, m",
        ],
    );
    let mut price = Table::new(
        "levels_cost",
        "rough: RMS second difference of neighbouring vertices over their spacing; bytes: a chunk in the protocol's exact coding; cost: time per vertex against all octaves, point by point.",
        &[
            "level",
            "rough all",
            "rough cell",
            "rough half",
            "bytes all",
            "bytes cell",
            "bytes half",
            "cost all",
            "cost cell",
            "cost half",
        ],
    );
    for level in 0..LEVELS {
        // The same places on every level, so that neighbouring levels can be compared.
        let chunks: Vec<_> = sample::land_vertices(world_seed, CHUNKS, 40)
            .map(|(x, z)| ChunkKey::containing(level, x, z))
            .collect();
        let found = [Rule::All, Rule::Cell, Rule::Half].map(|rule| look(&land, &chunks, rule.octaves(level)));
        let [all, cell, _] = &found;
        let units = |value: u32| f64::from(value) / f64::from(UNITS_PER_METRE);
        let mut row = vec![f64::from(level), units(1 << (SPACING_BITS + u32::from(level)))];
        row.extend([cell.octaves.count() as f64, cell.apart_m.max, cell.apart_m.p99]);
        row.push(units(cell.octaves.dropped_bound()));
        row.extend(found.iter().map(|rule| rule.from_mean_m.rms));
        row.extend(found.iter().map(|rule| rule.drawn_m.rms));
        row.extend([all.drawn_m.max, cell.drawn_m.max]);
        accuracy.push(row);
        let mut row = vec![f64::from(level)];
        row.extend(found.iter().map(|rule| rule.roughness));
        row.extend(found.iter().map(|rule| rule.bytes));
        row.extend(found.iter().map(|rule| rule.cost));
        price.push(row);
    }
    let panels = panels(&accuracy, &price);
    let title = "Levels: all octaves, or only those that the grid carries";
    Curve { name: "levels", title, tables: vec![accuracy, price], panels }
}

/// Legends of the rules.
const NAMES: [(&str, &str); 3] = [
    ("all", "all octaves"),
    ("cell", "cell at least the spacing (the land's rule)"),
    ("half", "one octave fewer"),
];

fn panels(accuracy: &Table, price: &Table) -> Vec<Panel> {
    let of_rules = |table: &Table, prefix: &str, suffix: &str| {
        let curve = |rule: &str| table.curve("level", &format!("{prefix} {rule}{suffix}"));
        NAMES.map(|(rule, name)| measured(name, curve(rule))).to_vec()
    };
    // The rules differ by parts of a tenth over four decades: as shares of keeping all, the
    // difference can be seen.
    let shares = |prefix: &str| {
        let curve = |rule: &str| accuracy.curve("level", &format!("{prefix} {rule}, m"));
        let all = curve("all");
        let share = |rule: &str| {
            let pairs = curve(rule).into_iter().zip(all.clone());
            pairs.filter(|(_, all)| all.1 > 0.0).map(|(own, all)| (own.0, own.1 / all.1)).collect::<Vec<_>>()
        };
        NAMES.map(|(rule, name)| measured(name, share(rule))).to_vec()
    };
    vec![
        Panel {
            title: "Vertices against full heights",
            x: linear("level"),
            y: log("height error, m"),
            series: vec![
                measured("largest found", accuracy.curve("level", "apart max, m")),
                measured("99th percentile", accuracy.curve("level", "apart p99, m")),
                stated("proved bound", accuracy.curve("level", "proved, m")),
            ],
        },
        Panel {
            title: "Aliasing: vertices against the local mean",
            x: linear("level"),
            y: linear("RMS distance, share of all octaves"),
            series: shares("mean"),
        },
        Panel {
            title: "Drawn triangles against the land",
            x: linear("level"),
            y: linear("RMS error, share of all octaves"),
            series: shares("drawn"),
        },
        Panel {
            title: "Roughness from vertex to vertex",
            x: linear("level"),
            y: linear("RMS second difference over spacing"),
            series: of_rules(price, "rough", ""),
        },
        Panel {
            title: "Chunk on the wire",
            x: linear("level"),
            y: linear("bytes"),
            series: of_rules(price, "bytes", ""),
        },
        Panel {
            title: "Cost per vertex",
            x: linear("level"),
            y: linear("time, share of all octaves"),
            series: of_rules(price, "cost", ""),
        },
    ]
}

fn look(land: &Land, chunks: &[ChunkKey], octaves: Octaves) -> Found {
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
            let truth = at(land, (place(x0, column), place(z0, row)), Octaves::ALL);
            (drawn - f64::from(truth)).abs() / f64::from(UNITS_PER_METRE)
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

/// Time per vertex against all octaves, of the definition point by point: grids above level 2
/// cannot carry more than their level keeps, so their kernels cannot be timed with all.
/// Interleaved, medians.
fn cost(land: &Land, chunks: &[ChunkKey], octaves: Octaves) -> f64 {
    const ROUNDS: usize = 15;
    if octaves.count() == OCTAVES {
        return 1.0;
    }
    let mut times = [Vec::new(), Vec::new()];
    for _ in 0..ROUNDS {
        for (octaves, times) in [octaves, Octaves::ALL].into_iter().zip(&mut times) {
            let begun = Instant::now();
            for key in chunks {
                for index in (0..VERTEX_COUNT).step_by(41) {
                    black_box(at(land, vertex(*key, index % VERTICES, index / VERTICES), octaves));
                }
            }
            times.push(begun.elapsed());
        }
    }
    let [kept, all] = times.map(median);
    kept.as_secs_f64() / all.as_secs_f64().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rules_agree_where_a_grid_carries_everything_and_part_where_it_does_not() {
        for level in 0..=2 {
            assert_eq!(Rule::Cell.octaves(level), Octaves::ALL);
        }
        assert_eq!([3, 4, 9].map(|level| Rule::Cell.octaves(level).count()), [7, 6, 1]);
        assert_eq!([2, 3, 9].map(|level| Rule::Half.octaves(level).count()), [7, 6, 0]);
    }

    #[test]
    fn no_vertex_is_farther_from_the_full_height_than_was_proved() {
        let land = Land::new(4);
        for level in [3, 5, 7] {
            let key = ChunkKey::containing(level, 40_000, -70_000);
            let octaves = Octaves::at_level(level);
            let (kept, full) = (heights(&land, key, octaves), heights(&land, key, Octaves::ALL));
            let worst = kept.iter().zip(full.iter()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(worst > 0 && worst <= octaves.dropped_bound(), "level {level}: {worst}");
        }
    }

    #[test]
    fn the_drawn_surface_of_level_0_is_the_land() {
        let land = Land::new(4);
        let key = ChunkKey::containing(0, 40_000, -70_000);
        let heights = heights(&land, key, Octaves::ALL);
        assert!(distances_of_drawn(&land, key, &heights).iter().all(|distance| *distance == 0.0));
    }
}
