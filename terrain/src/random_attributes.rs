//! Per-instance random attributes of vegetation, hashed from cell and index (pcg4d).
//!
//! Instances (clumps) are numbered per cell of a grid that is fixed in the world, not per chunk, so
//! that chunks of every level hold the same clumps. `shared/random_attributes.wesl` is the twin on
//! the GPU.

use crate::hash::mix;

/// The random attributes of one clump: 32 uniform bits each. Chi-square tests of a meadow find none
/// of them uneven and no two of a clump correlated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RandomAttributes {
    /// Position in the cell.
    pub place: u32,
    /// Width.
    pub width: u32,
    /// Height.
    pub height: u32,
    /// Colour.
    pub hue: u32,
    /// Phase of the sway in the wind.
    pub phase: u32,
    /// Whether the clump exists at all, and its rank when the field is thinned.
    pub survival: u32,
}

/// The attributes of clump number `index` of the cell `(x, z)`. `kind` separates the fields of one
/// seed.
///
/// Four words come out of the permutation pcg4d (Jarzynski and Olano, "Hash Functions for GPU
/// Rendering", JCGT 9(3), 2020), the others are hashes of two of them each.
#[must_use]
pub const fn random_attributes(seed: u32, kind: u32, x: i32, z: i32, index: u32) -> RandomAttributes {
    let [a, b, c, d] = pcg4d([x as u32, z as u32, index ^ (kind << 16), seed]);
    RandomAttributes {
        place: a,
        width: b,
        height: c,
        hue: d,
        phase: mix(mix(a ^ 0x68bc_21eb) ^ d),
        survival: mix(mix(b ^ 0x02e5_be93) ^ c),
    }
}

/// A permutation of four words in which every output bit depends on every input bit: one linear
/// congruential step per word, then two rounds of multiply-add with an xorshift between them.
const fn pcg4d(words: [u32; 4]) -> [u32; 4] {
    let mut v = [lcg(words[0]), lcg(words[1]), lcg(words[2]), lcg(words[3])];
    v = multiply_add(v);
    v = [v[0] ^ (v[0] >> 16), v[1] ^ (v[1] >> 16), v[2] ^ (v[2] >> 16), v[3] ^ (v[3] >> 16)];
    multiply_add(v)
}

const fn lcg(word: u32) -> u32 {
    word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)
}

/// One round. Each word uses the updated values of the words before it.
const fn multiply_add([mut x, mut y, mut z, mut w]: [u32; 4]) -> [u32; 4] {
    x = x.wrapping_add(y.wrapping_mul(w));
    y = y.wrapping_add(z.wrapping_mul(x));
    z = z.wrapping_add(x.wrapping_mul(y));
    w = w.wrapping_add(y.wrapping_mul(z));
    [x, y, z, w]
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 6] = ["place", "width", "height", "hue", "phase", "survival"];

    fn words(of: RandomAttributes) -> [u32; 6] {
        [of.place, of.width, of.height, of.hue, of.phase, of.survival]
    }

    /// The clumps of a meadow around the origin, both signs: 16 in each of 64 x 64 cells.
    fn meadow() -> Vec<[u32; 6]> {
        let cells = (-32..32).flat_map(|z| (-32..32).map(move |x| (x, z)));
        cells
            .flat_map(|(x, z)| (0..16).map(move |index| words(random_attributes(7, 0, x, z, index))))
            .collect()
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
    fn every_attribute_is_uniform_in_high_low_and_middle_bits() {
        let meadow = meadow();
        for (attribute, name) in NAMES.iter().enumerate() {
            for shift in [24, 13, 0] {
                let off =
                    chi_square(meadow.iter().map(|words| (words[attribute] >> shift) as usize & 255), 256);
                assert!(off < REJECTED, "{name} >> {shift}: {off} standard deviations");
            }
        }
        // Control: a hash of the cell alone. Sixteen clumps share each value, so the test must
        // fail.
        let biased = meadow.iter().enumerate().map(|(n, _)| mix(n as u32 / 16) as usize & 255);
        assert!(chi_square(biased, 256) > REJECTED);
    }

    #[test]
    fn no_two_attributes_are_correlated() {
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
        // Control: two attributes with overlapping bits of one hash. The test must fail.
        let sliced = meadow.iter().map(|words| ((words[0] >> 28) * 16 + ((words[0] >> 26) & 15)) as usize);
        assert!(chi_square(sliced, 256) > REJECTED);
    }

    #[test]
    fn neighbours_in_cell_index_kind_and_seed_are_unrelated() {
        let of = |seed, kind, x, z, index| words(random_attributes(seed, kind, x, z, index));
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
