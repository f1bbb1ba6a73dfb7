//! Stated errors: no vertex of level 0 is farther from the triangles of a coarser chunk than that
//! chunk states, and no level states much more than is seen.

use super::check::Check;
use crate::sample::{self, word};
use rayon::prelude::*;
use serde::Serialize;
use std::cmp::Reverse;
use std::ops::RangeInclusive;
use terrain::chunk::drawn_height_scaled;
use terrain::constants::{CELLS, SPACING_BITS, TOP_LEVEL, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use terrain::{ChunkKey, Grid, Land, lod};

/// Levels that are checked: all above 0. From level 8 on a chunk states the whole range of heights.
const LEVELS: RangeInclusive<u8> = 1..=TOP_LEVEL;

/// The largest error that a level states, in times of the largest that was seen: at most so much.
pub const TIGHT: f64 = 4.0;

/// Squares of vertices that are looked at in a chunk, and vertices along their sides.
const SQUARES: u32 = 40;
const SIDE: usize = 16;

/// Chunks of a world.
const OF_WORLD: u32 = 10;

/// Of so many chunks one is compared at every vertex: those that state the largest errors, of
/// equals those with the largest seen in squares. At most so many, and up to a level: a chunk of
/// level 8 has 268 million vertices.
const ONE_WHOLE_OF: u32 = 500;
const MOST_WHOLE: u32 = 16;
const WHOLE_LEVEL: u8 = 8;

const STREAM: u32 = 0xe44;

/// How the names of the checks of levels begin.
pub const OF_LEVEL: &str = "level ";

/// Stated and observed errors of a level. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorRow {
    pub level: u8,
    pub chunks: u32,
    /// Those of them that were compared at every vertex: they state the largest errors.
    pub whole: u32,
    /// Vertices of level 0 that were compared.
    pub vertices: u64,
    /// Largest error that a chunk states, and largest distance seen, metres.
    pub stated_m: f64,
    pub seen_m: f64,
    /// The median over the chunks of what each states, in times of what was seen in it. Chunks
    /// where less than a metre was seen do not count.
    pub median_ratio: Option<f64>,
}

/// Compares so many chunks of every level, on islands of many worlds.
pub fn check(chunks: u32) -> (Vec<Check>, Vec<ErrorRow>) {
    LEVELS.map(|level| of_level(level, chunks, 1)).unzip()
}

/// Chunks that state a quarter of their error: must be caught.
pub fn control() -> Check {
    let (check, _) = of_level(2, 50, 4);
    Check { name: format!("a quarter of the stated error: {}", check.name), ..check }
}

/// Whether levels state at most [`TIGHT`] times what was seen. Few chunks find less than the
/// largest error, so this judges thousands.
pub fn tightness(rows: &[ErrorRow]) -> Check {
    let mut check = Check::new("levels that state at most 4 times the largest error seen");
    for row in rows {
        check.expect_within(row.stated_m, TIGHT * row.seen_m, format!("level {}", row.level));
    }
    check
}

/// The whole range of heights as the error of level 5: must be caught. From level 7 on the land is
/// so far from the triangles that the whole range is less than four times as much.
pub fn loose_control(rows: &[ErrorRow]) -> Check {
    let range = f64::from(lod::SUMMIT - lod::LOWEST) / f64::from(UNITS_PER_METRE);
    let of_range = |row: &ErrorRow| ErrorRow { stated_m: range, ..row.clone() };
    let loose: Vec<_> = rows.iter().filter(|row| row.level == 5).map(of_range).collect();
    let check = tightness(&loose);
    Check { name: format!("the whole range of heights: {}", check.name), ..check }
}

/// A chunk of a world, and what it states and what was seen, units.
struct Seen {
    seed: u64,
    key: ChunkKey,
    stated: f64,
    seen: f64,
}

fn of_level(level: u8, chunks: u32, divisor: u32) -> (Check, ErrorRow) {
    let worlds = chunks.div_ceil(OF_WORLD);
    let of_world = |world: u32| {
        let land = Land::new(u64::from(world));
        let places = sample::land_points(land.world_seed(), OF_WORLD, STREAM + u32::from(level));
        let places = places.take((chunks - world * OF_WORLD) as usize).enumerate();
        places.map(|(index, place)| look(&land, level, place, world * OF_WORLD + index as u32)).collect()
    };
    let mut all: Vec<Seen> =
        (0..worlds).into_par_iter().flat_map_iter(|world| -> Vec<Seen> { of_world(world) }).collect();
    // Squares miss the largest distances of a chunk, and its bound would be judged by less than it
    // has to bound.
    let whole = if level > WHOLE_LEVEL { 0 } else { (chunks / ONE_WHOLE_OF).min(MOST_WHOLE) };
    all.sort_by_key(|chunk| Reverse((chunk.stated as u32, chunk.seen as u32)));
    for chunk in &mut all[..whole as usize] {
        chunk.seen = look_everywhere(&Land::new(chunk.seed), chunk.key);
    }
    let mut check = Check::new(format!("{OF_LEVEL}{level}: chunks within the error that they state"));
    for Seen { seed, key, stated, seen } in &all {
        check.expect_within(*seen, stated / f64::from(divisor), format!("{key} of world {seed}"));
    }
    let largest = |of: fn(&Seen) -> f64| all.iter().map(of).fold(0.0, f64::max) / f64::from(UNITS_PER_METRE);
    let counted: Vec<_> = all.iter().filter(|chunk| chunk.seen > f64::from(UNITS_PER_METRE)).collect();
    let ratios = counted.iter().map(|chunk| chunk.stated / chunk.seen);
    let row = ErrorRow {
        level,
        chunks: all.len() as u32,
        whole,
        vertices: all.len() as u64 * u64::from(SQUARES) * (SIDE * SIDE) as u64
            + u64::from(whole) * ((VERTEX_COUNT as u64) << (2 * level)),
        stated_m: largest(|chunk| chunk.stated),
        seen_m: largest(|chunk| chunk.seen),
        median_ratio: (!counted.is_empty()).then(|| crate::stats::median(ratios)),
    };
    (check, row)
}

/// Compares squares of vertices at hashed places of the chunk at a place (units).
fn look(land: &Land, level: u8, (x, z): (i32, i32), number: u32) -> Seen {
    let key = ChunkKey::containing(level, x, z);
    let chunk = land.chunk(key);
    let free = ((CELLS as u32) << level) + 1 - SIDE as u32;
    let corner = |square: u32| {
        let at = |axis| word(STREAM + 64 + u32::from(level), 2 * (number * SQUARES + square) + axis) % free;
        [at(0), at(1)]
    };
    let squares = (0..SQUARES).map(|square| farthest(land, key, &chunk.heights, corner(square), SIDE));
    let seen = squares.fold(0.0, f64::max);
    Seen { seed: land.world_seed(), key, stated: f64::from(chunk.error), seen }
}

/// The largest distance in a chunk, units: every vertex of level 0 under it, in the squares of its
/// chunks of level 0.
fn look_everywhere(land: &Land, key: ChunkKey) -> f64 {
    let (squares, drawn) = (1u32 << key.level(), land.chunk_heights(key));
    let of_square = |square: u32| {
        let corner = [square % squares, square / squares].map(|index| index * CELLS as u32);
        farthest(land, key, &drawn, corner, VERTICES)
    };
    (0..squares * squares).into_par_iter().map(of_square).reduce(|| 0.0, f64::max)
}

/// The largest distance of the heights (units) of a square of level-0 vertices, so many along a
/// side from a corner of a chunk on, from the chunk's triangles.
fn farthest(land: &Land, key: ChunkKey, drawn: &[i32; VERTEX_COUNT], corner: [u32; 2], side: usize) -> f64 {
    let units = |low: i32, index: u32| low.wrapping_add_unsigned(index << SPACING_BITS);
    let ((west, north), level) = (key.origin(), key.level());
    let grid = Grid::new(units(west, corner[0]), units(north, corner[1]), 0, side, side)
        .expect("the square lies in the chunk");
    let mut heights = vec![0; side * side];
    land.heights(&grid, &mut heights);
    let apart = |(index, height): (usize, &i32)| {
        let (column, row) = (corner[0] as usize + index % side, corner[1] as usize + index / side);
        let drawn = drawn_height_scaled(drawn, column, row, level) as f64 / f64::from(1u32 << level);
        (drawn - f64::from(*height)).abs()
    };
    heights.iter().enumerate().map(apart).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_vertex_is_beyond_the_stated_error_and_a_quarter_of_it_is_caught() {
        let (checks, rows) = check(20);
        assert!(checks.iter().all(|check| check.holds() && check.cases == 20), "{checks:?}");
        assert!(rows.iter().all(|row| row.stated_m >= row.seen_m && row.seen_m > 0.1), "{rows:?}");
        assert!(control().violations > 5);
        assert_eq!(loose_control(&rows).violations, 1);
    }

    #[test]
    fn every_vertex_finds_what_is_measured_exactly_and_what_squares_miss() {
        let land = Land::new(3);
        for level in 1..=3 {
            let place = sample::land_points(land.world_seed(), 1, STREAM).next().unwrap();
            let squares = look(&land, level, place, 0);
            let whole = look_everywhere(&land, squares.key);
            // Up to level 3 a chunk states the largest distance, rounded up.
            assert!(whole <= squares.stated && squares.stated < whole + 1.0, "level {level}: {whole}");
            assert!(whole >= squares.seen && whole > 0.0);
        }
    }

    #[test]
    fn a_level_may_state_four_times_what_was_seen_and_no_more() {
        let (_, mut rows) = check(1);
        for row in &mut rows {
            (row.stated_m, row.seen_m) = (40.0, 10.0);
        }
        assert!(tightness(&rows).holds());
        rows[6].stated_m = 40.01;
        let check = tightness(&rows);
        assert_eq!((check.violations, check.worst_at.as_str()), (1, "level 7"));
    }
}
