//! Whether islands lie on a lattice: the autocorrelation of their centres.
//!
//! Centres are the centroids of islands of at least 0.05 km² on a grid of 128 m. Differences of all
//! pairs, the pairs of each centre with itself included, are counted in bins of 512 m, each
//! divided by the share of the square in which such a difference can lie, blurred, and compared
//! with the mean density `r`: `A(lag) = (pairs(lag) - r) / (pairs(0) - r)`, where `pairs(0)` is
//! that of the centres with themselves. A perfect lattice has 1 at its own vectors, independent
//! centres about 0. The figure is the highest local maximum with a lag of 2 to 65 km.
//!
//! The blur is what spreading every centre over a Gaussian gives, whose deviation is 0.04, 0.08 or
//! 0.16 of the mean distance `1/sqrt(density)`. Lattices with much jitter show with the widest, and
//! a wider one would make the scatter of independent centres a peak. The centres of islands of
//! at least 1 km² are looked at by themselves too, so that a lattice does not hide among small
//! ones; the worst of all counts. Neighbours that crowd together make the middle of `A` wider and
//! are no maximum of their own.

use super::field::{Window, carried};
use super::labels::{Region, label};
use serde::Serialize;
use terrain::Land;

/// Level of the grid, and its vertices along a side: 128 m and 524 km.
const LEVEL: u8 = 6;
const SIDE: usize = 4096;

/// Smallest islands of the two sets of centres, km².
const LEAST_KM2: [f64; 2] = [0.05, 1.0];

/// Side of a bin, km.
const BIN_KM: f64 = 0.512;

/// Longest and shortest lag of the figure, km.
const LAGS_KM: (f64, f64) = (65.0, 2.0);

/// Bins around which a local maximum is the highest.
const AROUND: usize = 3;

/// Standard deviations by which centres are spread, in mean distances.
const SPREADS: [f64; 3] = [0.04, 0.08, 0.16];

/// The strongest peak outside 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    /// Its height: 1 for a lattice.
    pub height: f64,
    /// Where it is, km east and south.
    pub lag_km: [f64; 2],
    /// The spread that shows it, km.
    pub spread_km: f64,
}

/// Centres of islands in a square, km, and the side of the square.
#[derive(Clone, Debug)]
pub struct Square {
    /// East and south of the low corner.
    pub centres: Vec<[f64; 2]>,
    /// Side, km.
    pub side_km: f64,
}

/// The islands around a place (units): those of each of the two sizes.
pub fn of_land(land: &Land, (x, z): (i32, i32)) -> [Square; 2] {
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
        Square { centres, side_km: SIDE as f64 * spacing_km }
    })
}

/// The strongest peak of all squares together; none if they have no two centres.
pub fn peak(squares: &[Square]) -> Option<Peak> {
    strongest(SPREADS.into_iter().filter_map(|spread| peak_of(squares, spread)))
}

/// The highest of several peaks.
pub fn strongest(peaks: impl Iterator<Item = Peak>) -> Option<Peak> {
    peaks.max_by(|one, other| one.height.total_cmp(&other.height))
}

fn peak_of(squares: &[Square], spread: f64) -> Option<Peak> {
    let islands: f64 = squares.iter().map(|square| square.centres.len() as f64).sum();
    let per_km2 = islands / squares.iter().map(|square| square.side_km * square.side_km).sum::<f64>();
    if per_km2.is_nan() || per_km2 == 0.0 {
        return None;
    }
    let (density, spread_km) = (per_km2 * BIN_KM * BIN_KM, spread / per_km2.sqrt());
    // The difference of two spread centres varies twice as much.
    let deviation = spread_km * std::f64::consts::SQRT_2 / BIN_KM;
    let radius = (3.5 * deviation).ceil() as usize;
    let most = (LAGS_KM.0 / BIN_KM) as usize;
    let reach = most + AROUND + radius;
    let weights: Vec<f64> = (0..=2 * radius)
        .map(|bin| (-0.5 * ((bin as f64 - radius as f64) / deviation).powi(2)).exp())
        .collect();
    let sum: f64 = weights.iter().sum();
    let weights: Vec<f64> = weights.into_iter().map(|weight| weight / sum).collect();
    let pairs = differences(squares, reach);
    let own = weights[radius] * weights[radius];
    let map = blurred(&pairs, 2 * reach + 1, &weights);
    let side = 2 * (reach - radius) + 1;
    let at = |column: usize, row: usize| (map[row * side + column] / islands - density) / (own - density);
    let middle = reach - radius;
    let lag_km = |bin: usize| (bin as f64 - middle as f64) * BIN_KM;
    let places =
        (AROUND..side - AROUND).flat_map(|row| (AROUND..side - AROUND).map(move |column| (column, row)));
    let far =
        places.filter(|(column, row)| (LAGS_KM.1..=LAGS_KM.0).contains(&lag_km(*column).hypot(lag_km(*row))));
    let maxima = far.filter(|(column, row)| {
        let near = |middle: usize| middle - AROUND..=middle + AROUND;
        let height = at(*column, *row);
        near(*row).all(|other_row| near(*column).all(|other| at(other, other_row) <= height))
    });
    let best = maxima.max_by(|one, other| at(one.0, one.1).total_cmp(&at(other.0, other.1)))?;
    let height = at(best.0, best.1);
    height.is_finite().then(|| Peak { height, lag_km: [best.0, best.1].map(lag_km), spread_km })
}

/// Differences of all pairs in bins up to `reach`.
fn differences(squares: &[Square], reach: usize) -> Vec<f64> {
    let side = 2 * reach + 1;
    let mut pairs = vec![0.0; side * side];
    // Only neighbours within reach: all pairs of a square are many times more.
    let farthest_km = (reach as f64 + 0.5) * BIN_KM;
    for square in squares {
        let mut centres = square.centres.clone();
        centres.sort_by(|one, other| one[0].total_cmp(&other[0]));
        for one in &centres {
            let first = centres.partition_point(|other| other[0] < one[0] - farthest_km);
            for other in centres[first..].iter().take_while(|other| other[0] <= one[0] + farthest_km) {
                let apart = [other[0] - one[0], other[1] - one[1]];
                let bins = apart.map(|km| (km / BIN_KM).round() + reach as f64);
                if bins.iter().any(|bin| *bin < 0.0 || *bin >= side as f64) {
                    continue;
                }
                let possible: f64 = apart.iter().map(|km| 1.0 - km.abs() / square.side_km).product();
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

/// Squares of synthetic centres, the controls: as many places as a lattice of 16 km has, there
/// with a jitter of 10 % of its cell, and anywhere.
pub fn synthetic(count: u32, is_lattice: bool) -> Vec<Square> {
    const CELLS: u32 = 32;
    const CELL_KM: f64 = 16.0;
    let of = |square: u32| {
        let centres = (0..CELLS * CELLS).map(|cell| {
            let chance =
                |part: u32| crate::sample::unit(crate::sample::word(0xce17 + square, 2 * cell + part));
            let place = |cell: u32, chance: f64| {
                if is_lattice {
                    (f64::from(cell) + 0.5 + 0.2 * (chance - 0.5)) * CELL_KM
                } else {
                    chance * f64::from(CELLS) * CELL_KM
                }
            };
            [place(cell % CELLS, chance(0)), place(cell / CELLS, chance(1))]
        });
        Square { centres: centres.collect(), side_km: f64::from(CELLS) * CELL_KM }
    };
    (0..count).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lattice_has_1_a_jittered_one_less_and_independent_centres_nearly_0() {
        let places = (0..32).flat_map(|row| (0..32).map(move |column| (column, row)));
        let centres = places.map(|(column, row)| [column, row].map(|cell| f64::from(cell) * 16.0 + 5.0));
        let lattice = Square { centres: centres.collect(), side_km: 512.0 };
        let found = peak(&[lattice]).unwrap();
        assert!((found.height - 1.0).abs() < 0.05, "{found:?}");
        let jittered = peak(&synthetic(2, true)).unwrap();
        assert!((0.5..0.98).contains(&jittered.height), "{jittered:?}");
        assert!(
            jittered.lag_km.iter().all(|lag| (lag / 16.0 - (lag / 16.0).round()).abs() < 0.1),
            "{jittered:?}"
        );
        let independent = peak(&synthetic(2, false)).unwrap();
        assert!(independent.height < 0.12, "{independent:?}");
        assert!(peak(&[]).is_none());
    }

    #[test]
    fn the_home_island_has_its_centre_among_those_of_the_land() {
        let [all, large] = of_land(&Land::new(1), (0, 0));
        assert!(all.centres.len() >= large.centres.len() && large.centres.len() > 1);
        let middle = all.side_km / 2.0;
        let is_home = |centre: &&[f64; 2]| (centre[0] - middle).hypot(centre[1] - middle) < 8.0;
        assert!(large.centres.iter().any(|centre| is_home(&centre)));
    }

    #[test]
    fn groups_of_islands_are_no_lattice() {
        let mut squares = synthetic(2, false);
        for square in &mut squares {
            let near = square.centres.iter().enumerate().map(|(index, [x, z])| {
                let turn = index as f64;
                [x + (1.0 + turn % 3.0) * turn.cos(), z + (1.0 + turn % 3.0) * turn.sin()]
            });
            let near: Vec<_> = near.collect();
            square.centres.extend(near);
        }
        let found = peak(&squares).unwrap();
        assert!(found.height < 0.15, "{found:?}");
    }
}
