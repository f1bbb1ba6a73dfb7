//! The distance between a chunk's triangles and the nodes of the base field, in whole rows that the
//! compiler vectorises.

use crate::constants::CLIFF_M;
use crate::land::SEA_FLOOR;

/// How far the nodes of some vertex cells are from the drawn triangles, and what they lie between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NodesApart {
    /// Largest height of a node above the triangles and below them, units times twice the nodes
    /// along a vertex cell.
    pub(crate) above: i32,
    pub(crate) below: i32,
    /// The same of nodes raised by their whole cliff.
    pub(crate) above_with_cliff: i32,
    pub(crate) below_with_cliff: i32,
    /// Lowest and highest node, units.
    pub(crate) low: i32,
    pub(crate) high: i32,
    /// Largest share of the fine octaves, Q15.
    pub(crate) roughness: i32,
}

/// The corners of a vertex cell, units: low, east, south, high.
pub(crate) type Corners = [i32; 4];

impl NodesApart {
    /// Of no nodes.
    pub(crate) const NONE: Self = Self {
        above: i32::MIN,
        below: i32::MIN,
        above_with_cliff: i32::MIN,
        below_with_cliff: i32::MIN,
        low: i32::MAX,
        high: i32::MIN,
        roughness: 0,
    };

    /// Of open sea under triangles on its floor.
    pub(crate) const SEA: Self = Self {
        above: 0,
        below: 0,
        above_with_cliff: 0,
        below_with_cliff: 0,
        low: SEA_FLOOR,
        high: SEA_FLOOR,
        roughness: 0,
    };

    /// Adds the node of column `x`, row `z` of a vertex cell with `side` nodes along its side; both
    /// may be one beyond it, where the triangles go on as planes. Height in 2^-16 m, roughness with
    /// exposure above it.
    #[inline(always)]
    pub(crate) fn add(&mut self, side: i32, corners: Corners, (x, z): (i32, i32), height: i32, shares: i32) {
        let [low, east, south, high] = corners;
        // In halves of the distance between nodes, which lie in the middles of their cells.
        let (x, z) = (2 * x + 1, 2 * z + 1);
        let along = (east - low).wrapping_mul(x).wrapping_add((high - east).wrapping_mul(z));
        let across = (south - low).wrapping_mul(z).wrapping_add((high - south).wrapping_mul(x));
        let drawn = low.wrapping_mul(2 * side).wrapping_add(if x >= z { along } else { across });
        let height = height >> 8;
        let cliff = (shares >> 16).wrapping_mul(CLIFF_M) >> 7;
        let apart = height.wrapping_mul(2 * side).wrapping_sub(drawn);
        let raised = apart.wrapping_add(cliff.wrapping_mul(2 * side));
        self.above = self.above.max(apart);
        self.below = self.below.max(apart.wrapping_neg());
        self.above_with_cliff = self.above_with_cliff.max(raised);
        self.below_with_cliff = self.below_with_cliff.max(raised.wrapping_neg());
        self.low = self.low.min(height);
        self.high = self.high.max(height);
        self.roughness = self.roughness.max(shares & 0xffff);
    }

    /// Of both.
    #[inline(always)]
    pub(crate) fn and(&self, other: &Self) -> Self {
        Self {
            above: self.above.max(other.above),
            below: self.below.max(other.below),
            above_with_cliff: self.above_with_cliff.max(other.above_with_cliff),
            below_with_cliff: self.below_with_cliff.max(other.below_with_cliff),
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            roughness: self.roughness.max(other.roughness),
        }
    }
}

/// Adds the nodes of one vertex cell with `SIDE` nodes along its side. Rows begin `stride` apart.
#[inline(always)]
pub(super) fn nodes_apart<const SIDE: usize>(
    corners: Corners,
    heights: &[i32],
    shares: &[i32],
    stride: usize,
    apart: &mut NodesApart,
) {
    // One per column, so that columns go through vectors.
    let mut columns = [NodesApart::NONE; SIDE];
    for z in 0..SIDE {
        let (heights, shares) = (&heights[z * stride..][..SIDE], &shares[z * stride..][..SIDE]);
        for x in 0..SIDE {
            columns[x].add(SIDE as i32, corners, (x as i32, z as i32), heights[x], shares[x]);
        }
    }
    for column in &columns {
        *apart = apart.and(column);
    }
}
