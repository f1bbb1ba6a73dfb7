//! The height of a point: base field, fine octaves, coast.

use crate::base::{Base, Node};
use crate::constants::{SEA_FLOOR_M, UNITS_PER_METRE};
use crate::island::{Archipelago, Lobe};
use crate::noise::Fbm;
use crate::octaves::Octaves;
use crate::position::Position;
use crate::ring::mul_hi;
use crate::shape::coast;
use crate::spline;

/// Height of the open sea floor, units.
pub const SEA_FLOOR: i32 = -SEA_FLOOR_M * UNITS_PER_METRE;

/// One world: everything that a 64-bit seed decides.
#[derive(Clone, Copy, Debug)]
pub struct Land {
    world_seed: u64,
    fbm: Fbm,
    base: Base,
    archipelago: Archipelago,
}

impl Land {
    /// The world of a seed. Cheap: heights are computed on request.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self {
            world_seed,
            fbm: Fbm::new(world_seed),
            base: Base::new(world_seed),
            archipelago: Archipelago::new(world_seed),
        }
    }

    /// The seed of this world.
    #[must_use]
    pub const fn world_seed(&self) -> u64 {
        self.world_seed
    }

    /// The islands of this world.
    #[must_use]
    pub const fn archipelago(&self) -> &Archipelago {
        &self.archipelago
    }

    /// The base field under the land.
    #[must_use]
    pub const fn base(&self) -> &Base {
        &self.base
    }

    /// The fine octaves.
    #[must_use]
    pub const fn fbm(&self) -> &Fbm {
        &self.fbm
    }

    /// The height in units of 2^-8 m; sea level is 0.
    #[must_use]
    pub fn height_at(&self, position: Position) -> i32 {
        self.height_keeping(position, Octaves::ALL)
    }

    /// The height with fewer octaves, as a coarse level draws it: [`Octaves::at_level`].
    #[must_use]
    pub fn height_keeping(&self, position: Position, octaves: Octaves) -> i32 {
        let (x, z) = (position.x(), position.z());
        // All nodes of a spline lie within two cells.
        const NEAR: i32 = 2 << spline::CELL_BITS;
        let lobes = self.archipelago.lobes_near(x - NEAR, z - NEAR, 2 * NEAR as u32);
        if lobes.is_empty() {
            return SEA_FLOOR;
        }
        let node = self.node_keeping(&lobes, (x, z), octaves);
        let fine = if node.roughness == 0 { 0 } else { self.fbm.at(x, z, octaves) };
        // Q25 times Q23 of 2^-16 m and Q15.
        coast(node.height + mul_hi(fine << 9, node.roughness << 8), node.exposure)
    }

    /// The base field at a point: a spline of the nodes around it, or the field itself.
    fn node_keeping(&self, lobes: &[Lobe], (x, z): (i32, i32), octaves: Octaves) -> Node {
        if !octaves.splined() {
            return self.base.at(lobes, (x, z), octaves.base());
        }
        let ((cell_x, t_x), (cell_z, t_z)) = (spline::cell(x), spline::cell(z));
        let columns = [-1, 0, 1].map(|east| {
            let rows = [-1, 0, 1].map(|south| {
                let place = (spline::node(cell_x + east), spline::node(cell_z + south));
                self.base.at(lobes, place, octaves.base())
            });
            splined(rows, t_z)
        });
        splined(columns, t_x)
    }
}

/// The spline of three nodes at a fraction of the cell, Q13.
fn splined(nodes: [Node; 3], t: i32) -> Node {
    let weights = spline::weights(t);
    Node {
        height: spline::height(nodes.map(|node| node.height), t),
        roughness: spline::share(nodes.map(|node| node.roughness), weights),
        exposure: spline::share(nodes.map(|node| node.exposure), weights),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::{HEIGHT_LIMIT, WORLD_HALF};
    use crate::hash::mix;

    fn height(land: &Land, x: i32, z: i32) -> i32 {
        land.height_at(Position::new(x, z).unwrap())
    }

    #[test]
    fn every_home_island_has_sea_beach_plains_and_mountains() {
        for seed in 0..8 {
            let land = Land::new(seed);
            let (mut sea, mut shore, mut low, mut high) = (0, 0, 0, 0);
            for i in -50..50 {
                for j in -50..50 {
                    match height(&land, i * 128 * 256, j * 128 * 256) / UNITS_PER_METRE {
                        h if h < -2 => sea += 1,
                        -2..5 => shore += 1,
                        5..100 => low += 1,
                        _ => high += 1,
                    }
                }
            }
            assert!(sea > 2_000 && shore > 50 && low > 500 && high > 100, "{sea} {shore} {low} {high}");
        }
    }

    #[test]
    fn heights_stay_far_inside_the_exact_f32_range() {
        let land = Land::new(5);
        for n in 0..20_000u32 {
            let h = height(&land, mix(n) as i32 >> 8, mix(n ^ 0xabcd) as i32 >> 8);
            assert!((SEA_FLOOR - (22 << 8)..1500 << 8).contains(&h) && h.abs() < HEIGHT_LIMIT, "{h}");
        }
    }

    #[test]
    fn land_is_continuous_across_every_cell_and_both_signs() {
        let land = Land::new(9);
        for boundary in (0..=21).map(|bits| 1i32 << bits).chain([0, WORLD_HALF - 1]) {
            for sign in [-1, 1] {
                for shift in crate::constants::OCTAVE_SHIFT {
                    let x = (boundary * sign - shift.0).clamp(-WORLD_HALF, WORLD_HALF - 1);
                    let delta = height(&land, x + 1, 12_345) - height(&land, x, 12_345);
                    // One unit east: a slope below 15 on a cliff and one unit of rounding.
                    assert!(delta.abs() <= 16, "step {delta} at {x}");
                }
            }
        }
    }
}
