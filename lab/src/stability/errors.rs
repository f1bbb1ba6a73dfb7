//! Stated errors: no vertex of level 0 is farther from the triangles of a coarser chunk than that
//! chunk states, and no level states much more than is seen.

use super::check::Check;
use crate::sample::{self, word};
use rayon::prelude::*;
use serde::Serialize;
use terrain::chunk::drawn_height_scaled;
use terrain::constants::{CELLS, SPACING_BITS, UNITS_PER_METRE};
use terrain::{ChunkKey, Grid, Land, lod};

/// Levels that are checked. From level 8 on a chunk states the whole range of heights.
const LEVELS: std::ops::RangeInclusive<u8> = 1..=8;

/// The largest error that a level states, in times of the largest that was seen: at most so much.
const TIGHT: f64 = 4.0;

/// Squares of vertices that are looked at in a chunk, and vertices along their sides.
const SQUARES: u32 = 40;
const SIDE: usize = 16;

/// Chunks of a world.
const OF_WORLD: u32 = 10;

const STREAM: u32 = 0xe44;

/// What a level states and what was seen. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorRow {
    pub level: u8,
    pub chunks: u32,
    /// Vertices of level 0 that were compared.
    pub vertices: u64,
    /// Largest error that a chunk states, and largest distance seen, metres.
    pub stated_m: f64,
    pub seen_m: f64,
    /// The median over the chunks of what each states, in times of what was seen in it. Chunks where
    /// less than a metre was seen do not count.
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

/// Whether levels state at most [`TIGHT`] times what was seen. Few chunks find less than the largest
/// error, so this judges thousands.
pub fn tightness(rows: &[ErrorRow]) -> Check {
    let mut check = Check::new("levels that state at most 4 times the largest error seen");
    for row in rows {
        check.expect_within(row.stated_m, TIGHT * row.seen_m, format!("level {}", row.level));
    }
    check
}

/// The whole range of heights as the error of level 7: must be caught.
pub fn loose_control(rows: &[ErrorRow]) -> Check {
    let range = f64::from(lod::SUMMIT - lod::LOWEST) / f64::from(UNITS_PER_METRE);
    let of_range = |row: &ErrorRow| ErrorRow { stated_m: range, ..row.clone() };
    let loose: Vec<_> = rows.iter().filter(|row| row.level == 7).map(of_range).collect();
    let check = tightness(&loose);
    Check { name: format!("the whole range of heights: {}", check.name), ..check }
}

/// A chunk: its name, and what it states and what was seen, units.
struct Seen {
    name: String,
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
    let all: Vec<Seen> =
        (0..worlds).into_par_iter().flat_map_iter(|world| -> Vec<Seen> { of_world(world) }).collect();
    let mut check = Check::new(format!("level {level}: chunks within the error that they state"));
    for Seen { name, stated, seen } in &all {
        check.expect_within(*seen, stated / f64::from(divisor), name);
    }
    let largest = |of: fn(&Seen) -> f64| all.iter().map(of).fold(0.0, f64::max) / f64::from(UNITS_PER_METRE);
    let counted: Vec<_> = all.iter().filter(|chunk| chunk.seen > f64::from(UNITS_PER_METRE)).collect();
    let ratios = counted.iter().map(|chunk| chunk.stated / chunk.seen);
    let row = ErrorRow {
        level,
        chunks: all.len() as u32,
        vertices: all.len() as u64 * u64::from(SQUARES) * (SIDE * SIDE) as u64,
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
    let (west, north) = key.origin();
    let side = (CELLS as u32) << level;
    let mut heights = [0; SIDE * SIDE];
    let mut seen = 0.0_f64;
    for square in 0..SQUARES {
        let corner = [0, 1].map(|axis| {
            let word = word(STREAM + 64 + u32::from(level), 2 * (number * SQUARES + square) + axis);
            word % (side + 1 - SIDE as u32)
        });
        let units = |low: i32, index: u32| low + ((index as i32) << SPACING_BITS);
        let grid = Grid::new(units(west, corner[0]), units(north, corner[1]), 0, SIDE, SIDE)
            .expect("the square lies in the chunk");
        land.heights(&grid, &mut heights);
        for (index, height) in heights.iter().enumerate() {
            let (column, row) = (corner[0] as usize + index % SIDE, corner[1] as usize + index / SIDE);
            let drawn =
                drawn_height_scaled(&chunk.heights, column, row, level) as f64 / f64::from(1u32 << level);
            seen = seen.max((drawn - f64::from(*height)).abs());
        }
    }
    Seen { name: key.to_string(), stated: f64::from(chunk.error), seen }
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
