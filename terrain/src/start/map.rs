//! Heights of a rectangle, and its connected regions.

use crate::constants::SPACING_BITS;
use crate::grid::Grid;
use crate::land::Land;

/// A position, units: east, south.
pub(super) type Place = (i32, i32);

/// Vertices of the edge that are in no region: properties look so far.
const EDGE: usize = 4;

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

    /// The means of as many neighbours to every side; values at the ends stay as they are.
    pub(super) fn smoothed(self, reach: usize) -> Self {
        let along = |heights: &[i32], step: usize| {
            let last = heights.len().saturating_sub(reach * step);
            let mut means = heights.to_vec();
            for index in reach * step..last {
                let sum: i32 = (0..=2 * reach).map(|n| heights[index + n * step - reach * step]).sum();
                means[index] = sum / (2 * reach as i32 + 1);
            }
            means
        };
        let heights = along(&along(&self.heights, 1), self.side);
        Self { heights, ..self }
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

/// The square of a distance.
pub(super) fn square(from: Place, to: Place) -> i64 {
    (i64::from(from.0) - i64::from(to.0)).pow(2) + (i64::from(from.1) - i64::from(to.1)).pow(2)
}
