//! Octaves kept: cost against error. Below seven octaves the base field is not a spline: grids that
//! carry so few are too coarse to share nodes.

use super::errors::{FIGURES, HEIGHTS, SLOPES, compare, exact, figures, integers};
use crate::curve::{Curve, Sheet};
use crate::reference_f64::ReferenceF64;
use crate::sample;
use crate::stats::{Figures, interleaved, median_s};
use chart::{Panel, linear, log};
use std::hint::black_box;
use std::time::Instant;
use terrain::constants::{OCTAVES, VERTEX_COUNT};
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
        "errors against f64 with 9 octaves at {POINTS} vertices of islands; cost of 65 x 65 chunks on \
         the home island, median of {ROUNDS} interleaved rounds."
    );
    let mut sheet = Sheet::new("octaves", caption, rows.collect());
    let full = sheet.rows.last().map_or(f64::NAN, |row| row.seconds);
    sheet.column("octaves", |row| row.octaves.count() as f64);
    sheet.columns(FIGURES, |row| figures(&row.height, &row.slope));
    sheet.column("cost ratio", |row| row.seconds / full);
    sheet.column("ns per vertex", |row| row.seconds * 1e9 / (CHUNKS.len() * VERTEX_COUNT) as f64);

    let (x, time) = (linear("octaves kept"), linear("time, share of 9 octaves"));
    let (height, slope) = (log("height error, m"), log("slope error, degrees"));
    let panels = vec![
        sheet
            .lines(Panel::new("Height error against octaves kept", x, height), "octaves", HEIGHTS)
            .bound("bar, 1/128 m", [(0.0, 1.0 / 128.0), (OCTAVES as f64, 1.0 / 128.0)]),
        sheet
            .lines(Panel::new("Slope error against octaves kept", x, slope), "octaves", SLOPES)
            .bound("bar, 0.2 degrees", [(0.0, 0.2), (OCTAVES as f64, 0.2)]),
        Panel::new("Cost against octaves kept", x, time)
            .line("time per vertex", sheet.points("octaves", "cost ratio")),
        sheet.lines(Panel::new("Cost against error", time, height), "cost ratio", HEIGHTS),
    ];
    let title = "Octaves kept: cost and accuracy (reference: f64, 9 octaves)";
    Curve { name: "octaves", title, tables: vec![sheet.into()], panels }
}

/// Median times over all chunks for 0 to 9 octaves.
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
    fn every_octave_reduces_the_error_and_all_of_them_hold_the_bars() {
        let curve = measure(3);
        let table = &curve.tables[0];
        assert_eq!(table.rows.len(), OCTAVES + 1);
        let p99: Vec<f64> = table.points("octaves", "p99, m").into_iter().map(|point| point.1).collect();
        assert!(p99.is_sorted_by(|a, b| a > b), "{p99:?}");
        let largest = table.points("octaves", "max, m");
        let (all, fewer) = (largest[OCTAVES].1, largest[OCTAVES - 1].1);
        assert!(all <= 1.0 / 128.0 && fewer > 0.1, "{all} m with all octaves, {fewer} m with one fewer");
    }
}
