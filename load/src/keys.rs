//! Which chunks a client requests by key: fine ones near its path.
//!
//! A pure function of seed, number and position, so a second flight on a path requests the same
//! chunks as the first, and clients at one position request the same chunks.

use crate::path::{FlightPath, PathKind};
use terrain::ChunkKey;
use terrain::constants::UNITS_PER_METRE;
use terrain::hash::{hash2, mix};

/// Levels below this are requested: the fine ones, which a view needs only near the eye.
const LEVELS: u32 = 4;

/// Maximal distance of a chunk from the position on each axis, metres. A power of two, so that bits
/// of a hash suffice.
const REACH_M: f64 = 2_048.0;

/// The chunks that one client requests.
#[derive(Clone, Copy, Debug)]
pub struct Keys {
    path: FlightPath,
    seed: u32,
}

impl Keys {
    /// The chunks that client `index` on this path requests.
    #[must_use]
    pub fn new(kind: PathKind, seed: u32, index: u32, path: FlightPath) -> Self {
        // In a stampede all clients request the same chunks.
        let own = if kind == PathKind::Spawn { 0 } else { index };
        Self { path, seed: hash2(seed, own as i32, 0x72) }
    }

    /// Chunk number `number`, requested at a time in seconds.
    #[must_use]
    pub fn key(&self, number: u32, seconds: f64) -> ChunkKey {
        let (east_m, south_m) = self.path.place_m(seconds);
        let bits = mix(self.seed.wrapping_add(number));
        let offset_m = |shift: u32| f64::from((bits >> shift) & 0xfff) - REACH_M;
        let units = |metres: f64| (metres * f64::from(UNITS_PER_METRE)) as i32;
        let level = (bits % LEVELS) as u8;
        ChunkKey::containing(level, units(east_m + offset_m(4)), units(south_m + offset_m(18)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terrain::Start;

    fn path(kind: PathKind, seed: u32, index: u32) -> FlightPath {
        FlightPath::new(kind, seed, index, Start { x: -400_000, z: 100_000, inland: (32_767, 0) })
    }

    fn keys(kind: PathKind, seed: u32, index: u32) -> Keys {
        Keys::new(kind, seed, index, path(kind, seed, index))
    }

    proptest! {
        #[test]
        fn keys_are_deterministic_and_near_the_path(
            kind in prop::sample::select(PathKind::ALL.to_vec()), seed: u32, index in 0..1000u32, number: u32,
            seconds in 0.0..3600.0f64,
        ) {
            let key = keys(kind, seed, index).key(number, seconds);
            prop_assert_eq!(key, keys(kind, seed, index).key(number, seconds));
            prop_assert!(u32::from(key.level()) < LEVELS);
            let place = path(kind, seed, index).place_m(seconds);
            let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
            let (low, side) = ((metres(key.origin().0), metres(key.origin().1)), metres(key.side() as i32));
            for (low, at) in [(low.0, place.0), (low.1, place.1)] {
                prop_assert!(low <= at + REACH_M && low + side >= at - REACH_M);
            }
        }
    }

    #[test]
    fn only_clients_of_a_stampede_request_the_same_chunks() {
        let requested =
            |kind, index| (0..50).map(|number| keys(kind, 1, index).key(number, 1.0)).collect::<Vec<_>>();
        assert_eq!(requested(PathKind::Spawn, 1), requested(PathKind::Spawn, 2));
        assert_ne!(requested(PathKind::Fly, 1), requested(PathKind::Fly, 2));
    }
}
