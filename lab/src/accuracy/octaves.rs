//! Octaves kept: cost against error, with the proved bound.

use super::errors::{HEIGHTS, SLOPES, compare, exact, integers};
use crate::chart::{Panel, linear, log};
use crate::curve::{Curve, Sheet};
use crate::reference_f64::ReferenceF64;
use crate::sample;
use crate::stats::{Figures, interleaved, median_s};
use std::hint::black_box;
use std::time::Instant;
use terrain::constants::{OCTAVES, UNITS_PER_METRE, VERTEX_COUNT};
use terrain::octaves::TooManyOctaves;
use terrain::{ChunkKey, Grid, Land, Octaves};

const POINTS: u32 = 40_000;

/// Rounds of the interleaved timing; the median counts.
const ROUNDS: usize = 41;

/// Chunks of the home island, all of them land.
const CHUNKS: [(i32, i32); 9] =
    [(-9, -9), (0, -9), (9, -9), (-9, 0), (0, 0), (9, 0), (-9, 9), (0, 9), (9, 9)];

struct Row {
    octaves: Octaves,
    height: Figures,
    slope: Figures,
    seconds: f64,
}

pub fn measure(world_seed: u64) -> Curve {
    let (land, reference) = (Land::new(world_seed), exact(ReferenceF64::new(world_seed)));
    let points: Vec<_> = sample::land_vertices(world_seed, POINTS, 21).collect();
    let rows = seconds(&land).into_iter().enumerate().map(|(count, seconds)| {
        let octaves = Octaves::new(count).expect("at most all");
        let (height, slope) = compare(&integers(land, octaves), &reference, &points);
        Row { octaves, height, slope, seconds }
    });
    let caption = format!(
        "errors against f64 with 8 octaves at {POINTS} vertices of islands; cost of 65 x 65 chunks on \
         the home island, median of {ROUNDS} interleaved rounds."
    );
    let mut sheet = Sheet::new("octaves", caption, rows.collect());
    let full = sheet.rows.last().map_or(f64::NAN, |row| row.seconds);
    sheet.column("octaves", |row| row.octaves.count() as f64);
    sheet.column("max, m", |row| row.height.max);
    sheet.column("p99, m", |row| row.height.p99);
    // The bound is between integers; the reference is half a unit and the arithmetic away.
    sheet
        .column("proved bound, m", |row| f64::from(row.octaves.dropped_bound()) / f64::from(UNITS_PER_METRE));
    sheet.column("max, degrees", |row| row.slope.max);
    sheet.column("p99, degrees", |row| row.slope.p99);
    sheet.column("cost ratio", |row| row.seconds / full);
    sheet.column("ns per vertex", |row| row.seconds * 1e9 / (CHUNKS.len() * VERTEX_COUNT) as f64);

    let (x, time) = (linear("octaves kept"), linear("time, share of 8 octaves"));
    let (height, slope) = (log("height error, m"), log("slope error, degrees"));
    let panels = vec![
        sheet
            .lines(Panel::new("Height error against octaves kept", x, height), "octaves", HEIGHTS)
            .bound("proved bound", sheet.points("octaves", "proved bound, m"))
            .bound("bar, 1/128 m", [(0.0, 1.0 / 128.0), (8.0, 1.0 / 128.0)]),
        sheet
            .lines(Panel::new("Slope error against octaves kept", x, slope), "octaves", SLOPES)
            .bound("bar, 0.2 degrees", [(0.0, 0.2), (8.0, 0.2)]),
        Panel::new("Cost against octaves kept", x, time)
            .line("time per vertex", sheet.points("octaves", "cost ratio")),
        sheet.lines(Panel::new("Cost against error", time, height), "cost ratio", HEIGHTS),
    ];
    let title = "Octaves kept: cost and accuracy (reference: f64, 8 octaves)";
    Curve { name: "octaves", title, tables: vec![sheet.into()], panels }
}

/// Median times over all chunks for 0 to 8 octaves.
fn seconds(land: &Land) -> Vec<f64> {
    let grids = CHUNKS.map(|(x, z)| Grid::of_chunk(ChunkKey::new(0, x, z).expect("a chunk near the origin")));
    let mut heights = vec![0; VERTEX_COUNT];
    let times = interleaved(ROUNDS, OCTAVES + 1, |count| {
        let octaves = Octaves::new(count)?;
        let begun = Instant::now();
        for grid in grids {
            land.heights(black_box(&grid.keeping(octaves)), &mut heights);
            black_box(&heights);
        }
        Ok::<_, TooManyOctaves>(begun.elapsed())
    });
    times.expect("at most all octaves").iter().map(|times| median_s(times)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_octave_reduces_the_error_and_no_error_exceeds_its_bound() {
        let curve = measure(3);
        let table = &curve.tables[0];
        assert_eq!(table.rows.len(), OCTAVES + 1);
        for (found, bound) in table.points("max, m", "proved bound, m") {
            assert!(found <= bound + 1.0 / 128.0, "{found} m found, {bound} m proved");
        }
        let p99: Vec<f64> = table.points("octaves", "p99, m").into_iter().map(|point| point.1).collect();
        assert!(p99.is_sorted_by(|a, b| a > b), "{p99:?}");
    }
}
