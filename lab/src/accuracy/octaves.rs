//! Octaves kept: cost against error, and the proved bound beside what was found.

use super::Curve;
use super::errors::{compare, exact, integers};
use crate::chart::{Panel, linear, log, measured, stated};
use crate::sample;
use crate::table::Table;
use crate::truth::Truth;
use std::hint::black_box;
use std::time::{Duration, Instant};
use terrain::constants::{OCTAVES, UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{ChunkKey, Grid, Land, Octaves};

const POINTS: u32 = 40_000;

/// Rounds of the interleaved timing; the median is kept.
const ROUNDS: usize = 41;

/// Measures all numbers of octaves.
#[must_use]
pub fn measure(world_seed: u64) -> Curve {
    let (land, truth) = (Land::new(world_seed), exact(Truth::new(world_seed)));
    let points: Vec<_> = sample::land_vertices(world_seed, POINTS, 21).collect();
    let times = times(&land);
    let full = times[OCTAVES].as_secs_f64();
    let mut table = Table::new(
        "octaves",
        format!(
            "errors against f64 with 8 octaves at {POINTS} vertices of islands; cost of 65 x 65 chunks on the home island, median of {ROUNDS} interleaved rounds."
        ),
        &[
            "octaves",
            "max, m",
            "p99, m",
            "proved bound, m",
            "max, degrees",
            "p99, degrees",
            "cost ratio",
            "ns per vertex",
        ],
    );
    for (count, time) in times.iter().enumerate() {
        let octaves = Octaves::new(count).expect("at most all");
        let (height, slope) = compare(&integers(land, octaves), &truth, &points);
        // The bound is between integers; the truth is half a unit and the arithmetic away.
        let bound_m = f64::from(octaves.dropped_bound()) / f64::from(UNITS_PER_METRE);
        let seconds = time.as_secs_f64();
        let ns = seconds * 1e9 / (CHUNKS.len() * VERTEX_COUNT) as f64;
        table.push([count as f64, height.max, height.p99, bound_m, slope.max, slope.p99, seconds / full, ns]);
    }
    let panels = vec![
        Panel {
            title: "Height error against octaves kept",
            x: linear("octaves kept"),
            y: log("height error, m"),
            series: vec![
                measured("largest found", table.curve("octaves", "max, m")),
                measured("99th percentile", table.curve("octaves", "p99, m")),
                stated("proved bound", table.curve("octaves", "proved bound, m")),
                stated("bar, 1/128 m", [(0.0, 1.0 / 128.0), (8.0, 1.0 / 128.0)]),
            ],
        },
        Panel {
            title: "Slope error against octaves kept",
            x: linear("octaves kept"),
            y: log("slope error, degrees"),
            series: vec![
                measured("largest found", table.curve("octaves", "max, degrees")),
                measured("99th percentile", table.curve("octaves", "p99, degrees")),
                stated("bar, 0.2 degrees", [(0.0, 0.2), (8.0, 0.2)]),
            ],
        },
        Panel {
            title: "Cost against octaves kept",
            x: linear("octaves kept"),
            y: linear("time, share of 8 octaves"),
            series: vec![measured("time per vertex", table.curve("octaves", "cost ratio"))],
        },
        Panel {
            title: "What an error costs",
            x: linear("time, share of 8 octaves"),
            y: log("height error, m"),
            series: vec![
                measured("largest found", table.curve("cost ratio", "max, m")),
                measured("99th percentile", table.curve("cost ratio", "p99, m")),
            ],
        },
    ];
    Curve {
        name: "octaves",
        title: "Octaves kept: cost and accuracy (truth: f64, 8 octaves)",
        tables: vec![table],
        panels,
    }
}

/// Chunks of the home island, all of them land.
const CHUNKS: [(i32, i32); 9] =
    [(-9, -9), (0, -9), (9, -9), (-9, 0), (0, 0), (9, 0), (-9, 9), (0, 9), (9, 9)];

/// Median time over all chunks for 0 to 8 octaves. The numbers of octaves take turns in every
/// round, so that a change of the machine's speed meets all of them.
fn times(land: &Land) -> Vec<Duration> {
    let grids = CHUNKS.map(|(x, z)| Grid::of_chunk(ChunkKey::new(0, x, z).expect("a chunk near the origin")));
    let mut heights = vec![0; VERTEX_COUNT];
    let mut times = vec![Vec::new(); OCTAVES + 1];
    for _ in 0..ROUNDS {
        for (count, times) in times.iter_mut().enumerate() {
            let octaves = Octaves::new(count).expect("at most all");
            let begun = Instant::now();
            for grid in grids {
                land.heights(black_box(&grid.keeping(octaves)), &mut heights);
                black_box(&heights);
            }
            times.push(begun.elapsed());
        }
    }
    times.into_iter().map(median).collect()
}

/// Medians, over rounds in which all take turns, of each one's time over the first one's time in
/// the same round: whatever slows the machine for longer than a round slows both.
pub(crate) fn ratios(times: &[Vec<Duration>]) -> Vec<f64> {
    let first = times.first().map_or(&[][..], Vec::as_slice);
    let ratio = |(own, first): (&Duration, &Duration)| own.as_secs_f64() / first.as_secs_f64().max(1e-9);
    times
        .iter()
        .map(|own| {
            let mut ratios: Vec<f64> = own.iter().zip(first).map(ratio).collect();
            ratios.sort_unstable_by(f64::total_cmp);
            ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN)
        })
        .collect()
}

/// The median of some times.
pub(super) fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times.get(times.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_slows_down_between_rounds_changes_no_ratio() {
        let times =
            [[2, 20, 20], [3, 3, 30], [8, 80, 80]].map(|times| times.map(Duration::from_secs).to_vec());
        assert_eq!(ratios(&times), [1.0, 1.5, 4.0]);
        let medians = times.map(median);
        assert_ne!(
            medians[1].as_secs_f64() / medians[0].as_secs_f64(),
            1.5,
            "the control: a ratio of medians"
        );
    }

    #[test]
    fn every_octave_brings_the_land_closer_to_the_truth_and_no_error_exceeds_its_bound() {
        let curve = measure(3);
        let table = &curve.tables[0];
        assert_eq!(table.rows.len(), OCTAVES + 1);
        for (x, y) in [("max, m", "proved bound, m")] {
            for (found, bound) in table.curve(x, y) {
                assert!(found <= bound + 1.0 / 128.0, "{found} m found, {bound} m proved");
            }
        }
        let p99: Vec<f64> = table.curve("octaves", "p99, m").into_iter().map(|point| point.1).collect();
        assert!(p99.is_sorted_by(|a, b| a > b), "{p99:?}");
    }
}
