//! Coasts in all directions from a place, and the starts on them.

use super::Start;
use super::map::Place;
use super::surroundings::SURVEYED;
use crate::constants::{GRADIENTS, UNIT_BITS};
use crate::land::Land;
use crate::octaves::Octaves;
use crate::position::Position;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

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
/// Cost of a steep shore, in steps of distance.
const STEEP: i32 = 16;
/// Largest distance of the coarse level's coast from the land's, steps.
const SHORE_STEPS: i32 = 2;
/// Farthest a start lies from its coast along an axis, units: [`SHORE_STEPS`], and twice the grid
/// on which the surroundings are judged.
pub(super) const FROM_COAST: i32 = ((SHORE_STEPS * STEP_M) << UNIT_BITS) + 2 * SURVEYED;

/// The coasts about a place.
pub(super) struct Coasts(Vec<Coast>);

struct Coast {
    ray: Ray,
    step: i32,
    /// The start there and what it counts as, in steps from what is preferred, once it is known.
    start: Option<Option<(i32, Start)>>,
}

impl Coasts {
    pub(super) fn about(land: &Land, origin: Place) -> Self {
        let rays = GRADIENTS.map(|(x, z)| Ray { origin, direction: (i32::from(x), i32::from(z)) });
        let coast = |ray: Ray| move |step| Coast { ray, step, start: None };
        Self(rays.into_iter().flat_map(|ray| ray.coasts(land).into_iter().map(coast(ray))).collect())
    }

    /// The start with the least cost among those that are accepted. A start is looked for only
    /// where no better one is left, and where places up to [`FROM_COAST`] from its coast may be
    /// accepted.
    pub(super) fn best(&mut self, land: &Land, accepts: impl Fn(Place, i32) -> bool) -> Option<Start> {
        // The least cost of a coast; the first of equals.
        let least = |(index, coast): (usize, &Coast)| Reverse(((coast.step - PREFERRED).abs(), index, false));
        let mut queue: BinaryHeap<_> = self.0.iter().enumerate().map(least).collect();
        while let Some(Reverse((_, index, is_found))) = queue.pop() {
            let coast = &mut self.0[index];
            if is_found {
                let start = coast.start.flatten().map(|(_, start)| start);
                if start.is_some_and(|start| accepts((start.x, start.z), 0)) {
                    return start;
                }
            } else if accepts(coast.ray.at(coast.step * STEP_M), FROM_COAST) {
                let start = coast.start.get_or_insert_with(|| coast.ray.start(land, coast.step));
                queue.extend(start.map(|(cost, _)| Reverse((cost, index, true))));
            }
        }
        None
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
        let shores = ((step - SHORE_STEPS) * STEP_M..(step + SHORE_STEPS) * STEP_M).step_by(8);
        let shore = shores.rev().find(is_dry)?;
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
        let places: [Place; STEPS as usize + 1] = std::array::from_fn(|step| self.at(step as i32 * STEP_M));
        let mut heights = [0; STEPS as usize + 1];
        land.heights_along(OUTLINE, &places, &mut heights);
        let (mut coasts, mut sea, mut ashore) = (Vec::new(), OPEN, 0);
        for (step, height) in (0..).zip(heights) {
            if height > 0 {
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

/// The height of a place, units; 0 outside the world.
pub(super) fn height(land: &Land, (x, z): Place, octaves: Octaves) -> i32 {
    Position::new(x, z).map_or(0, |position| land.height_keeping(position, octaves))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_on_a_ray_are_vertices_of_16_metres() {
        let ray = Ray { origin: (5, 4096 * 3 + 7), direction: (-(1 << 15), 1 << 14) };
        assert_eq!(ray.along(20), (5 - 20 * 256, 4096 * 3 + 7 + 10 * 256));
        assert_eq!(ray.at(20), (-8192, 4096 * 3));
    }

    #[test]
    fn a_start_is_dry_and_lies_near_its_coast() {
        assert_eq!(FROM_COAST, (2 * 64 + 2 * 16) << UNIT_BITS);
        let mut starts = 0;
        for seed in 0..4 {
            let land = Land::new(seed);
            for Coast { ray, step, .. } in Coasts::about(&land, (0, 0)).0 {
                let Some((cost, start)) = ray.start(&land, step) else { continue };
                let (x, z) = ray.at(64 * step);
                assert!((start.x - x).abs() <= FROM_COAST && (start.z - z).abs() <= FROM_COAST, "{start:?}");
                assert!(height(&land, (start.x, start.z), Octaves::ALL) > 1 << 7, "{start:?}");
                assert!([0, 16].contains(&(cost - (step - 32).abs())), "{cost} at step {step}");
                starts += 1;
            }
        }
        assert!(starts > 4, "{starts}");
    }
}
