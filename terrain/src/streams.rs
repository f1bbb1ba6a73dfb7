//! The random streams of a clump of plants: what is drawn by lot about it, from its cell and its
//! number there.
//!
//! Clumps are counted per cell of a grid that lies fixed in the world, not per chunk, so that
//! chunks of every level hold the same clumps. `shared/streams.wesl` is the twin on the GPU.

use crate::hash::mix;

/// What is drawn by lot about a clump: words that look unrelated to each other and to those of
/// every other clump.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Streams {
    /// Where in its cell.
    pub place: u32,
    /// How wide.
    pub width: u32,
    /// How high.
    pub height: u32,
    /// Which colour.
    pub hue: u32,
    /// When it swings.
    pub phase: u32,
    /// Whether it stands at all, and how long it keeps standing when the field is thinned.
    pub fate: u32,
}

/// The streams of clump number `index` of the cell `(x, z)`; `kind` tells fields of one seed apart.
///
/// Four words come out of the permutation pcg4d (Jarzynski and Olano, "Hash Functions for GPU
/// Rendering", JCGT 9(3), 2020), the others are hashes of two of them each.
#[must_use]
pub const fn streams(seed: u32, kind: u32, x: i32, z: i32, index: u32) -> Streams {
    let [a, b, c, d] = pcg4d([x as u32, z as u32, index ^ (kind << 16), seed]);
    Streams {
        place: a,
        width: b,
        height: c,
        hue: d,
        phase: mix(mix(a ^ 0x68bc_21eb) ^ d),
        fate: mix(mix(b ^ 0x02e5_be93) ^ c),
    }
}

/// A permutation of four words in which every output bit depends on every input bit: a linear
/// congruential step each, then twice every word plus the product of two others, with a shift
/// between.
const fn pcg4d(words: [u32; 4]) -> [u32; 4] {
    let mut v = [step(words[0]), step(words[1]), step(words[2]), step(words[3])];
    v = stir(v);
    v = [v[0] ^ (v[0] >> 16), v[1] ^ (v[1] >> 16), v[2] ^ (v[2] >> 16), v[3] ^ (v[3] >> 16)];
    stir(v)
}

const fn step(word: u32) -> u32 {
    word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)
}

/// Each word uses those before it as they have become.
const fn stir([mut x, mut y, mut z, mut w]: [u32; 4]) -> [u32; 4] {
    x = x.wrapping_add(y.wrapping_mul(w));
    y = y.wrapping_add(z.wrapping_mul(x));
    z = z.wrapping_add(x.wrapping_mul(y));
    w = w.wrapping_add(y.wrapping_mul(z));
    [x, y, z, w]
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 6] = ["place", "width", "height", "hue", "phase", "fate"];

    fn words(streams: Streams) -> [u32; 6] {
        [streams.place, streams.width, streams.height, streams.hue, streams.phase, streams.fate]
    }

    /// The clumps of a meadow around the origin, both signs: 16 in each of 64 x 64 cells.
    fn meadow() -> Vec<[u32; 6]> {
        let cells = (-32..32).flat_map(|z| (-32..32).map(move |x| (x, z)));
        cells.flat_map(|(x, z)| (0..16).map(move |index| words(streams(7, 0, x, z, index)))).collect()
    }

    /// Upper tail of the chi-square distribution by the cube-root approximation (Wilson and
    /// Hilferty, PNAS 17, 1931), as a standard deviation.
    fn deviation(chi_square: f64, degrees: f64) -> f64 {
        let spread = 2.0 / (9.0 * degrees);
        ((chi_square / degrees).cbrt() - (1.0 - spread)) / spread.sqrt()
    }

    /// p = 0.001 on one side.
    const REJECTED: f64 = 3.09;

    fn chi_square(values: impl Iterator<Item = usize>, bins: usize) -> f64 {
        let mut counts = vec![0u32; bins];
        let mut all = 0.0;
        for value in values {
            counts[value] += 1;
            all += 1.0;
        }
        let expected = all / bins as f64;
        let sum: f64 = counts.iter().map(|count| (f64::from(*count) - expected).powi(2) / expected).sum();
        deviation(sum, (bins - 1) as f64)
    }

    #[test]
    fn every_stream_is_even_in_its_high_its_low_and_its_middle_bits_and_the_test_can_fail() {
        let meadow = meadow();
        for (stream, name) in NAMES.iter().enumerate() {
            for shift in [24, 13, 0] {
                let off = chi_square(meadow.iter().map(|words| (words[stream] >> shift) as usize & 255), 256);
                assert!(off < REJECTED, "{name} >> {shift}: {off} standard deviations");
            }
        }
        // A stream that is cut out of a hash of the cell alone: sixteen clumps share each value.
        let poor = meadow.iter().enumerate().map(|(n, _)| mix(n as u32 / 16) as usize & 255);
        assert!(chi_square(poor, 256) > REJECTED);
    }

    #[test]
    fn no_two_streams_are_correlated_and_the_test_can_fail() {
        let meadow = meadow();
        for (a, first) in NAMES.iter().enumerate() {
            for (b, second) in NAMES.iter().enumerate().skip(a + 1) {
                for (high, low) in [(28, 28), (28, 0), (0, 28), (0, 0), (13, 13)] {
                    let pair = |words: &[u32; 6]| {
                        (((words[a] >> high) & 15) * 16 + ((words[b] >> low) & 15)) as usize
                    };
                    let off = chi_square(meadow.iter().map(pair), 256);
                    assert!(
                        off < REJECTED,
                        "{first} >> {high}, {second} >> {low}: {off} standard deviations"
                    );
                }
            }
        }
        // Two streams that are cut out of one hash with overlapping bits.
        let sliced = meadow.iter().map(|words| ((words[0] >> 28) * 16 + ((words[0] >> 26) & 15)) as usize);
        assert!(chi_square(sliced, 256) > REJECTED);
    }

    #[test]
    fn neighbours_in_cell_number_kind_and_seed_are_unrelated() {
        let of = |seed, kind, x, z, index| words(streams(seed, kind, x, z, index));
        let base = of(7, 0, 3, -4, 5);
        for other in [
            of(8, 0, 3, -4, 5),
            of(7, 1, 3, -4, 5),
            of(7, 0, 4, -4, 5),
            of(7, 0, 3, -5, 5),
            of(7, 0, 3, -4, 6),
        ] {
            for (a, b) in base.into_iter().zip(other) {
                assert!((5..28).contains(&(a ^ b).count_ones()), "{a:08x} {b:08x}");
            }
        }
    }

    #[test]
    fn the_cells_of_one_field_never_repeat_a_clump() {
        let mut places: Vec<[u32; 6]> = meadow();
        let all = places.len();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), all);
    }
}
