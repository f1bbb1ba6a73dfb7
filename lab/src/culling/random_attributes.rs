//! Chi-square tests of the random attributes of plants: uniformity of every stream, independence of
//! every pair of streams.

use serde::Serialize;
use terrain::hash::mix;
use terrain::random_attributes::random_attributes;

/// Results for the streams of a meadow.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StreamTests {
    pub clumps: u64,
    /// Smallest p-value of any stream, of its high, its middle or its low bits.
    pub worst_stream_p: f64,
    /// Smallest p-value of any two streams.
    pub worst_pair_p: f64,
    /// Control, must fail: a stream cut from a hash of the cell alone.
    pub poor_stream_p: f64,
    /// Control, must fail: two streams that share bits of one hash.
    pub poor_pair_p: f64,
}

/// Cells along a side of the meadow.
const SIDE: i32 = 64;

/// Clumps of a cell.
const PER_CELL: u32 = 16;

/// Tests the clumps of a meadow around the origin of a world.
pub fn test(seed: u32) -> StreamTests {
    let half = SIDE / 2;
    let cells = (-half..half).flat_map(|z| (-half..half).map(move |x| (x, z)));
    let meadow: Vec<[u32; 6]> = cells
        .flat_map(|(x, z)| (0..PER_CELL).map(move |index| random_attributes(seed, 0, x, z, index)))
        .map(|plant| [plant.place, plant.width, plant.height, plant.hue, plant.phase, plant.survival])
        .collect();
    let least = f64::min;
    let single = (0..6).flat_map(|stream| [24, 13, 0].map(|shift| (stream, shift)));
    let of_stream = |(stream, shift): (usize, u32)| {
        probability(meadow.iter().map(|words| (words[stream] >> shift) as usize & 255))
    };
    let pairs = (0..6).flat_map(|a| (a + 1..6).map(move |b| (a, b)));
    let of_pair = |(a, b): (usize, usize), (high, low): (u32, u32)| {
        probability(
            meadow.iter().map(|words| (((words[a] >> high) & 15) * 16 + ((words[b] >> low) & 15)) as usize),
        )
    };
    let shifts = [(28, 28), (28, 0), (0, 28), (0, 0), (13, 13)];
    StreamTests {
        clumps: meadow.len() as u64,
        worst_stream_p: single.map(of_stream).fold(1.0, least),
        worst_pair_p: pairs.flat_map(|pair| shifts.map(|shift| of_pair(pair, shift))).fold(1.0, least),
        poor_stream_p: probability((0..meadow.len()).map(|n| mix(n as u32 / PER_CELL) as usize & 255)),
        poor_pair_p: probability(
            meadow.iter().map(|words| ((words[0] >> 28) * 16 + ((words[0] >> 26) & 15)) as usize),
        ),
    }
}

/// p-value of the chi-square test for 256 equally likely bins, by the cube-root approximation
/// (Wilson and Hilferty, PNAS 17, 1931).
fn probability(values: impl Iterator<Item = usize>) -> f64 {
    let mut counts = [0u32; 256];
    values.for_each(|value| counts[value] += 1);
    let expected = counts.iter().sum::<u32>() as f64 / 256.0;
    let chi_square: f64 = counts.iter().map(|count| (f64::from(*count) - expected).powi(2) / expected).sum();
    let spread = 2.0 / (9.0 * 255.0);
    upper_tail(((chi_square / 255.0).cbrt() - (1.0 - spread)) / f64::sqrt(spread))
}

/// Share of the normal distribution beyond `x` standard deviations, by Simpson's rule.
fn upper_tail(x: f64) -> f64 {
    let (from, steps) = (x.max(-9.0), 2000);
    let step = (12.0 - from.min(11.0)) / f64::from(steps);
    let density = |n: i32| (-0.5 * (from + step * f64::from(n)).powi(2)).exp();
    let weight = |n: i32| {
        if n == 0 || n == steps {
            1.0
        } else if n % 2 == 1 {
            4.0
        } else {
            2.0
        }
    };
    let sum: f64 = (0..=steps).map(|n| weight(n) * density(n)).sum();
    sum * step / 3.0 / f64::sqrt(std::f64::consts::TAU)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_tails_equal_published_tables() {
        for (x, p) in [(0.0, 0.5), (1.644_854, 0.05), (3.090_232, 0.001), (-1.0, 0.841_344_7)] {
            assert!((upper_tail(x) / p - 1.0).abs() < 1e-4, "{x}: {}", upper_tail(x));
        }
    }

    #[test]
    fn streams_pass_and_correlated_streams_fail() {
        let tests = test(7);
        assert!(tests.worst_stream_p >= 0.001 && tests.worst_pair_p >= 0.001, "{tests:?}");
        assert!(tests.poor_stream_p < 1e-6 && tests.poor_pair_p < 1e-6, "{tests:?}");
    }
}
