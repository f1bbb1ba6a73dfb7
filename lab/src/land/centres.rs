//! Whether islands lie on a lattice: the autocorrelation of their centres.
//!
//! 1. Centres are the centroids of islands of at least 0.05 km² on a grid of 128 m. Those of
//!    islands of at least 1 km² are a second set: small islands would hide a lattice of large ones.
//! 2. The differences of all pairs of centres, the pairs of each centre with itself included, are
//!    counted in bins of 512 m. Each is divided by the share of the square in which such a
//!    difference can lie.
//! 3. The counts are blurred, as if every centre were spread over a Gaussian with a standard
//!    deviation of 0.04, 0.08 or 0.16 of the mean distance `1/sqrt(density)`. Lattices with much
//!    jitter show with the widest; a wider one would make a peak of the scatter of independent
//!    centres.
//! 4. The counts are compared with the mean density `r`:
//!    `A(lag) = (pairs(lag) - r) / (pairs(0) - r)`, where `pairs(0)` is that of the centres with
//!    themselves. A perfect lattice has 1 at its own vectors, independent centres have about 0.
//! 5. The figure is the highest local maximum with a lag of 2 to 65 km, of both sets and all
//!    spreads. Clusters of islands widen the middle of `A` and are no local maximum.

use super::field::{Window, carried};
use super::labels::{Region, label};
use serde::Serialize;
use std::ops::RangeInclusive;
use terrain::Land;

/// Level of the grid, and its vertices along a side: 128 m and 524 km.
const LEVEL: u8 = 6;
const SIDE: usize = 4096;

/// Smallest islands of the two sets of centres, km².
const LEAST_KM2: [f64; 2] = [0.05, 1.0];

/// Side of a bin, km.
const BIN_KM: f64 = 0.512;

/// Lags of the figure, km.
const LAG_KM: RangeInclusive<f64> = 2.0..=65.0;

/// A local maximum is the highest bin within this many bins along each axis.
const MAXIMUM_RADIUS_BINS: usize = 3;

/// Standard deviations over which centres are spread, in mean distances.
const SPREADS: [f64; 3] = [0.04, 0.08, 0.16];

/// The strongest peak outside 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    /// Its height: 1 for a lattice.
    pub height: f64,
    /// Its lag, km east and south.
    pub lag_km: [f64; 2],
    /// The spread that shows it, km.
    pub spread_km: f64,
}

/// Centres of islands in a square.
#[derive(Clone, Debug)]
pub struct CentreSet {
    /// Distances east and south of the low corner, km.
    pub centres: Vec<[f64; 2]>,
    /// Side of the square, km.
    pub side_km: f64,
}

/// Centres of the islands around a place (units): one set for each of the two sizes.
pub fn island_centres(land: &Land, (x, z): (i32, i32)) -> [CentreSet; 2] {
    let mut window = Window { x, z, level: LEVEL, side: SIDE, border: 0 };
    let half = SIDE as i32 / 2 * window.step();
    (window.x, window.z) = (x - half, z - half);
    let mask: Vec<bool> = carried(land, &window).into_iter().map(|height| height > 0.0).collect();
    let spacing_km = window.spacing_m() * 1e-3;
    let labels = label(&mask, SIDE, false);
    LEAST_KM2.map(|least_km2| {
        let least_points = least_km2 / (spacing_km * spacing_km);
        let is_island = |region: &&Region| region.is_set && region.points as f64 >= least_points;
        let islands = labels.regions.iter().filter(is_island);
        let centres = islands.map(|region| region.centroid().map(|steps| steps * spacing_km)).collect();
        CentreSet { centres, side_km: SIDE as f64 * spacing_km }
    })
}

/// The strongest peak of all sets together; none without centres.
pub fn peak(sets: &[CentreSet]) -> Option<Peak> {
    strongest(SPREADS.into_iter().filter_map(|spread| peak_of(sets, spread)))
}

/// The highest of several peaks.
pub fn strongest(peaks: impl Iterator<Item = Peak>) -> Option<Peak> {
    peaks.max_by(|one, other| one.height.total_cmp(&other.height))
}

fn peak_of(sets: &[CentreSet], spread: f64) -> Option<Peak> {
    let correlation = Autocorrelation::of(sets, spread)?;
    let bins = MAXIMUM_RADIUS_BINS..correlation.side - MAXIMUM_RADIUS_BINS;
    let lags = bins.clone().flat_map(|row| bins.clone().map(move |column| (column, row)));
    let maxima = lags.filter(|lag| correlation.is_in_range(*lag) && correlation.is_maximum(*lag));
    let best = maxima.max_by(|one, other| correlation.at(*one).total_cmp(&correlation.at(*other)))?;
    let height = correlation.at(best);
    let lag_km = [best.0, best.1].map(|bin| correlation.lag_km(bin));
    height.is_finite().then_some(Peak { height, lag_km, spread_km: correlation.spread_km })
}

/// `A(lag)` of the module, over bins of the lag.
struct Autocorrelation {
    /// Row-major; the lag 0 is in the middle.
    values: Vec<f64>,
    /// Bins along a side.
    side: usize,
    /// Standard deviation over which centres are spread, km.
    spread_km: f64,
}

impl Autocorrelation {
    /// That of several sets together, with a spread in mean distances; none without centres.
    fn of(sets: &[CentreSet], spread: f64) -> Option<Self> {
        let islands: f64 = sets.iter().map(|set| set.centres.len() as f64).sum();
        let per_km2 = islands / sets.iter().map(|set| set.side_km * set.side_km).sum::<f64>();
        if per_km2.is_nan() || per_km2 == 0.0 {
            return None;
        }
        let (density, spread_km) = (per_km2 * BIN_KM * BIN_KM, spread / per_km2.sqrt());
        // The difference of two spread centres has twice the variance.
        let deviation = spread_km * std::f64::consts::SQRT_2 / BIN_KM;
        let weights = gaussian(deviation);
        let radius = weights.len() / 2;
        let reach = (LAG_KM.end() / BIN_KM) as usize + MAXIMUM_RADIUS_BINS + radius;
        let blurred = blurred(&differences(sets, reach), 2 * reach + 1, &weights);
        let with_itself = weights[radius] * weights[radius];
        let values =
            blurred.iter().map(|pairs| (pairs / islands - density) / (with_itself - density)).collect();
        Some(Self { values, side: 2 * (reach - radius) + 1, spread_km })
    }

    fn at(&self, (column, row): (usize, usize)) -> f64 {
        self.values[row * self.side + column]
    }

    fn lag_km(&self, bin: usize) -> f64 {
        (bin as f64 - (self.side / 2) as f64) * BIN_KM
    }

    fn is_in_range(&self, (column, row): (usize, usize)) -> bool {
        LAG_KM.contains(&self.lag_km(column).hypot(self.lag_km(row)))
    }

    /// Whether no bin within [`MAXIMUM_RADIUS_BINS`] is higher.
    fn is_maximum(&self, (column, row): (usize, usize)) -> bool {
        let near = |bin: usize| bin - MAXIMUM_RADIUS_BINS..=bin + MAXIMUM_RADIUS_BINS;
        let height = self.at((column, row));
        near(row).all(|other_row| near(column).all(|other| self.at((other, other_row)) <= height))
    }
}

/// Weights of a Gaussian up to 3.5 standard deviations (bins), with a sum of 1.
fn gaussian(deviation: f64) -> Vec<f64> {
    let radius = (3.5 * deviation).ceil() as usize;
    let weight = |bin: usize| (-0.5 * ((bin as f64 - radius as f64) / deviation).powi(2)).exp();
    let weights: Vec<f64> = (0..=2 * radius).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

/// Differences of all pairs in bins up to `reach`.
fn differences(sets: &[CentreSet], reach: usize) -> Vec<f64> {
    let side = 2 * reach + 1;
    let mut pairs = vec![0.0; side * side];
    // Only pairs within reach; all pairs of a square would be many times more.
    let farthest_km = (reach as f64 + 0.5) * BIN_KM;
    for set in sets {
        let mut centres = set.centres.clone();
        centres.sort_by(|one, other| one[0].total_cmp(&other[0]));
        for one in &centres {
            let first = centres.partition_point(|other| other[0] < one[0] - farthest_km);
            for other in centres[first..].iter().take_while(|other| other[0] <= one[0] + farthest_km) {
                let apart = [other[0] - one[0], other[1] - one[1]];
                let bins = apart.map(|km| (km / BIN_KM).round() + reach as f64);
                if bins.iter().any(|bin| *bin < 0.0 || *bin >= side as f64) {
                    continue;
                }
                let possible: f64 = apart.iter().map(|km| 1.0 - km.abs() / set.side_km).product();
                pairs[bins[1] as usize * side + bins[0] as usize] += 1.0 / possible;
            }
        }
    }
    pairs
}

/// A square map blurred along both axes, without its outermost bins, where the blur leaves it.
fn blurred(map: &[f64], side: usize, weights: &[f64]) -> Vec<f64> {
    let left = side + 1 - weights.len();
    let weigh = |start: usize, step: usize, map: &[f64]| -> f64 {
        weights.iter().enumerate().map(|(index, weight)| weight * map[start + index * step]).sum()
    };
    let mut rows = Vec::with_capacity(side * left);
    for row in 0..side {
        rows.extend((0..left).map(|column| weigh(row * side + column, 1, map)));
    }
    let mut both = Vec::with_capacity(left * left);
    for row in 0..left {
        both.extend((0..left).map(|column| weigh(row * left + column, left, &rows)));
    }
    both
}

/// Cells along a side of a synthetic set.
const CELLS: u32 = 32;

/// Side of a cell, km.
const CELL_KM: f64 = 16.0;

/// Control: sets with one centre in each cell of a lattice, at its middle up to a jitter of 10 % of
/// the cell.
pub fn jittered_lattices(count: u32) -> Vec<CentreSet> {
    synthetic(count, |cell, chance| (f64::from(cell) + 0.5 + 0.2 * (chance - 0.5)) * CELL_KM)
}

/// Control: sets of as many independent centres.
pub fn independent(count: u32) -> Vec<CentreSet> {
    synthetic(count, |_, chance| chance * f64::from(CELLS) * CELL_KM)
}

/// Sets of centres by a function from a cell's index and a random number of 0 to 1 to a coordinate.
fn synthetic(count: u32, coordinate_km: impl Fn(u32, f64) -> f64) -> Vec<CentreSet> {
    let set = |set: u32| {
        let centre = |cell: u32| {
            let chance = |part: u32| crate::sample::unit(crate::sample::word(0xce17 + set, 2 * cell + part));
            [coordinate_km(cell % CELLS, chance(0)), coordinate_km(cell / CELLS, chance(1))]
        };
        let centres = (0..CELLS * CELLS).map(centre).collect();
        CentreSet { centres, side_km: f64::from(CELLS) * CELL_KM }
    };
    (0..count).map(set).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lattice_has_1_a_jittered_one_less_and_independent_centres_nearly_0() {
        let places = (0..32).flat_map(|row| (0..32).map(move |column| (column, row)));
        let centres = places.map(|(column, row)| [column, row].map(|cell| f64::from(cell) * 16.0 + 5.0));
        let lattice = CentreSet { centres: centres.collect(), side_km: 512.0 };
        let found = peak(&[lattice]).unwrap();
        assert!((found.height - 1.0).abs() < 0.05, "{found:?}");
        let jittered = peak(&jittered_lattices(2)).unwrap();
        assert!((0.5..0.98).contains(&jittered.height), "{jittered:?}");
        assert!(
            jittered.lag_km.iter().all(|lag| (lag / 16.0 - (lag / 16.0).round()).abs() < 0.1),
            "{jittered:?}"
        );
        let independent = peak(&independent(2)).unwrap();
        assert!(independent.height < 0.12, "{independent:?}");
        assert!(peak(&[]).is_none());
    }

    #[test]
    fn the_home_island_has_its_centre_among_those_of_the_land() {
        let [all, large] = island_centres(&Land::new(1), (0, 0));
        assert!(all.centres.len() >= large.centres.len() && large.centres.len() > 1);
        let middle = all.side_km / 2.0;
        let is_home = |centre: &&[f64; 2]| (centre[0] - middle).hypot(centre[1] - middle) < 8.0;
        assert!(large.centres.iter().any(|centre| is_home(&centre)));
    }

    #[test]
    fn groups_of_islands_are_no_lattice() {
        let mut sets = independent(2);
        for set in &mut sets {
            let near = set.centres.iter().enumerate().map(|(index, [x, z])| {
                let turn = index as f64;
                [x + (1.0 + turn % 3.0) * turn.cos(), z + (1.0 + turn % 3.0) * turn.sin()]
            });
            let near: Vec<_> = near.collect();
            set.centres.extend(near);
        }
        let found = peak(&sets).unwrap();
        assert!(found.height < 0.15, "{found:?}");
    }
}
