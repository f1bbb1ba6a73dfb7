//! Where a visitor of a world begins: on the shore of the home island.

mod map;
mod surroundings;

use crate::constants::{GRADIENTS, UNIT_BITS};
use crate::land::Land;
use crate::octaves::Octaves;
use crate::position::Position;
use map::Place;
use surroundings::{SURVEYED, Surroundings};

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
/// Farthest sample from where a search begins, in steps (6,144 m).
const STEPS: i32 = 96;
/// Samples of sea that end an island, so that a pond does not.
const OPEN: i32 = 4;
/// The distance from there that is preferred, in steps (2,048 m): mountains and the far coast are
/// then in view.
const PREFERRED: i32 = 32;
/// Height of the hills that the view inland must show, metres, and how far they are at most, in
/// steps (2,560 m).
const HILL_M: i32 = 80;
const HILL_STEPS: i32 = 40;
/// One fine octave: the base field is evaluated once a sample instead of nine times.
const OUTLINE: Octaves = Octaves::at_level(6);
/// Searches in turn: how far plains are searched, metres, and the vertices of a plain (6 ha, 4 ha).
const SEARCHES: [(i32, usize); 3] = [(8192, 235), (16_384, 235), (16_384, 157)];
/// What a steep shore counts as, in steps of distance.
const STEEP: i32 = 16;

impl Land {
    /// The start of this world: of the coasts in 32 directions from the origin a gentle one about 2
    /// km away, with a plain and a valley within 3 km. Where no coast has them, the directions are
    /// those from the plain nearest to the origin, from the next, and so on, first within 8 km, then
    /// within 16 km. If all fail, the best coast about the origin; without any coast before hills,
    /// the origin itself, wherever it lies. Some 20 ms, at most 0.6 s in 1,000 worlds: not for a frame.
    #[must_use]
    pub fn start(&self) -> Start {
        for (half_m, vertices) in SEARCHES {
            let surroundings = Surroundings::of(self, half_m << UNIT_BITS, vertices);
            let origins = std::iter::once((0, 0)).chain(surroundings.plains());
            let mut starts = origins.flat_map(|origin| self.starts_about(origin));
            if let Some(start) = starts.find(|start| surroundings.are_varied_at((start.x, start.z))) {
                return start;
            }
        }
        let any = self.starts_about((0, 0)).into_iter().next();
        any.unwrap_or(Start { x: 0, z: 0, inland: (1 << 15, 0) })
    }

    /// Starts on the coasts in all directions from a place, best first.
    fn starts_about(&self, origin: Place) -> Vec<Start> {
        let directions = GRADIENTS.map(|(x, z)| (i32::from(x), i32::from(z)));
        let rays = directions.map(|direction| Ray { origin, direction });
        let mut starts: Vec<_> = rays
            .into_iter()
            .flat_map(|ray| ray.coasts(self).into_iter().filter_map(move |step| ray.start(self, step)))
            .collect();
        starts.sort_by_key(|(cost, _)| *cost);
        starts.into_iter().map(|(_, start)| start).collect()
    }
}

/// A straight line from a place.
#[derive(Clone, Copy)]
struct Ray {
    origin: Place,
    /// Unit vector in Q15.
    direction: (i32, i32),
}

impl Ray {
    /// A place on it, units.
    fn along(self, metres: i32) -> Place {
        let along = |origin: i32, part: i32| origin + ((part * metres) >> (15 - UNIT_BITS));
        (along(self.origin.0, self.direction.0), along(self.origin.1, self.direction.1))
    }

    /// A place beside it, units: a vertex of the grid on which the surroundings are judged.
    fn at(self, metres: i32) -> Place {
        let (x, z) = self.along(metres);
        (x & !(SURVEYED - 1), z & !(SURVEYED - 1))
    }

    /// The start at a coast, and how far it is from what is preferred.
    fn start(self, land: &Land, step: i32) -> Option<(i32, Start)> {
        let is_dry = |metres: &i32| height(land, self.at(*metres), Octaves::ALL) > 1 << (UNIT_BITS - 1);
        // The coarse level's coast lies within two steps of the land's.
        let shore = ((step - 2) * STEP_M..(step + 2) * STEP_M).step_by(8).rfind(is_dry)?;
        let is_high = |step: i32| height(land, self.at(shore - step * STEP_M), OUTLINE) > HILL_M << UNIT_BITS;
        if !(1..HILL_STEPS).any(is_high) {
            return None;
        }
        let (x, z) = self.at(shore);
        let inland = Self { origin: (x, z), ..self }.along(-24);
        let steep = if (0..4 << UNIT_BITS).contains(&height(land, inland, Octaves::ALL)) { 0 } else { STEEP };
        Some((
            (step - PREFERRED).abs() + steep,
            Start { x, z, inland: (-self.direction.0, -self.direction.1) },
        ))
    }

    /// The steps at which land meets the sea.
    fn coasts(self, land: &Land) -> Vec<i32> {
        let (mut coasts, mut sea, mut ashore) = (Vec::new(), OPEN, 0);
        for step in 0..=STEPS {
            if height(land, self.at(step * STEP_M), OUTLINE) > 0 {
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
}

fn height(land: &Land, (x, z): Place, octaves: Octaves) -> i32 {
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
