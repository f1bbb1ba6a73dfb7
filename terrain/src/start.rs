//! Where a visitor of a world begins: on the shore of the home island.

use crate::constants::{GRADIENTS, UNIT_BITS};
use crate::land::Land;
use crate::octaves::Octaves;
use crate::position::Position;

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

/// Steps of the search along a direction, metres.
const STEP_M: i32 = 64;
/// Farthest sample from the origin, in steps (6,144 m).
const STEPS: i32 = 96;
/// Samples of sea that end an island, so that a pond does not.
const OPEN: i32 = 4;
/// The distance from the origin that is preferred, in steps (2,048 m): mountains and the far coast
/// are then in view.
const PREFERRED: i32 = 32;
/// What a steep shore counts as, in steps of distance.
const STEEP: i32 = 16;

impl Land {
    /// The start of this world: of the coasts in 32 directions from the origin a gentle one about 2
    /// km away, or the origin if no direction has a coast. About 3,000 heights of a coarse level,
    /// milliseconds.
    #[must_use]
    pub fn start(&self) -> Start {
        let directions = GRADIENTS.map(|(x, z)| (i32::from(x), i32::from(z)));
        let candidates = directions.iter().flat_map(|way| {
            let steps = coasts(self, *way);
            steps.into_iter().filter_map(move |step| self.candidate(*way, step))
        });
        candidates
            .min_by_key(|(cost, _)| *cost)
            .map_or(Start { x: 0, z: 0, inland: directions[0] }, |(_, start)| start)
    }

    /// The start at a coast, and how far it is from what is preferred.
    fn candidate(&self, way: (i32, i32), step: i32) -> Option<(i32, Start)> {
        let at = |metres: i32| ((way.0 * metres) >> (15 - UNIT_BITS), (way.1 * metres) >> (15 - UNIT_BITS));
        // The coarse level's coast lies within two steps of the land's.
        let shore = ((step - 2) * STEP_M..(step + 2) * STEP_M)
            .step_by(8)
            .rfind(|metres| height(self, at(*metres), Octaves::ALL) > 1 << (UNIT_BITS - 1))?;
        let inland = height(self, at(shore - 24), Octaves::ALL);
        let steep = if (0..4 << UNIT_BITS).contains(&inland) { 0 } else { STEEP };
        let (x, z) = at(shore);
        Some(((step - PREFERRED).abs() + steep, Start { x, z, inland: (-way.0, -way.1) }))
    }
}

/// The steps at which land meets the sea along a direction.
fn coasts(land: &Land, way: (i32, i32)) -> Vec<i32> {
    // One fine octave: the base field is evaluated once a sample instead of nine times.
    let octaves = Octaves::at_level(6);
    let (mut coasts, mut sea, mut ashore) = (Vec::new(), OPEN, 0);
    for step in 0..=STEPS {
        let metres = step * STEP_M;
        let place = ((way.0 * metres) >> (15 - UNIT_BITS), (way.1 * metres) >> (15 - UNIT_BITS));
        if height(land, place, octaves) > 0 {
            (sea, ashore) = (0, ashore + 1);
        } else {
            sea += 1;
            if sea == OPEN && ashore >= OPEN {
                coasts.push(step - OPEN);
                ashore = 0;
            }
        }
    }
    coasts
}

fn height(land: &Land, (x, z): (i32, i32), octaves: Octaves) -> i32 {
    Position::new(x, z).map_or(0, |position| land.height_keeping(position, octaves))
}

#[cfg(test)]
mod tests {
    use super::*;

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
