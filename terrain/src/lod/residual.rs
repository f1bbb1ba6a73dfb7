//! How far the triangles of a fine level can be from the land, by interval arithmetic over the base
//! lattice.
//!
//! A triangle of level 1 to 3 lies in one cell of the base lattice. There the land is
//! `coast(S + R F, E)`: splines `S`, `R`, `E` of 3 x 3 nodes, which lie in the hull of their nodes
//! and whose derivatives lie in the hull of the nodes' differences, and the fine octaves `F`. With
//! the vertex spacing `s`, a point of a right triangle is at most `0.7072 s` from its vertices in
//! their mean, and the mean square of the distances is at most `s² / 2`. So a function with gradient
//! `g` is at most `0.7072 s g` from its linear interpolation, and one with second derivatives up to
//! `d` at most `d s² / 4` (Waldron, "The error in linear interpolation at the vertices of a
//! simplex", 1998).
//!
//! Lengths are 2^-16 m here; shares are Q15.

use crate::constants::{BEACH_M, CELLS, CLIFF_M, FINE_BITS, UNIT_BITS};
use crate::key::ChunkKey;
use crate::land::Land;
use crate::simd::{Kernel, nodes};
use crate::spline::{self, CELL_BITS};

/// Bound of the fine octaves, 2^-16 m: `0.7072 (16 + 8 + 4 + 2 + 1)` m.
const FINE: i64 = 1_437_000;

/// Bound of the fine octaves against their linear interpolation between the vertices of levels 1, 2
/// and 3, 2^-16 m: 1.14, 3.62 and 7.66 m.
///
/// An octave of amplitude `a` and cell `c = 8 a / m` is off by at most the least of `1.4144 a` (its
/// range), `0.7072 s 2.08 a / c` (its gradient) and `9.4 a / c² s² / 4` (its second derivative); an
/// octave that the level drops by `0.7072 a`. The constants of gradient noise, 2.08 and 9.4, are
/// maxima over all gradients (tested).
const FINE_ERROR: [i64; 4] = [0, 75_000, 238_000, 502_000];

/// Bound of the fine octaves' gradient, Q8: five octaves of `2.08 / 8`, 1.3.
const FINE_SLOPE_Q8: i64 = 333;

/// Largest difference between two points of a beach beyond that of their raw heights, 2^-16 m:
/// twice `0.229` of 8 m.
const BEACH_BEND: i64 = 241_000;

/// Largest slopes of a beach and of a cliff, Q8: 1.64 and 7.375.
const BEACH_SLOPE_Q8: i64 = 420;
const CLIFF_SLOPE_Q8: i64 = 1_888;

/// Bound of the distance between the triangles of a level (1 to 3) and level-0 vertices, anywhere in
/// a chunk of a coarser level, units. Evaluates the nodes of the chunk.
#[must_use]
pub(super) fn residual(land: &Land, key: ChunkKey, level: u8) -> u32 {
    let (x, z) = key.origin();
    let cells = (key.side() >> CELL_BITS) as usize;
    let columns = cells + 2;
    let (mut heights, mut shares) = (vec![0; columns * columns], vec![0; columns * columns]);
    let first = (spline::cell(x).0 - 1, spline::cell(z).0 - 1);
    nodes(Kernel::best(), land, first, columns, &mut heights, &mut shares);
    let mut worst = 0;
    for row in 0..cells {
        for column in 0..cells {
            let at = |x: usize, z: usize| (row + z) * columns + column + x;
            let patch = Patch {
                heights: std::array::from_fn(|z| std::array::from_fn(|x| i64::from(heights[at(x, z)]))),
                roughness: Range::of(|n| shares[at(n % 3, n / 3)] & 0xffff),
                exposure: Range::of(|n| shares[at(n % 3, n / 3)] >> 16),
            };
            worst = worst.max(patch.error(level));
        }
    }
    // Rounded up to units, and one more for the roundings of both heights.
    ((worst >> (FINE_BITS - UNIT_BITS)) + 2) as u32
}

/// The least and the largest of nine shares, Q15.
struct Range {
    low: i64,
    high: i64,
}

impl Range {
    fn of(share: impl Fn(usize) -> i32) -> Self {
        let all = (0..9).map(|n| i64::from(share(n)));
        let (low, high) = all.fold((i64::MAX, 0), |(low, high), share| (low.min(share), high.max(share)));
        Self { low, high }
    }

    const fn width(&self) -> i64 {
        self.high - self.low
    }
}

/// The 3 x 3 nodes of a cell.
struct Patch {
    heights: [[i64; 3]; 3],
    roughness: Range,
    exposure: Range,
}

impl Patch {
    /// See [`residual`], 2^-16 m.
    fn error(&self, level: u8) -> i64 {
        let [a, b, c] = self.heights;
        if self.roughness.high == 0 && a == b && b == c && a[0] == a[1] && a[1] == a[2] {
            return 0;
        }
        // The vertex spacing is 2^-spacing_bits of a cell.
        let spacing_bits = 4 - u32::from(level);
        let rows = self.heights;
        let columns: [[i64; 3]; 3] = std::array::from_fn(|x| rows.map(|row| row[x]));
        let step = |lines: &[[i64; 3]; 3]| {
            lines.iter().flat_map(|[a, b, c]| [(b - a).abs(), (c - b).abs()]).fold(0, i64::max)
        };
        let bend =
            |lines: &[[i64; 3]; 3]| lines.iter().map(|[a, b, c]| (a - 2 * b + c).abs()).fold(0, i64::max);
        let twist = (0..4).map(|n| {
            let (x, z) = (n % 2, n / 2);
            (rows[z][x] - rows[z][x + 1] - rows[z + 1][x] + rows[z + 1][x + 1]).abs()
        });
        // Differences across one cell: two vertices and more are nearer.
        let slope = step(&rows) + step(&columns);
        let bend = bend(&rows).max(bend(&columns)) + twist.max().unwrap_or(0);
        // Shares change by at most the range of their nodes across a cell; on both axes twice that.
        let change = |range: &Range| (2 * range.width() * 3) >> (2 + spacing_bits);
        let rough = |length: i64| (length * self.roughness.high) >> 15;
        let uneven = (FINE * change(&self.roughness)) >> 15;
        let raw = (bend >> (2 + 2 * spacing_bits)) + rough(FINE_ERROR[usize::from(level)]) + uneven;
        let cliff = i64::from(CLIFF_M) << FINE_BITS;
        let exposed = (cliff * change(&self.exposure)) >> 15;
        let (low, high) = rows
            .as_flattened()
            .iter()
            .fold((i64::MAX, i64::MIN), |(low, high), height| (low.min(*height), high.max(*height)));
        let beach = i64::from(BEACH_M) << FINE_BITS;
        let around = rough(FINE);
        if low - around > beach {
            return raw + exposed;
        }
        if high + around < -beach {
            return raw;
        }
        // Near sea level: what the raw height may change over a triangle, through the coast.
        let fine = rough((FINE_SLOPE_Q8 << (CELL_BITS + FINE_BITS - UNIT_BITS)) >> 8);
        let variation = (((slope + fine) * 3) >> (2 + spacing_bits)) + uneven;
        let factor = BEACH_SLOPE_Q8 + (((CLIFF_SLOPE_Q8 - BEACH_SLOPE_Q8) * self.exposure.high) >> 15);
        let steep = (variation * factor) >> 8;
        let capped = variation + BEACH_BEND + ((cliff * self.exposure.high) >> 15);
        steep.min(capped) + exposed
    }
}

/// Cells of the base lattice along a chunk are whole from level 0 on.
const _: () = assert!(CELLS << crate::constants::SPACING_BITS >= 1 << CELL_BITS);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::GRADIENTS;

    /// The triangles of fine chunks are nowhere farther from level 0 than the bound, and it says
    /// something.
    #[test]
    fn triangles_stay_within_the_bound() {
        for level in 2..=3u8 {
            let (mut worst, mut bound) = (0, 0);
            for (seed, x, z) in (0..6).flat_map(|seed| (0..9).map(move |n| (seed, n % 3 - 1, n / 3 - 1))) {
                let land = Land::new(seed);
                let key = ChunkKey::new(3, 2 * x, 2 * z).unwrap();
                let limit = residual(&land, key, level);
                let inside = std::iter::successors(Some(vec![key]), |keys| {
                    Some(keys.iter().filter_map(|key| key.children()).flatten().collect())
                });
                for fine in inside.take(2).flatten().filter(|fine| fine.level() == level) {
                    let error = land.error_of(fine);
                    assert!(error <= limit, "{fine} in {key}: {error} beyond {limit}");
                    worst = worst.max(error);
                }
                bound = bound.max(limit);
            }
            assert!(worst * 5 > bound, "level {level}: {worst} says little about {bound}");
        }
    }

    /// Largest gradient and second derivative of gradient noise over all gradients: both are linear
    /// in the four gradients, so the largest is the sum of the lengths of four vectors.
    #[test]
    fn the_constants_of_gradient_noise_are_bounds() {
        let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let slope = |t: f64| 30.0 * t * t * (t - 1.0) * (t - 1.0);
        let bend = |t: f64| 60.0 * t * (2.0 * t * t - 3.0 * t + 1.0);
        let side = |t: f64, high: bool| {
            let sign = if high { 1.0 } else { -1.0 };
            let low = if high { 0.0 } else { 1.0 };
            (low + sign * fade(t), sign * slope(t), sign * bend(t), if high { t - 1.0 } else { t })
        };
        let (mut steepest, mut most_bent) = (0f64, 0f64);
        for i in 0..=100 {
            for j in 0..=100 {
                let (x, z) = (f64::from(i) / 100.0, f64::from(j) / 100.0);
                for angle in 0..16 {
                    let (s, c) = (f64::from(angle) * std::f64::consts::PI / 16.0).sin_cos();
                    let (mut gradient, mut second) = (0.0, 0.0);
                    for corner in 0..4 {
                        let (wx, dx, ddx, px) = side(x, corner % 2 == 1);
                        let (wz, dz, ddz, pz) = side(z, corner / 2 == 1);
                        // w(x, z) (g . p) along the direction (c, s): first and second derivative.
                        let (w1, w2) = (
                            c * dx * wz + s * wx * dz,
                            c * c * ddx * wz + 2.0 * c * s * dx * dz + s * s * wx * ddz,
                        );
                        let w = wx * wz;
                        gradient += (w1 * px + w * c).hypot(w1 * pz + w * s);
                        second += (w2 * px + 2.0 * w1 * c).hypot(w2 * pz + 2.0 * w1 * s);
                    }
                    steepest = steepest.max(gradient);
                    most_bent = most_bent.max(second);
                }
            }
        }
        assert!(steepest < 2.08 && steepest > 2.0, "{steepest}");
        assert!(most_bent < 9.4 && most_bent > 9.0, "{most_bent}");
        assert!(GRADIENTS.iter().all(|(x, z)| f64::from(*x).hypot(f64::from(*z)) < 32_769.0));
    }
}
