//! Land forms within 3 km of the start: valley, ridge, cliff, beach, plain, wood.
//!
//! On the 16 m grid; "smoothed" is the mean of 5 x 5 vertices, whose outer ones are 64 m apart.
//!
//! - *Plain*: connected land of at least 4 ha, smoothed, flatter than 3 degrees, 1 to 200 m high.
//! - *Ridge*: a connected line, at least 300 m long, of places whose smoothed height is at least
//!   12 m above both places 96 m away on opposite sides, along an axis or a diagonal. The top of a
//!   round cone steeper than 24 degrees counts as one.
//! - *Valley*: the same 12 m below both sides, whose floor falls by at least 20 m along its length.
//! - *Cliff*, *beach*: at least 50 m of coast by the definitions of [`super::shore`].
//! - *Wood*: connected land of at least 1 ha, half of which or more is wooded everywhere by
//!   [`super::wood`], on every second vertex.

use super::coast;
use super::field::{Field, SPACING_M, VERTEX_KM2, Window};
use super::labels::{Labels, label};
use super::{shore, wood};
use terrain::constants::UNITS_PER_METRE;

/// Names of the features, in order.
pub const NAMES: [&str; 6] = ["valley", "ridge", "cliff", "beach", "plain", "wood"];

/// Distance from the start, metres.
const RADIUS_M: f64 = 3000.0;

/// Vertices to both sides of a ridge, and on a diagonal; the smoothing reaches 2 further.
const ACROSS: [usize; 2] = [6, 4];
const BLUR: usize = 2;
const BORDER: usize = ACROSS[0] + BLUR + 1;

/// Height of a ridge over its sides, metres.
const CREST_M: f32 = 12.0;
/// Length of a ridge or valley, and the fall of a valley, metres.
const LENGTH_M: f64 = 300.0;
const FALL_M: f32 = 20.0;
/// Areas of a plain and of a wood, km².
const PLAIN_KM2: f64 = 0.04;
const WOOD_KM2: f64 = 0.01;
/// Slope of a plain, degrees, and its heights, metres.
const PLAIN: (f64, std::ops::RangeInclusive<f32>) = (3.0, 1.0..=200.0);
/// Length of cliff and of beach, metres, and metres between points of the coast.
const SHORE_M: f64 = 50.0;
const EVERY_M: f64 = 10.0;

/// Which features lie near a start (units), in the order of [`NAMES`].
pub fn near(field: &dyn Field, start: (i32, i32)) -> [bool; 6] {
    let window = Window::around(start, 2 * (RADIUS_M / SPACING_M) as usize + 1, BORDER);
    let heights = field.heights(&window);
    let smooth = smoothed(&heights, window.side);
    let half = (window.side / 2) as f64;
    let distance_m = |column: f64, row: f64| (column - half).hypot(row - half) * SPACING_M;
    let is_near =
        |index: usize| distance_m((index % window.side) as f64, (index / window.side) as f64) <= RADIUS_M;
    let masked = |is_in: &dyn Fn(usize) -> bool| {
        let mut mask = vec![false; heights.len()];
        window.inner().filter(|index| is_near(*index)).for_each(|index| mask[index] = is_in(index));
        label(&mask, window.side, true)
    };
    let is_land = |index: usize| heights[index] > 0.0 && smooth[index] > 0.0;
    let ridges = masked(&|index| is_land(index) && is_crest(&smooth, window.side, index, 1.0));
    let valleys = masked(&|index| is_land(index) && is_crest(&smooth, window.side, index, -1.0));
    let flat = PLAIN.0.to_radians().tan();
    let plains = masked(&|index| {
        let [east, south] = window.gradient(&smooth, index);
        is_land(index) && PLAIN.1.contains(&smooth[index]) && east.hypot(south) < flat
    });
    let [cliffs_m, beaches_m] = shores(field, &window, &heights, distance_m);
    [
        lines(&valleys, &smooth, window.side)
            .any(|[length, fall]| length >= LENGTH_M && fall >= f64::from(FALL_M)),
        lines(&ridges, &smooth, window.side).any(|[length, _]| length >= LENGTH_M),
        cliffs_m >= SHORE_M,
        beaches_m >= SHORE_M,
        largest(&plains) * VERTEX_KM2 >= PLAIN_KM2,
        largest(&woods(&window, &heights, is_near)) * 4.0 * VERTEX_KM2 >= WOOD_KM2,
    ]
}

/// Means of 5 x 5 heights; the outermost two rows and columns stay as they are.
fn smoothed(heights: &[f32], side: usize) -> Vec<f32> {
    let along = |map: &[f32], step: usize| {
        let mut out = map.to_vec();
        for row in BLUR..side - BLUR {
            for column in BLUR..side - BLUR {
                let first = row * side + column - BLUR * step;
                let sum: f32 = (0..=2 * BLUR).map(|index| map[first + index * step]).sum();
                out[row * side + column] = sum / (2 * BLUR + 1) as f32;
            }
        }
        out
    };
    along(&along(heights, 1), side)
}

/// Whether a place is above (`sign` 1) or below (-1) both its sides along one of four directions.
fn is_crest(smooth: &[f32], side: usize, index: usize, sign: f32) -> bool {
    let [straight, diagonal] = ACROSS;
    let over = |other: usize| sign * (smooth[index] - smooth[other]) >= CREST_M;
    [straight, straight * side, diagonal * (side + 1), diagonal * (side - 1)]
        .into_iter()
        .any(|step| over(index - step) && over(index + step))
}

/// Length and fall of each set region, metres: the largest extent along an axis or a diagonal, and
/// the range of its heights.
fn lines(labels: &Labels, smooth: &[f32], side: usize) -> impl Iterator<Item = [f64; 2]> {
    let mut ranges = vec![[[f64::INFINITY, f64::NEG_INFINITY]; 5]; labels.regions.len()];
    for (index, region) in labels.of.iter().enumerate() {
        if !labels.regions[*region as usize].is_set {
            continue;
        }
        let (x, z) = ((index % side) as f64 * SPACING_M, (index / side) as f64 * SPACING_M);
        let turned = std::f64::consts::FRAC_1_SQRT_2;
        let values = [f64::from(smooth[index]), x, z, (x + z) * turned, (x - z) * turned];
        for ([low, high], value) in ranges[*region as usize].iter_mut().zip(values) {
            (*low, *high) = (low.min(value), high.max(value));
        }
    }
    ranges.into_iter().map(|ranges| {
        let [fall, extents @ ..] = ranges.map(|[low, high]| high - low);
        [extents.into_iter().fold(0.0, f64::max), fall]
    })
}

/// Points of the largest set region.
fn largest(labels: &Labels) -> f64 {
    labels.regions.iter().filter(|region| region.is_set).map(|region| region.points).max().unwrap_or(0) as f64
}

/// Metres of coast with a cliff and with a beach, of all land however small.
fn shores(
    field: &dyn Field,
    window: &Window,
    heights: &[f32],
    distance_m: impl Fn(f64, f64) -> f64,
) -> [f64; 2] {
    let mask: Vec<bool> = heights.iter().map(|height| *height > 0.0).collect();
    let mut coast = coast::segments(window, heights, &label(&mask, window.side, false));
    coast.retain(|segment| {
        let [column, row] = segment.middle();
        distance_m(column, row) <= RADIUS_M
    });
    let shores = shore::along(field, window, heights, &coast, EVERY_M);
    [shores.cliffs, shores.beaches].map(|points| points as f64 * EVERY_M)
}

/// Wooded places among every second vertex along both axes.
fn woods(window: &Window, heights: &[f32], is_near: impl Fn(usize) -> bool) -> Labels {
    let side = window.side / 2;
    let is_wooded = |index: usize| {
        let (column, row) = (2 * (index % side), 2 * (index / side));
        let index = row * window.side + column;
        if heights[index] <= 0.0 || !window.measures(column as f64, row as f64) || !is_near(index) {
            return false;
        }
        let (x, z) = window.position(column, row);
        let place = [x, z].map(|units| f64::from(units) / f64::from(UNITS_PER_METRE));
        wood::share(place, f64::from(heights[index]), window.gradient(heights, index)) >= 0.5
    };
    label(&(0..side * side).map(is_wooded).collect::<Vec<_>>(), side, true)
}

#[cfg(test)]
mod tests {
    use super::super::field::Formula;
    use super::*;
    use terrain::Land;

    fn found(field: impl Fn(f64, f64) -> f64 + Sync) -> Vec<&'static str> {
        let found = near(&Formula(field), (0, 0));
        NAMES.into_iter().zip(found).filter(|(_, is_there)| *is_there).map(|(name, _)| name).collect()
    }

    #[test]
    fn a_cut_cone_and_the_sea_have_nothing_and_a_table_near_the_sea_its_cliff() {
        assert_eq!(found(|_, _| -5.0), [""; 0]);
        assert_eq!(found(|x, z| ((2500.0 - x.hypot(z)) * 0.83).min(1000.0)), [""; 0]);
        assert_eq!(found(|x, z| if x.hypot(z) < 2000.0 { 700.0 } else { -20.0 }), ["cliff"]);
    }

    #[test]
    fn starts_have_all_six_and_the_open_sea_has_none() {
        // The last three have few plains or valleys, so their search is long.
        for seed in [0, 1, 2, 394, 1460, 2825] {
            let land = Land::new(seed);
            let start = land.start();
            assert_eq!(near(&land, (start.x, start.z)), [true; 6], "world {seed}");
        }
        let land = Land::new(3);
        assert_eq!(near(&land, (20_971_520, -37_748_736)), [false; 6]);
    }

    #[test]
    fn ridges_and_valleys_have_a_length_and_valleys_a_fall() {
        // A roof of 40 degrees, cut off at a length along z, over a high plain.
        let roof = |length: f64, sign: f64, fall: f64| {
            move |x: f64, z: f64| {
                let across = (150.0 - x.abs()).max(0.0) * 0.7;
                let along = if z.abs() < length / 2.0 { 1.0 } else { 0.0 };
                700.0 + fall * z + sign * across * along
            }
        };
        assert_eq!(found(roof(700.0, 1.0, 0.0)), ["ridge"]);
        assert_eq!(found(roof(150.0, 1.0, 0.0)), [""; 0]);
        assert_eq!(found(roof(700.0, -1.0, 0.1)), ["valley"]);
        assert_eq!(found(roof(150.0, -1.0, 0.1)), [""; 0]);
    }

    #[test]
    fn plains_beaches_and_woods_are_found_near_the_start_alone() {
        let island = |x: f64, z: f64, radius: f64| (radius - x.hypot(z)) * 0.1;
        assert_eq!(found(|x, z| island(x, z, 1000.0).min(20.0)), ["beach", "plain", "wood"]);
        assert_eq!(found(|x, z| island(x, z, 5000.0) + 200.0), [""; 0]);
        assert_eq!(found(|x, z| island(x - 4500.0, z, 1000.0).min(20.0)), [""; 0]);
    }
}
