//! What lies about the origin of a world: plains and valleys, found on a coarse grid; the plains are
//! outlined again on a finer one.

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
/// Vertices of the coarse grid that may hold a plain (2 ha).
const PERHAPS: usize = 16;

/// Height of both sides of a valley over its floor, units, so many coarse spacings away along an
/// axis and on a diagonal; fall of the floor, units; length of the floor, units.
const DEPTH: i32 = 14 * UNITS_PER_METRE;
const ACROSS: [usize; 2] = [3, 2];
const FALL: i32 = 30 * UNITS_PER_METRE;
const LENGTH: i32 = 416 * UNITS_PER_METRE;

/// Plains and valleys about the origin.
pub(super) struct Surroundings {
    /// Units from the origin to the edges.
    half: i32,
    /// Vertices of a plain.
    vertices: usize,
    /// Vertices of the fine grid in each plain.
    plains: Vec<Vec<Place>>,
    /// Places and heights along the floors of valleys.
    floors: Vec<Vec<(Place, i32)>>,
}

impl Surroundings {
    /// Surroundings up to so many units from the origin. A plain has at least so many vertices of
    /// the fine grid (0.0256 ha each).
    pub(super) fn of(land: &Land, half: i32, vertices: usize) -> Self {
        let map = Map::of(land, COARSE, (-half, -half), (half, half)).smoothed(1);
        let [straight, diagonal] = ACROSS;
        let steps =
            [straight, straight * map.side(), diagonal * (map.side() + 1), diagonal * (map.side() - 1)];
        let is_floor = |index: usize| {
            let is_below = |other: usize| map.height(other) - map.height(index) >= DEPTH;
            map.height(index) > 0
                && steps.into_iter().any(|step| is_below(index - step) && is_below(index + step))
        };
        let floors = map.regions(is_floor).into_iter();
        let floors =
            floors.map(|floor| floor.into_iter().map(|at| (map.place(at), map.height(at))).collect());
        let floors = floors.collect();
        let perhaps = plains(&map).into_iter().filter(|plain| plain.len() >= PERHAPS);
        let plains = perhaps
            .flat_map(|plain| outlined(land, &map, &plain))
            .filter(|plain| plain.len() >= vertices)
            .collect();
        Self { half, vertices, plains, floors }
    }

    /// Middles of the plains, units, nearest to the origin first.
    pub(super) fn plains(&self) -> Vec<Place> {
        let middle = |plain: &Vec<Place>| {
            let sum = |of: fn(&Place) -> i32| plain.iter().map(|place| i64::from(of(place))).sum::<i64>();
            let mean = |of| (sum(of) / plain.len().max(1) as i64) as i32;
            (mean(|place| place.0), mean(|place| place.1))
        };
        let mut middles: Vec<_> = self.plains.iter().map(middle).collect();
        middles.sort_by_key(|middle| square(*middle, (0, 0)));
        middles
    }

    /// Whether there are a plain and a valley near a place (units); not where the grid ends.
    pub(super) fn are_varied_at(&self, at: Place) -> bool {
        let is_near = |place: &Place| square(*place, at) < i64::from(NEAR).pow(2);
        let is_plain =
            |plain: &Vec<Place>| plain.iter().filter(|place| is_near(place)).count() >= self.vertices;
        let is_valley = |floor: &Vec<(Place, i32)>| {
            let range = |of: fn(&(Place, i32)) -> i32| {
                let values = || floor.iter().filter(|(place, _)| is_near(place)).map(of);
                values().max().unwrap_or(0) - values().min().unwrap_or(0)
            };
            let length = range(|(place, _)| place.0).max(range(|(place, _)| place.1));
            length >= LENGTH && range(|(_, height)| *height) >= FALL
        };
        at.0.abs().max(at.1.abs()) <= self.half - NEAR
            && self.plains.iter().any(is_plain)
            && self.floors.iter().any(is_valley)
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
