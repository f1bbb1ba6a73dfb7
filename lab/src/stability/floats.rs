//! Float noise far from the origin: 64 samples one unit (1/256 m) apart, at growing distances.

use super::baselines::{Baseline, baselines};
use crate::floats::NOISE_CRATE_PERIOD_M;
use crate::sample::word;
use serde::Serialize;
use terrain::constants::{UNITS_PER_METRE, WORLD_HALF};

/// Distances from the origin, metres.
pub const DISTANCES_M: [i32; 5] = [1_000, 10_000, 100_000, 1_000_000, 4_000_000];

/// Samples of one line.
pub const SAMPLES: i32 = 64;

/// Lines per distance.
const LINES: u32 = 64;

/// One field at one distance.
#[derive(Clone, Debug, Serialize)]
pub struct FloatRow {
    pub field: &'static str,
    /// Distance from the origin along x, metres.
    pub distance_m: i32,
    /// Distinct values among the 64 samples of a line: the mean over the lines.
    pub distinct_mean: f64,
    /// The fewest of any line.
    pub distinct_least: usize,
    /// Largest change over one step of 1/256 m, metres.
    pub largest_jump_m: f64,
    /// The same, as a multiple of what the field's slope allows over 1/256 m: at most 1 for a
    /// continuous field.
    pub jump_over_bound: f64,
    /// Share of steps without any change: terraces.
    pub stuck: f64,
    /// Whether the relief equals the relief 32,768 m farther west, where a lattice of 256 cells
    /// begins again.
    pub repeats: bool,
}

/// Measures all fields at all distances.
pub fn measure(world_seed: u64) -> Vec<FloatRow> {
    let baselines = baselines(world_seed);
    baselines
        .iter()
        .flat_map(|baseline| DISTANCES_M.map(|distance_m| measure_at(baseline, distance_m)))
        .collect()
}

/// Measures one field at one distance.
pub fn measure_at(baseline: &Baseline, distance_m: i32) -> FloatRow {
    let (mut distinct, mut largest, mut stuck, mut repeats) = (Vec::new(), 0.0f64, 0u32, true);
    for line in 0..LINES {
        let (first, second) = (word(0xf10a7, 2 * line), word(0xf10a7, 2 * line + 1));
        // Spread over 1,000 m; odd units, so that no sample grid is privileged. North and south
        // alike.
        let x = distance_m * UNITS_PER_METRE + ((first >> 14) | 1) as i32;
        let z = ((second as i32) >> 1) / (WORLD_HALF / (distance_m * UNITS_PER_METRE)).max(1);
        let values: Vec<f64> = (0..SAMPLES).map(|n| (baseline.relief_m)(x + n, z)).collect();
        for pair in values.windows(2) {
            largest = largest.max((pair[1] - pair[0]).abs());
            stuck += u32::from(pair[0] == pair[1]);
        }
        let west = (baseline.relief_m)(x - NOISE_CRATE_PERIOD_M * UNITS_PER_METRE, z);
        repeats &= (west - values[0]).abs() < 1e-6;
        let mut sorted = values;
        sorted.sort_by(f64::total_cmp);
        sorted.dedup();
        distinct.push(sorted.len());
    }
    FloatRow {
        field: baseline.name,
        distance_m,
        distinct_mean: distinct.iter().sum::<usize>() as f64 / f64::from(LINES),
        distinct_least: distinct.into_iter().min().unwrap_or_default(),
        largest_jump_m: largest,
        jump_over_bound: largest / (baseline.slope / f64::from(UNITS_PER_METRE)),
        stuck: f64::from(stuck) / f64::from(LINES * (SAMPLES as u32 - 1)),
        repeats,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ours_stays_fine_at_every_distance_and_f32_does_not() {
        let baselines = baselines(1);
        for distance_m in DISTANCES_M {
            let row = measure_at(&baselines[0], distance_m);
            assert!(row.distinct_mean > 50.0 && row.jump_over_bound < 1.5 && !row.repeats, "{row:?}");
        }
        let far = measure_at(&baselines[1], 4_000_000);
        assert!(far.distinct_mean < 4.0 && far.stuck > 0.9 && far.jump_over_bound > 5.0, "{far:?}");
    }
}
