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
