//! Where a visitor of a world begins: on the shore of the home island.

mod coasts;
mod map;
mod surroundings;

use crate::constants::UNIT_BITS;
use crate::land::Land;
use coasts::Coasts;
use map::Place;
use std::collections::HashMap;
use surroundings::Surroundings;

/// The place where a viewer begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// East, units. On land, at most some tens of metres from the water line.
    pub x: i32,
    /// South, units.
    pub z: i32,
    /// The way inland, a unit vector in Q15: east, south.
    pub inland: (i32, i32),
}

/// Searches in turn: how far plains are searched, metres, and the vertices of a plain (6 ha, 4 ha).
const SEARCHES: [(i32, usize); 5] = [(8192, 235), (16_384, 235), (16_384, 157), (32_768, 235), (32_768, 157)];

impl Land {
    /// The start of this world: of the coasts in 32 directions from the origin a gentle one about 2
    /// km away, with a plain and a valley within 3 km. Where no coast has them, the directions are
    /// those from the plain nearest to the origin, from the next, and so on, first within 8 km,
    /// then within 16 km, then within 32 km. If all fail, the best coast about the origin; without
    /// any coast before hills, the origin itself, wherever it lies. Some 20 ms, in 4 of 1,000
    /// worlds some 0.4 s: not for a frame.
    #[must_use]
    pub fn start(&self) -> Start {
        let mut surroundings = Surroundings::new(self);
        // The searches look at the same places again, with more about them.
        let mut known: HashMap<Place, Coasts> = HashMap::new();
        for (half_m, vertices) in SEARCHES {
            surroundings.widen(half_m << UNIT_BITS);
            for origin in std::iter::once((0, 0)).chain(surroundings.plains(vertices)) {
                let coasts = known.entry(origin).or_insert_with(|| Coasts::about(self, origin));
                let accepts = |at: Place, slack: i32| surroundings.are_varied_at(at, slack, vertices);
                if let Some(start) = coasts.best(self, accepts) {
                    return start;
                }
            }
        }
        let any = Coasts::about(self, (0, 0)).best(self, |_, _| true);
        any.unwrap_or(Start { x: 0, z: 0, inland: (1 << 15, 0) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octaves::Octaves;
    use coasts::height;

    #[test]
    fn a_world_begins_on_low_land_beside_the_sea_with_higher_land_inland() {
        let mut gentle = 0;
        for seed in 0..24 {
            let land = Land::new(seed);
            let start = land.start();
            let at = |metres: i32| {
                let place =
                    (start.x + ((start.inland.0 * metres) >> 7), start.z + ((start.inland.1 * metres) >> 7));
                height(&land, place, Octaves::ALL)
            };
            assert!(at(0) > 0 && at(0) < 45 << UNIT_BITS, "world {seed}: {}", at(0));
            assert!((-20..0).any(|n| at(16 * n) <= 0), "world {seed}: no sea within 320 m");
            assert!((1..40).any(|n| at(64 * n) > 30 << UNIT_BITS), "world {seed}: no hill inland");
            gentle += i32::from(at(24) < 4 << UNIT_BITS);
        }
        assert!(gentle >= 20, "{gentle} of 24 starts are gentle");
    }
}
