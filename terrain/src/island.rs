//! The archipelago: where islands lie and how land rises from the sea inside one.
//!
//! The world is cut into square cells of 16,384 m, the first centred on the origin. A cell holds at
//! most one island, wholly inside it, so a point asks one cell only. The falloff is `(1 - d²/r²)²`:
//! no square root, flat at the centre, and zero with zero slope at the rim, where the exactly flat
//! sea floor begins.

use crate::constants::{
    HOME_DOME_M, HOME_RADIUS_STEPS, ISLAND_CELL_BITS, ISLAND_RADIUS_STEP_M, UNIT_BITS, UNITS_PER_METRE,
    WORLD_HALF,
};
use crate::hash::{hash2, mix, stream_seed};
use crate::ring::mul_hi_u;

/// Distances are squared at 1/4 m here, so that their squares fit in u32; what is finer enters to
/// first order. Vertices are multiples of 2 m and lose nothing.
const QUARTER_METRE_BITS: u32 = UNIT_BITS - 2;
/// Beyond this distance along an axis (8,192 m in quarter metres) a point is outside every island
/// of its cell.
const REACH: u32 = 1 << 15;

/// One island.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Island {
    /// Centre, units.
    pub centre: (i32, i32),
    /// Radius in metres: no land and no relief beyond it.
    pub radius_m: i32,
    /// Rise of the dome at the centre over the sea floor, metres.
    pub dome_m: i32,
    /// `floor(2^24 / r²)` in Q16 of square quarter metres: distance squared to Q24 of the radius
    /// squared.
    inverse: u32,
}

/// The islands of one world.
#[derive(Clone, Copy, Debug)]
pub struct Archipelago {
    seed: u32,
}

impl Archipelago {
    /// The archipelago of a world seed.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self { seed: stream_seed(world_seed, 0x1517) }
    }

    /// Decides which cells hold an island, and which one.
    pub(crate) const fn seed(&self) -> u32 {
        self.seed
    }

    /// The cell that a coordinate inside the world lies in.
    #[must_use]
    #[inline]
    pub const fn cell(coordinate: i32) -> i32 {
        (coordinate + (1 << (ISLAND_CELL_BITS - 1))) >> ISLAND_CELL_BITS
    }

    /// The island of a cell, both coordinates within ±256; three cells in four hold one, and the
    /// cell of the origin always does.
    #[must_use]
    pub fn island(&self, cell_x: i32, cell_z: i32) -> Option<Island> {
        let middle = (cell_x << ISLAND_CELL_BITS, cell_z << ISLAND_CELL_BITS);
        if (cell_x, cell_z) == (0, 0) {
            return Some(Island::new(middle, HOME_RADIUS_STEPS, HOME_DOME_M));
        }
        let hash = hash2(self.seed, cell_x, cell_z);
        if hash & 3 == 0 {
            return None;
        }
        let steps = 24 + (hash >> 2 & 63);
        // The centre varies in steps of 2 m; the rim stays inside the cell.
        let spread = (1 << (ISLAND_CELL_BITS - 1 - 9)) - steps * (ISLAND_RADIUS_STEP_M as u32 / 2);
        let offset = |word: u32| (mul_hi_u(word, 2 * spread + 1) as i32 - spread as i32) << 9;
        let word_x = mix(hash ^ 0x5bd1_e995);
        let centre = (middle.0 + offset(word_x), middle.1 + offset(mix(word_x)));
        Some(Island::new(centre, steps, 104 + 2 * steps as i32))
    }

    /// The island whose cell holds the point, which lies inside the world.
    #[must_use]
    #[inline]
    pub fn island_at(&self, x: i32, z: i32) -> Option<Island> {
        self.island(Self::cell(x), Self::cell(z))
    }

    /// Whether the square `[x, x + side] x [z, z + side]` (units) touches no island. Conservative:
    /// a false answer may still be open sea. Answers false at once for squares over more than 3 x 3
    /// cells.
    #[must_use]
    pub fn is_open_sea(&self, x: i32, z: i32, side: u32) -> bool {
        let last = |v: i32| Self::cell(v.saturating_add_unsigned(side).min(WORLD_HALF));
        let (x0, x1, z0, z1) = (Self::cell(x), last(x), Self::cell(z), last(z));
        if x1 - x0 > 2 || z1 - z0 > 2 {
            return false;
        }
        let touches = |island: Island| {
            let gap = |centre: i32, low: i32| {
                let (centre, low) = (i64::from(centre), i64::from(low));
                (low - centre).max(centre - low - i64::from(side)).max(0)
            };
            let (dx, dz) = (gap(island.centre.0, x), gap(island.centre.1, z));
            let radius = i64::from(island.radius_m) * i64::from(UNITS_PER_METRE);
            dx * dx + dz * dz <= radius * radius
        };
        (x0..=x1).all(|cx| (z0..=z1).all(|cz| !self.island(cx, cz).is_some_and(touches)))
    }
}

impl Island {
    fn new(centre: (i32, i32), radius_steps: u32, dome_m: i32) -> Self {
        // r² in square quarter metres is 2^16 n², so 2^24/r² in Q16 times 2^32 for `mul_hi_u` is
        // 2^40/n². Long division in two steps keeps to 32 bits; both quotients are exact.
        let n2 = radius_steps * radius_steps;
        let inverse = (((1u32 << 31) / n2) << 9) + (((1u32 << 31) % n2) << 9) / n2;
        Self { centre, radius_m: radius_steps as i32 * ISLAND_RADIUS_STEP_M, dome_m, inverse }
    }

    /// The falloff at a point inside the world: Q31, 0 at and beyond the rim, below 2^31 at the
    /// centre.
    #[must_use]
    #[inline]
    pub fn falloff(&self, x: i32, z: i32) -> i32 {
        let (x, z) = (self.distance(x, self.centre.0), self.distance(z, self.centre.1));
        let inside = (((1 << 24) - 1 - x - z).max(0) as u32) << 8;
        (mul_hi_u(inside, inside) >> 1) as i32
    }

    /// The share of one axis in `d²/r²`, Q24. Computed per axis, so that a grid needs it once per
    /// column and per row.
    #[inline]
    pub(crate) fn distance(&self, coordinate: i32, centre: i32) -> i32 {
        let units = (coordinate - centre).unsigned_abs().min((REACH << QUARTER_METRE_BITS) - 1);
        let (quarters, rest) = (units >> QUARTER_METRE_BITS, units & ((1 << QUARTER_METRE_BITS) - 1));
        // (q + rest/64)² without its last term, which is below one: the land is whole between
        // vertices too.
        let squared = quarters * quarters + ((quarters * rest) >> (QUARTER_METRE_BITS - 1));
        mul_hi_u(squared, self.inverse) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seed_has_the_large_island_at_the_origin() {
        for seed in [0, 1, 42, u64::MAX] {
            let home = Archipelago::new(seed).island_at(0, 0).unwrap();
            assert_eq!((home.centre, home.radius_m), ((0, 0), 6656));
        }
    }

    #[test]
    fn islands_stay_inside_three_quarters_of_the_cells() {
        let archipelago = Archipelago::new(7);
        let mut found = 0;
        for cell_x in -128..128 {
            for cell_z in -128..128 {
                let Some(island) = archipelago.island(cell_x, cell_z) else { continue };
                found += 1;
                let reach = island.radius_m * UNITS_PER_METRE;
                for (centre, cell) in [(island.centre.0, cell_x), (island.centre.1, cell_z)] {
                    let middle = cell << ISLAND_CELL_BITS;
                    assert!((centre - middle).abs() + reach <= 1 << (ISLAND_CELL_BITS - 1), "{island:?}");
                    assert_eq!(centre % 512, 0, "centres lie on the vertex grid");
                }
            }
        }
        assert!((45_000..53_000).contains(&found), "{found} islands in 65,536 cells");
    }

    #[test]
    fn falloff_is_the_stated_function_and_exactly_zero_from_the_rim_on() {
        let island = Archipelago::new(3).island(2, -1).unwrap();
        let radius = island.radius_m * UNITS_PER_METRE;
        for step in 0..=1100 {
            let d = (i64::from(radius) * step / 1000) as i32 / 512 * 512;
            let got = f64::from(island.falloff(island.centre.0 + d, island.centre.1)) / 2f64.powi(31);
            let t = (f64::from(d) / f64::from(radius)).powi(2).min(1.0);
            assert!((got - (1.0 - t).powi(2)).abs() < 1e-6, "at {d}: {got}");
        }
        assert_eq!(island.falloff(island.centre.0 + radius, island.centre.1), 0);
        assert_eq!(island.falloff(island.centre.0, island.centre.1 - (1 << ISLAND_CELL_BITS) + 1), 0);
    }

    #[test]
    fn open_sea_never_holds_land_weight() {
        let archipelago = Archipelago::new(11);
        let side = 1u32 << 18;
        let mut seas = 0;
        for i in -40..40 {
            for j in -40..40 {
                let (x, z) = (i << 18, j << 18);
                if !archipelago.is_open_sea(x, z, side) {
                    continue;
                }
                seas += 1;
                for (px, pz) in
                    [(x, z), (x + side as i32, z), (x, z + side as i32), (x + (1 << 17), z + (1 << 17))]
                {
                    assert_eq!(archipelago.island_at(px, pz).map_or(0, |island| island.falloff(px, pz)), 0);
                }
            }
        }
        assert!(seas > 1000, "{seas}");
        assert!(!archipelago.is_open_sea(-1000, -1000, 2000), "the origin island is land");
        assert!(
            !archipelago.is_open_sea(-WORLD_HALF, -WORLD_HALF, 1 << 31),
            "the whole world is not open sea"
        );
    }
}
