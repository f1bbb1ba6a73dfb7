//! Surroundings of the origin of a world: plains and valleys, found on a coarse grid; the plains
//! are outlined again on a finer one.

use super::map::{Map, Place, square};
use crate::constants::{SPACING_BITS, UNITS_PER_METRE};
use crate::land::Land;
use std::ops::Range;

/// Levels of the coarse grid, its vertices 32 m apart, and of the fine one.
const COARSE: u8 = 4;
const FINE: u8 = 3;
/// Units between vertices of the fine grid (16 m). Plains are a little larger or smaller on a grid
/// that is shifted by a part of it.
pub(super) const SURVEYED: i32 = 1 << (SPACING_BITS + FINE as u32);
/// Surroundings of a place: vertices within this distance, units.
const NEAR: i32 = 2980 * UNITS_PER_METRE;

/// Slope of a plain: rise over its distance, 1/10,000 (3 degrees); its heights, units.
const SLOPE: i64 = 524;
const HEIGHTS: Range<i32> = UNITS_PER_METRE..200 * UNITS_PER_METRE;
/// Fewest vertices of the fine grid in a plain of any search (4 ha).
const LEAST: usize = 157;
/// Vertices of the coarse grid that may hold a plain (2 ha).
const PERHAPS: usize = 16;

/// Height of both sides of a valley over its floor, units; their distance from the floor along an
/// axis and on a diagonal, coarse spacings; fall of the floor, units; length of the floor, units.
const DEPTH: i32 = 14 * UNITS_PER_METRE;
const ACROSS: [usize; 2] = [3, 2];
const FALL: i32 = 30 * UNITS_PER_METRE;
const LENGTH: i32 = 416 * UNITS_PER_METRE;

/// Plains and valleys about the origin.
pub(super) struct Surroundings<'a> {
    land: &'a Land,
    /// Heights of the coarse grid, as they are.
    map: Map,
    /// Units from the origin to the edges.
    half: i32,
    /// Level regions of the fine grid, [`LEAST`] vertices or more.
    plains: Vec<Region<Place>>,
    /// Places and heights along the floors of valleys.
    floors: Vec<Region<(Place, i32)>>,
}

/// Vertices, and what their places lie between.
struct Region<T> {
    vertices: Vec<T>,
    low: Place,
    high: Place,
}

impl<'a> Surroundings<'a> {
    /// Nothing but the origin.
    pub(super) fn new(land: &'a Land) -> Self {
        let map = Map::of(land, COARSE, (0, 0), (0, 0));
        Self { land, map, half: 0, plains: Vec::new(), floors: Vec::new() }
    }

    /// Widens the surroundings to `half` units from the origin.
    pub(super) fn widen(&mut self, half: i32) {
        if half == self.half {
            return;
        }
        self.half = half;
        self.map = self.map.widened(self.land, (-half, -half), (half, half));
        let map = self.map.smoothed(1);
        let [straight, diagonal] = ACROSS;
        let steps =
            [straight, straight * map.side(), diagonal * (map.side() + 1), diagonal * (map.side() - 1)];
        let is_floor = |index: usize| {
            let is_below = |other: usize| map.height(other) - map.height(index) >= DEPTH;
            map.height(index) > 0
                && steps.into_iter().any(|step| is_below(index - step) && is_below(index + step))
        };
        let floor = |floor: Vec<usize>| {
            let vertices = floor.into_iter().map(|at| (map.place(at), map.height(at))).collect();
            Region::of(vertices, |(place, _)| *place)
        };
        self.floors = map.regions(is_floor).into_iter().map(floor).collect();
        self.plains = plains(&map)
            .into_iter()
            .filter(|plain| plain.len() >= PERHAPS)
            .flat_map(|plain| outlined(self.land, &map, &plain))
            .filter(|plain| plain.len() >= LEAST)
            .map(|plain| Region::of(plain, |place| *place))
            .collect();
    }

    /// Middles of the plains of at least `vertices` vertices of the fine grid (0.0256 ha each),
    /// units, nearest to the origin first.
    pub(super) fn plains(&self, vertices: usize) -> Vec<Place> {
        let middle = |plain: &Region<Place>| {
            let of = |of: fn(&Place) -> i32| {
                let sum = plain.vertices.iter().map(|place| i64::from(of(place))).sum::<i64>();
                (sum / plain.vertices.len().max(1) as i64) as i32
            };
            (of(|place| place.0), of(|place| place.1))
        };
        let large = self.plains.iter().filter(|plain| plain.vertices.len() >= vertices);
        let mut middles: Vec<_> = large.map(middle).collect();
        middles.sort_by_key(|middle| square(*middle, (0, 0)));
        middles
    }

    /// Whether there are a plain of `vertices` vertices and a valley near a place (units); not
    /// where the grid ends. With slack (units), whether there may be near some place up to the
    /// slack from it along both axes.
    pub(super) fn are_varied_at(&self, at: Place, slack: i32, vertices: usize) -> bool {
        // A square's diagonal is less than one and a half of its sides.
        let near = NEAR + slack + slack / 2;
        let is_near = |place: &Place| square(*place, at) < i64::from(near).pow(2);
        let is_plain = |plain: &Region<Place>| {
            plain.may_be_within(near, at)
                && plain.vertices.iter().filter(|place| is_near(place)).count() >= vertices
        };
        let is_valley = |floor: &Region<(Place, i32)>| {
            let range = |of: fn(&(Place, i32)) -> i32| {
                let values = || floor.vertices.iter().filter(|(place, _)| is_near(place)).map(of);
                values().max().unwrap_or(0) - values().min().unwrap_or(0)
            };
            let length = || range(|(place, _)| place.0).max(range(|(place, _)| place.1));
            floor.may_be_within(near, at) && length() >= LENGTH && range(|(_, height)| *height) >= FALL
        };
        at.0.abs().max(at.1.abs()) <= self.half - NEAR + slack
            && self.plains.iter().any(is_plain)
            && self.floors.iter().any(is_valley)
    }
}

impl<T> Region<T> {
    fn of(vertices: Vec<T>, place: fn(&T) -> Place) -> Self {
        let (mut low, mut high) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
        for (x, z) in vertices.iter().map(place) {
            low = (low.0.min(x), low.1.min(z));
            high = (high.0.max(x), high.1.max(z));
        }
        Self { vertices, low, high }
    }

    /// False if no vertex lies within a distance along both axes.
    const fn may_be_within(&self, distance: i32, at: Place) -> bool {
        at.0 - distance < self.high.0
            && at.0 + distance > self.low.0
            && at.1 - distance < self.high.1
            && at.1 + distance > self.low.1
    }
}

/// Level regions of a map.
fn plains(map: &Map) -> Vec<Vec<usize>> {
    let most = i64::from(2 * map.spacing()) * SLOPE / 10_000;
    map.regions(|index| {
        let rise = |step: usize| i64::from(map.height(index + step) - map.height(index - step));
        HEIGHTS.contains(&map.height(index)) && rise(1).pow(2) + rise(map.side()).pow(2) < most.pow(2)
    })
}

/// The plains of the fine grid at a plain of the coarse one.
fn outlined(land: &Land, coarse: &Map, plain: &[usize]) -> Vec<Vec<Place>> {
    let range = |of: fn(Place) -> i32| {
        let values = || plain.iter().map(|index| of(coarse.place(*index)));
        (values().min().unwrap_or(0), values().max().unwrap_or(0))
    };
    let ((west, east), (north, south)) = (range(|place| place.0), range(|place| place.1));
    let border = 6 * coarse.spacing();
    let fine =
        Map::of(land, FINE, (west - border, north - border), (east + border, south + border)).smoothed(2);
    plains(&fine)
        .into_iter()
        .map(|region| region.into_iter().map(|index| fine.place(index)).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Metres in units.
    const M: i32 = 256;

    fn surroundings(land: &Land, plain: Vec<Place>, floor: Vec<(Place, i32)>) -> Surroundings<'_> {
        let map = Map::of(land, COARSE, (0, 0), (0, 0));
        let plains = vec![Region::of(plain, |place| *place)];
        let floors = vec![Region::of(floor, |(place, _)| *place)];
        Surroundings { land, map, half: 8192 * M, plains, floors }
    }

    #[test]
    fn a_place_is_varied_near_a_plain_and_a_long_valley_that_falls() {
        let land = Land::new(1);
        let valley = |length: Place, fall: i32| {
            vec![((M, 2 * M), 100 * M), ((M + length.0, 2 * M + length.1), 100 * M + fall)]
        };
        let good = || valley((416 * M, 0), 30 * M);
        let far = 2980 * M;
        for (plain, floor, vertices, expected) in [
            ((0, 0), good(), 3, true),
            ((0, 0), good(), 4, false),
            ((0, 0), valley((0, 416 * M), 30 * M), 3, true),
            ((0, 0), valley((416 * M - 1, 300 * M), 30 * M), 3, false),
            ((0, 0), valley((416 * M, 0), 30 * M - 1), 3, false),
            // The end of the valley lies too far away.
            ((0, 0), valley((far, 0), 30 * M), 3, false),
            ((far - 1, 0), good(), 3, true),
            ((0, -far), good(), 3, false),
            // In the square about the place, on the circle and inside it.
            ((far / 5 * 3, far / 5 * 4), good(), 3, false),
            ((far / 5 * 3, far / 5 * 4 - 1), good(), 3, true),
        ] {
            let found = surroundings(&land, vec![plain; 3], floor.clone());
            assert_eq!(found.are_varied_at((0, 0), 0, vertices), expected, "{plain:?} {floor:?} {vertices}");
        }
        // With slack, once and a half of it farther.
        for (x, expected) in [(far + 1499, true), (far + 1500, false)] {
            assert_eq!(surroundings(&land, vec![(x, 0); 3], good()).are_varied_at((0, 0), 1000, 3), expected);
        }
    }

    #[test]
    fn no_place_is_varied_whose_surroundings_are_not_known() {
        let land = Land::new(1);
        let most = (8192 - 2980) * M;
        for (slack, beyond, expected) in [(0, 0, true), (0, 1, false), (10, 10, true), (10, 11, false)] {
            for (x, z) in [(most + beyond, 0), (0, -most - beyond)] {
                let floor = vec![((x, z), 0), ((x, z + 416 * M), 30 * M)];
                let found = surroundings(&land, vec![(x, z); 3], floor);
                assert_eq!(found.are_varied_at((x, z), slack, 3), expected, "({x}, {z}), slack {slack}");
            }
        }
    }

    #[test]
    fn a_region_may_be_within_a_distance_of_its_square() {
        let region = Region::of(vec![(10, 40), (30, 20)], |place: &Place| *place);
        for (at, expected) in [
            ((34, 30), true),
            ((35, 30), false),
            ((6, 30), true),
            ((5, 30), false),
            ((20, 44), true),
            ((20, 45), false),
            ((20, 16), true),
            ((20, 15), false),
        ] {
            assert_eq!(region.may_be_within(5, at), expected, "{at:?}");
        }
    }

    #[test]
    fn middles_of_plains_are_listed_by_their_distance_from_the_origin() {
        let land = Land::new(1);
        let mut found = surroundings(&land, vec![(-100, 50), (-110, 40), (-120, 30)], Vec::new());
        found.plains.push(Region::of(vec![(4, 0), (8, 6)], |place| *place));
        assert_eq!(found.plains(2), [(6, 3), (-110, 40)]);
        assert_eq!(found.plains(3), [(-110, 40)]);
    }

    #[test]
    fn a_plain_is_flatter_than_three_degrees_and_neither_beach_nor_high() {
        // Four of the vertices are far enough from the edge.
        for (low, east, south, vertices) in [
            (20 * M, 428, 0, 4),
            (20 * M, 429, 0, 0),
            (20 * M, 0, -428, 4),
            (20 * M, 0, -429, 0),
            (20 * M, 300, 300, 4),
            (20 * M, 310, -310, 0),
            (M - 1, 0, 0, 0),
            (M, 0, 0, 4),
            (200 * M - 1, 0, 0, 4),
            (200 * M, 0, 0, 0),
        ] {
            let height = |index: i32| low + east * (index % 10) + south * (index / 10);
            let map = Map::of_heights(10, (0..100).map(height).collect());
            assert_eq!(plains(&map).concat().len(), vertices, "{low} {east} {south}");
        }
    }

    #[test]
    fn floors_of_valleys_lie_below_both_sides_and_plains_are_large() {
        let land = Land::new(0);
        let half = 8192 * M;
        let mut found = Surroundings::new(&land);
        found.widen(half);
        let map = Map::of(&land, COARSE, (-half, -half), (half, half)).smoothed(1);
        let side = map.side() as i32;
        let height = |x: i32, z: i32| map.height((z * side + x) as usize);
        let mut expected = Vec::new();
        for (x, z) in (4..side - 4).flat_map(|z| (4..side - 4).map(move |x| (x, z))) {
            let floor = height(x, z);
            let is_valley = [(3, 0), (0, 3), (2, 2), (2, -2)].into_iter().any(|(east, south)| {
                let sides = [height(x + east, z + south), height(x - east, z - south)];
                sides.iter().all(|side| side - floor >= 14 * M)
            });
            if floor > 0 && is_valley {
                expected.push(((32 * M * x - half, 32 * M * z - half), floor));
            }
        }
        let mut floors: Vec<_> = found.floors.iter().flat_map(|floor| floor.vertices.clone()).collect();
        floors.sort_unstable();
        expected.sort_unstable();
        assert!(!floors.is_empty() && floors == expected, "{} of {}", floors.len(), expected.len());
        assert!(!found.plains.is_empty());
        assert!(found.plains.iter().all(|plain| plain.vertices.len() >= LEAST));
    }

    #[test]
    fn a_plain_is_outlined_on_the_fine_grid_and_192_metres_around_it() {
        let land = Land::new(1);
        let coarse = Map::of_heights(121, vec![0; 121 * 121]);
        let (low, high) = (-192 * M, (120 * 32 + 192) * M);
        let fine = Map::of(&land, FINE, (low, low), (high, high)).smoothed(2);
        let place = |index: &usize| fine.place(*index);
        let places = |region: &Vec<usize>| region.iter().map(place).collect::<Vec<_>>();
        let expected: Vec<_> = plains(&fine).iter().map(places).collect();
        assert!(outlined(&land, &coarse, &[0, 121 * 121 - 1]) == expected);
        assert_eq!((SURVEYED, fine.spacing()), (16 * M, 16 * M));
    }
}
