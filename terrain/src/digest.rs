//! The world digest: identifies a generator version with its parameters.
//!
//! Peers compare digests before any chunk is exchanged, and chunk addresses contain it, so a cached
//! chunk can never be served to another world.

use crate::constants::{FIRST_CELL_BITS, GENERATOR_VERSION, ISLAND_CELL_BITS, OCTAVE_SHIFT, WORLD_HALF};
use crate::hash::mix;
use crate::land::Land;
use crate::position::Position;
use crate::spline::CELL_BITS;
use std::fmt;

/// blake3 over the generator version, the seed and the heights of the probe set.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct WorldDigest(pub [u8; 32]);

impl Land {
    /// The digest of this world: blake3 of the generator version (u32), the seed (u64) and the
    /// height (i32) of every probe in order, all little-endian. Takes some 30 milliseconds.
    #[must_use]
    pub fn digest(&self) -> WorldDigest {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&GENERATOR_VERSION.to_le_bytes());
        hasher.update(&self.world_seed().to_le_bytes());
        for probe in probes() {
            hasher.update(&self.height_at(probe).to_le_bytes());
        }
        WorldDigest(*hasher.finalize().as_bytes())
    }
}

/// The probe set, the same for every world: first all pairs of the edge values, then points that
/// spread over the home island, over its middle and over the whole world.
pub fn probes() -> impl Iterator<Item = Position> {
    let edges = edge_values();
    let pairs = edges.clone().into_iter().flat_map(move |x| edges.clone().into_iter().map(move |z| (x, z)));
    let scattered = (0..2048u32).flat_map(|n| {
        let (x, z) = (mix(2 * n) as i32, mix(2 * n + 1) as i32);
        [(x >> 11, z >> 11), (x >> 12, z >> 12), (x >> 1, z >> 1)]
    });
    pairs.chain(scattered).filter_map(|(x, z)| Position::new(x, z).ok())
}

/// Coordinates where an implementation is most likely to go wrong: zero, the world's border, and
/// one unit around the first line of every fine octave, of the base lattice and of the archipelago
/// on both sides of the origin.
fn edge_values() -> Vec<i32> {
    let mut values = vec![-WORLD_HALF, -WORLD_HALF + 1, WORLD_HALF - 1, WORLD_HALF, 0];
    for (octave, (shift_x, shift_z)) in OCTAVE_SHIFT.into_iter().enumerate() {
        let cell = 1 << (FIRST_CELL_BITS - octave as u32);
        for line in [cell - shift_x, -cell - shift_z] {
            values.extend([line - 1, line, line + 1]);
        }
    }
    for line in [1 << CELL_BITS, 1 << (ISLAND_CELL_BITS - 1)] {
        values.extend([line - 1, line, line + 1, -line - 1, -line, 1 - line]);
    }
    values.sort_unstable();
    values.dedup();
    values
}

impl WorldDigest {
    /// Parses 64 hexadecimal digits, either case.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        blake3::Hash::from_hex(text).ok().map(|hash| Self(*hash.as_bytes()))
    }
}

impl fmt::Display for WorldDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for WorldDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "WorldDigest({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::land::SEA_FLOOR;

    /// How much of the probe set reaches land; a digest of sea floor alone would prove nothing.
    fn probes_on_islands(land: &Land) -> usize {
        probes().filter(|p| land.height_at(*p) != SEA_FLOOR).count()
    }

    #[test]
    fn the_digest_of_seed_zero_is_frozen() {
        // A change here is a change of the world: bump GENERATOR_VERSION and say so in the
        // CHANGELOG.
        let frozen = "4b2868764773c359c13282838bd204e2ff52b0956a39cef859e0dd02894c5b69";
        assert_eq!(Land::new(0).digest().to_string(), frozen);
        assert!(include_str!("../../docs/heightfield.md").contains(&format!("`{frozen}`")), "published");
    }

    #[test]
    fn every_seed_has_its_own_digest_and_most_probes_touch_land() {
        let (one, two) = (Land::new(1), Land::new(1 << 32 | 1));
        assert_ne!(one.digest(), two.digest());
        assert!(probes_on_islands(&one) * 2 > probes().count());
    }

    #[test]
    fn digests_survive_text_and_reject_other_text() {
        let digest = Land::new(8).digest();
        assert_eq!(format!("{digest:?}"), format!("WorldDigest({digest})"));
        assert_eq!(WorldDigest::from_hex(&digest.to_string()), Some(digest));
        assert_eq!(WorldDigest::from_hex(&digest.to_string().to_uppercase()), Some(digest));
        for bad in ["", "00", &"g".repeat(64), &"0".repeat(65)] {
            assert_eq!(WorldDigest::from_hex(bad), None);
        }
    }
}
