//! How steep the land can be: the bound that every step of a sweep is held against.
//!
//! **One octave.** With step weights `S0 = 1 - s`, `S1 = s` (quintic fade `s` of the fraction `t`
//! east, `u` south) and unit gradients `g`, noise is
//! `n = sum over corners (i, j) of S_i(t) S_j(u) g·(t - i, u - j)`. Its slope east is
//!
//! ```text
//! dn/dt = sum of S_j(u) g·( S_i(t) + S_i'(t)(t - i),  S_i'(t)(u - j) )
//!      <= sum of S_j(u) |( S_i(t) + S_i'(t)(t - i),  S_i'(t)(u - j) )|  =: B(t, u)
//! ```
//!
//! for any gradients. `B` is largest in the middle of a cell, 2.0691; [`NOISE_SLOPE`] is
//! above it by more than a search on a grid can have missed (a test does the search). South is the
//! same with the axes exchanged.
//!
//! **The sum.** An octave of amplitude `a` and cell `c` adds at most `2.08 a / c`, and `a / c` is
//! 1/8 for every octave. So hills are no steeper than `2.08 k / 8` with `k` octaves, folds (two
//! octaves) no steeper than `2.08 / 4`, and ridges (`64 m (1 - |folds| / 64 m)²`) twice that. One
//! octave stays below `0.7072 a`, hence `|hills| < H = 0.7072 * 255 m`.
//!
//! **The shape.** At `q = d / r` of an island of radius `r` and dome `D`: `w = (1 - q²)²`, and its
//! slope is at most `v = 4 q (1 - q²) / r`. By the product rule
//!
//! ```text
//! |slope of raw| <= D v  +  2.08 ease(w) + H 2 (1 - w) v  +  1.04 w² + 64 m 2 w v
//! ```
//!
//! which [`land_slope`] maximises over `q`. The beach multiplies a slope by at most 1.64 (at
//! `r² = 0.6` of its polynomial). The product is below 5.6 for every island, and 0 outside of all.
//!
//! **A step.** Heights are whole units and within [`HEIGHT_ERROR`] of the formula, so a step of `n`
//! units along an axis changes them by at most `n slope + 2 HEIGHT_ERROR`.

use crate::reference_f64::{amplitude_m, cell_m, ease_out};
use terrain::constants::{OCTAVES, RIDGE_M};
use terrain::island::Island;

/// Upper bound of the slope, along an axis, of one octave of amplitude 1 and cell 1.
pub const NOISE_SLOPE: f64 = 2.08;

/// Upper bound of one octave of amplitude 1: all four gradients towards the middle of the cell give
/// `√½`.
pub const NOISE_VALUE: f64 = 0.7072;

/// Upper bound of the slope of the beach polynomial: `0.2 + 4.8 r² - 4 r⁴` at `r² = 0.6`.
pub const BEACH_SLOPE: f64 = 1.64;

/// How far an integer height may be from the formula, units: the bar of 1/128 m, half a unit of
/// final rounding included.
pub const HEIGHT_ERROR: f64 = 2.0;

/// Slope bound of the fractal sum, metres per metre.
pub fn hills_slope() -> f64 {
    (0..OCTAVES).map(|octave| NOISE_SLOPE * amplitude_m(octave) / cell_m(octave)).sum()
}

/// Slope bound along an axis anywhere on an island, metres per metre.
pub fn land_slope(island: &Island) -> f64 {
    // Per unit of `q` the sum changes by less than 16 (hills 6.5, ridges 3.3, the rest below 5 for
    // radii of 1,536 m and more), so a search in steps of 1/512 misses less than 16 / 1024.
    const STEPS: u32 = 512;
    const MISSED: f64 = 0.016;
    let worst =
        (0..=STEPS).map(|step| raw_slope(island, f64::from(step) / f64::from(STEPS))).fold(0.0, f64::max);
    BEACH_SLOPE * (worst + MISSED)
}

/// Slope bound of the land before the beach, at `q` radii from the middle.
fn raw_slope(island: &Island, q: f64) -> f64 {
    let (ridge_m, dome_m) = (f64::from(RIDGE_M), f64::from(island.dome_m));
    let folds_slope: f64 =
        [1, 2].map(|octave| NOISE_SLOPE * amplitude_m(octave) / cell_m(octave)).iter().sum();
    let hills_m: f64 = (0..OCTAVES).map(|octave| NOISE_VALUE * amplitude_m(octave)).sum();
    let inside = 1.0 - q * q;
    let weight = inside * inside;
    let falling = 4.0 * q * inside / f64::from(island.radius_m);
    dome_m * falling
        + hills_slope() * ease_out(weight)
        + hills_m * 2.0 * (1.0 - weight) * falling
        + 2.0 * folds_slope * weight * weight
        + ridge_m * 2.0 * weight * falling
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference_f64::{ReferenceF64, fade};
    use crate::sample;
    use terrain::Octaves;
    use terrain::island::Archipelago;

    /// `B(t, u)` of the module's proof.
    fn noise_slope_at(t: f64, u: f64) -> f64 {
        let fall = 30.0 * t * t * (t - 1.0) * (t - 1.0);
        let (steps_east, steps_south) = ([1.0 - fade(t), fade(t)], [1.0 - fade(u), fade(u)]);
        let mut sum = 0.0;
        for (j, south) in steps_south.into_iter().enumerate() {
            for (i, (east, slope)) in steps_east.into_iter().zip([-fall, fall]).enumerate() {
                sum += south * (east + slope * (t - i as f64)).hypot(slope * (u - j as f64));
            }
        }
        sum
    }

    #[test]
    fn no_place_in_a_cell_is_steeper_than_the_bound() {
        // B is symmetric in both axes, and its own slopes are below 23 (t) and 12 (u): half a step
        // of the search misses less than 35 / 2 / 2000.
        const STEPS: u32 = 1000;
        let mut worst: f64 = 0.0;
        for t in 0..=STEPS {
            for u in 0..=STEPS {
                worst = worst.max(noise_slope_at(f64::from(t) / 2000.0, f64::from(u) / 2000.0));
            }
        }
        assert!(worst + 35.0 / 4000.0 < NOISE_SLOPE, "{worst}");
        assert!(worst > 2.06, "a bound far above what exists would prove little");
    }

    #[test]
    fn every_island_is_flatter_than_5_6() {
        let archipelago = Archipelago::new(3);
        let slopes: Vec<f64> = (-9..9)
            .flat_map(|x| (-9..9).map(move |z| (x, z)))
            .filter_map(|(x, z)| archipelago.island(x, z))
            .map(|island| land_slope(&island))
            .collect();
        let (low, high) = slopes.iter().fold((9.0f64, 0.0f64), |(low, high), s| (low.min(*s), high.max(*s)));
        assert!(low > 5.0 && high < 5.6, "{low} to {high}");
    }

    #[test]
    fn the_truth_never_climbs_faster_than_its_island_allows() {
        let (reference, archipelago) = (ReferenceF64::new(6), Archipelago::new(6));
        let mut steepest: f64 = 0.0;
        for (x, z) in sample::land_points(6, 1_000, 2) {
            let Some(island) = archipelago.island_at(x, z) else { continue };
            let rise = |dx, dz| {
                (reference.height_m(x + dx, z + dz, Octaves::ALL) - reference.height_m(x, z, Octaves::ALL))
                    .abs()
                    * 256.0
            };
            let slope = rise(1, 0).max(rise(0, 1));
            assert!(slope <= land_slope(&island), "{slope} at ({x}, {z})");
            steepest = steepest.max(slope);
        }
        assert!(steepest > 0.5, "{steepest}: a bound far above what exists would prove little");
    }
}
