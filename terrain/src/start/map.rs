//! Heights of a rectangle, and its connected regions.

use crate::constants::SPACING_BITS;
use crate::grid::Grid;
use crate::land::Land;
use std::ops::Range;

/// A position, units: east, south.
pub(super) type Place = (i32, i32);

/// Vertices of the edge that are in no region: properties look so far.
const EDGE: usize = 4;

/// Vertices along a square that is evaluated at once: few islands are near it.
const SQUARE: usize = 64;

/// Heights on a grid of a level.
pub(super) struct Map {
    corner: Place,
    spacing_bits: u32,
    side: usize,
    heights: Vec<i32>,
}

impl Map {
    /// The heights from one corner to the other; empty if it is not wholly in the world.
    pub(super) fn of(land: &Land, level: u8, corner: Place, end: Place) -> Self {
        let spacing_bits = SPACING_BITS + u32::from(level);
        let vertices = |from: i32, to: i32| ((to - from) >> spacing_bits) as usize + 1;
        let (side, rows) = (vertices(corner.0, end.0), vertices(corner.1, end.1));
        let mut heights = Vec::new();
        if let Ok(grid) = Grid::new(corner.0, corner.1, level, side, rows) {
            heights.resize(side * rows, 0);
            land.heights(&grid, &mut heights);
        }
        Self { corner, spacing_bits, side, heights }
    }

    /// The same up to another corner and end around this map's, whose heights are not evaluated
    /// again. Both are multiples of the spacing from this map's.
    pub(super) fn widened(&self, land: &Land, corner: Place, end: Place) -> Self {
        let level = (self.spacing_bits - SPACING_BITS) as u8;
        let vertices = |from: i32, to: i32| ((to - from) >> self.spacing_bits) as usize;
        let (side, rows) = (vertices(corner.0, end.0) + 1, vertices(corner.1, end.1) + 1);
        let (west, north) = (vertices(corner.0, self.corner.0), vertices(corner.1, self.corner.1));
        let inner_rows = self.heights.len() / self.side.max(1);
        let (east, south) = (west + self.side, north + inner_rows);
        let mut heights = vec![0; side * rows];
        let mut lay = |columns: Range<usize>, lines: Range<usize>, from: &[i32]| {
            for (row, from) in lines.zip(from.chunks(columns.len().max(1))) {
                heights[row * side..][columns.clone()].copy_from_slice(from);
            }
        };
        lay(west..east, north..south, &self.heights);
        let mut part = vec![0; SQUARE * SQUARE];
        let around = [
            (0..side, 0..north),
            (0..side, south..rows),
            (0..west, north..south),
            (east..side, north..south),
        ];
        for (columns, lines) in around.into_iter().flat_map(squares) {
            let (x, z) = (corner.0 + self.units(columns.start), corner.1 + self.units(lines.start));
            let (width, height) = (columns.len(), lines.len());
            let Ok(grid) = Grid::new(x, z, level, width, height) else { continue };
            let part = &mut part[..width * height];
            land.heights(&grid, part);
            lay(columns, lines, part);
        }
        Self { corner, spacing_bits: self.spacing_bits, side, heights }
    }

    const fn units(&self, vertices: usize) -> i32 {
        (vertices as i32) << self.spacing_bits
    }

    /// The means of as many neighbours to every side; values at the ends stay as they are.
    pub(super) fn smoothed(&self, reach: usize) -> Self {
        let along = |heights: &[i32], step: usize| {
            let last = heights.len().saturating_sub(reach * step);
            let mut means = heights.to_vec();
            for index in reach * step..last {
                let sum: i32 = (0..=2 * reach).map(|n| heights[index + n * step - reach * step]).sum();
                means[index] = sum / (2 * reach as i32 + 1);
            }
            means
        };
        Self { heights: along(&along(&self.heights, 1), self.side), ..*self }
    }

    /// Vertices along x.
    pub(super) const fn side(&self) -> usize {
        self.side
    }

    /// Units between vertices.
    pub(super) const fn spacing(&self) -> i32 {
        1 << self.spacing_bits
    }

    /// The height of a vertex, units.
    pub(super) fn height(&self, index: usize) -> i32 {
        self.heights[index]
    }

    /// The position of a vertex.
    pub(super) const fn place(&self, index: usize) -> Place {
        let (column, row) = ((index % self.side) as i32, (index / self.side) as i32);
        (self.corner.0 + (column << self.spacing_bits), self.corner.1 + (row << self.spacing_bits))
    }

    /// The connected regions (of eight neighbours) of the vertices with a property.
    pub(super) fn regions(&self, has: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        let rows = self.heights.len() / self.side;
        let is_inside = |at: usize, count: usize| at >= EDGE && at + EDGE < count;
        let is_open = |index: usize| {
            is_inside(index % self.side, self.side) && is_inside(index / self.side, rows) && has(index)
        };
        let mut is_open: Vec<bool> = (0..self.heights.len()).map(is_open).collect();
        let mut regions = Vec::new();
        for seed in 0..is_open.len() {
            if !std::mem::take(&mut is_open[seed]) {
                continue;
            }
            let mut region = vec![seed];
            let mut next = 0;
            while let Some(&index) = region.get(next) {
                next += 1;
                for row in [index - self.side, index, index + self.side] {
                    region.extend((row - 1..=row + 1).filter(|at| std::mem::take(&mut is_open[*at])));
                }
            }
            regions.push(region);
        }
        regions
    }
}

/// A rectangle of columns and rows in parts of at most [`SQUARE`] of both.
fn squares(
    (columns, rows): (Range<usize>, Range<usize>),
) -> impl Iterator<Item = (Range<usize>, Range<usize>)> {
    let parts = |range: Range<usize>| {
        range.clone().step_by(SQUARE).map(move |first| first..range.end.min(first + SQUARE))
    };
    parts(rows).flat_map(move |rows| parts(columns.clone()).map(move |columns| (columns, rows.clone())))
}

/// The square of a distance.
pub(super) fn square(from: Place, to: Place) -> i64 {
    (i64::from(from.0) - i64::from(to.0)).pow(2) + (i64::from(from.1) - i64::from(to.1)).pow(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;
    use crate::octaves::Octaves;
    use crate::position::Position;
    use std::collections::BTreeMap;

    impl Map {
        /// A map from the origin, 32 m between its vertices.
        pub(in crate::start) fn of_heights(side: usize, heights: Vec<i32>) -> Self {
            Self { corner: (0, 0), spacing_bits: SPACING_BITS + 4, side, heights }
        }
    }

    #[test]
    fn a_map_has_the_heights_between_its_corners() {
        let land = Land::new(1);
        // Level 5: 16,384 units between vertices.
        let at = |column: i32, row: i32| (16_384 * column - 65_536, 16_384 * row + 32_768);
        let map = Map::of(&land, 5, at(0, 0), at(5, 3));
        assert_eq!((map.side(), map.heights.len(), map.spacing()), (6, 24, 16_384));
        for index in 0..24 {
            let (x, z) = at((index % 6) as i32, (index / 6) as i32);
            let height = land.height_keeping(Position::new(x, z).unwrap(), Octaves::at_level(5));
            assert_eq!((map.place(index), map.height(index)), ((x, z), height));
        }
        let border = 1 << 30;
        assert!(Map::of(&land, 5, (border, 0), (border + 16_384, 0)).heights.is_empty());
    }

    #[test]
    fn a_widened_map_keeps_its_heights_and_has_the_others_of_the_whole() {
        let land = Land::new(1);
        let at = |column: i32, row: i32| (column << 15, row << 15);
        // Wider than the squares that are evaluated at once, by another number on every side.
        let (corner, end) = (at(-73, -80), at(80, 70));
        let mut inner = Map::of(&land, 6, at(-3, -2), at(4, 1));
        inner.heights.fill(7);
        let (wide, mut whole) = (inner.widened(&land, corner, end), Map::of(&land, 6, corner, end));
        for index in 0..whole.heights.len() {
            let (x, z) = whole.place(index);
            if (-3..=4).contains(&(x >> 15)) && (-2..=1).contains(&(z >> 15)) {
                whole.heights[index] = 7;
            }
        }
        assert_eq!((wide.corner, wide.side, wide.spacing()), (corner, 154, 1 << 15));
        assert!(wide.heights == whole.heights);
    }

    #[test]
    fn heights_are_smoothed_along_x_and_then_along_z() {
        let (side, rows) = (7, 9);
        let heights: Vec<i32> = (0..side * rows).map(|index| mix(index as u32) as i32 >> 12).collect();
        let map = Map::of_heights(side, heights.clone());
        for reach in [1, 2] {
            let mut expected = heights.clone();
            for step in [1, side] {
                let before = expected.clone();
                for (index, mean) in expected.iter_mut().enumerate() {
                    let around = (0..=2 * reach).map(|n| (index + n * step).checked_sub(reach * step));
                    let values: Option<Vec<i32>> = around.map(|place| before.get(place?).copied()).collect();
                    if let Some(values) = values {
                        *mean = values.iter().sum::<i32>() / values.len() as i32;
                    }
                }
            }
            let smoothed = map.smoothed(reach);
            assert_eq!((smoothed.side, smoothed.heights), (side, expected), "{reach}");
        }
    }

    #[test]
    fn regions_are_joined_by_edges_and_corners_and_keep_clear_of_the_edge() {
        let (side, rows) = (20, 17);
        let map = Map::of_heights(side, vec![0; side * rows]);
        let has = |index: usize| mix(index as u32) % 5 < 2;
        let inside: Vec<usize> = (0..side * rows)
            .filter(|index| (4..16).contains(&(index % side)) && (4..13).contains(&(index / side)))
            .filter(|index| has(*index))
            .collect();
        // The least vertex of a region is its label, which neighbours take over until none changes.
        let mut labels: BTreeMap<usize, usize> = inside.iter().map(|index| (*index, *index)).collect();
        for _ in &inside {
            for index in &inside {
                let near = |other: &&usize| {
                    (*other % side).abs_diff(index % side) < 2 && (*other / side).abs_diff(index / side) < 2
                };
                let least = inside.iter().filter(near).map(|other| labels[other]).min();
                labels.insert(*index, least.unwrap());
            }
        }
        let mut expected: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        labels.iter().for_each(|(index, label)| expected.entry(*label).or_default().push(*index));
        let mut regions = map.regions(has);
        regions.iter_mut().for_each(|region| region.sort_unstable());
        assert!(regions.len() > 3 && regions.iter().any(|region| region.len() > 3), "{regions:?}");
        assert_eq!(regions, expected.into_values().collect::<Vec<_>>());
    }

    #[test]
    fn the_square_of_a_distance_is_that_of_wide_arithmetic() {
        assert_eq!(square((-(1 << 30), 5), (1 << 30, 2)), (1 << 62) + 9);
    }
}
