//! The height of a point: sea floor, dome, hills, ridges, beach.

use crate::constants::{BEACH_M, FINE_BITS, RIDGE_M, SEA_FLOOR_M, UNIT_BITS, UNITS_PER_METRE};
use crate::island::{Archipelago, Island};
use crate::noise::{Fbm, Relief};
use crate::octaves::Octaves;
use crate::position::Position;
use crate::ring::mul_hi;

/// Height of the open sea floor, units.
pub const SEA_FLOOR: i32 = -SEA_FLOOR_M * UNITS_PER_METRE;

/// One world: everything that a 64-bit seed decides.
#[derive(Clone, Copy, Debug)]
pub struct Land {
    world_seed: u64,
    fbm: Fbm,
    archipelago: Archipelago,
}

impl Land {
    /// The world of a seed. Cheap: heights are computed on request.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self { world_seed, fbm: Fbm::new(world_seed), archipelago: Archipelago::new(world_seed) }
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

    /// The height in units of 2^-8 m; sea level is 0.
    #[must_use]
    pub fn height_at(&self, position: Position) -> i32 {
        self.height_keeping(position, Octaves::ALL)
    }

    /// The height with fewer octaves, as a coarse level draws it: [`Octaves::at_level`].
    #[must_use]
    pub fn height_keeping(&self, position: Position, octaves: Octaves) -> i32 {
        let (x, z) = (position.x(), position.z());
        match self.archipelago.island_at(x, z) {
            Some(island) => shape(&island, x, z, || self.fbm.at(x, z, octaves)),
            None => SEA_FLOOR,
        }
    }

    /// The fractal sum under the land.
    #[must_use]
    pub const fn fbm(&self) -> &Fbm {
        &self.fbm
    }
}

/// Composes the height of a point of an island from the noise there. At sea the noise is not
/// evaluated.
///
/// With the falloff `w` the height over the sea floor is `w dome + (2 w - w²) hills + w² ridge`:
/// hills rise twice as fast at the rim as the dome, ridges only far inland. Written as
/// `w (dome + 2 hills) + w² (ridge - hills)`, which takes one product less. A ridge is
/// `64 m (1 - |folds| / 64 m)²`: sharp at its crest, without an edge at its foot.
fn shape(island: &Island, x: i32, z: i32, relief: impl FnOnce() -> Relief) -> i32 {
    let weight = island.falloff(x, z);
    if weight == 0 {
        return SEA_FLOOR;
    }
    let Relief { hills, folds } = relief();
    let squared = mul_hi(weight, weight);
    let crest = ((RIDGE_M << FINE_BITS) - folds.abs()).max(0) << CREST_SHIFT;
    let ridge = mul_hi(crest, crest) >> (CREST_SHIFT - 2);
    let rise = mul_hi(weight, ((island.dome_m << FINE_BITS) + 2 * hills) << 1);
    let bend = mul_hi(squared, (ridge - hills) << 2);
    round_to_units(beach(rise + bend - (SEA_FLOOR_M << FINE_BITS)))
}

/// Left shift that makes 2^-16 m a fraction of [`RIDGE_M`] in Q30.
pub(crate) const CREST_SHIFT: u32 = 30 - FINE_BITS - RIDGE_M.trailing_zeros();

// The beach's coefficients in Q30; products with Q31 powers are Q29. 0.2, 1.6, 0.8 rounded to
// nearest.
pub(crate) const LINEAR_Q29: i32 = 107_374_182;
pub(crate) const CUBIC_Q30: i32 = 1_717_986_918;
pub(crate) const QUINTIC_Q30: i32 = 858_993_459;

/// Flattens the land within [`BEACH_M`] of sea level: the odd polynomial `0.2 r + 1.6 r³ - 0.8 r⁵`
/// (`r` in beach heights) has slope 0.2 at the water line and joins the untouched land with equal
/// value and slope at `|r| = 1`.
fn beach(fine: i32) -> i32 {
    const EDGE: i32 = BEACH_M << FINE_BITS;
    if fine.abs() >= EDGE {
        return fine;
    }
    let r = fine << (31 - FINE_BITS - BEACH_M.trailing_zeros());
    let r2 = mul_hi(r, r) << 1;
    let r4 = mul_hi(r2, r2) << 1;
    let slope_q29 = LINEAR_Q29 + mul_hi(r2, CUBIC_Q30) - mul_hi(r4, QUINTIC_Q30);
    mul_hi(fine << 3, slope_q29)
}

const fn round_to_units(fine: i32) -> i32 {
    const DROPPED: u32 = FINE_BITS - UNIT_BITS;
    (fine + (1 << (DROPPED - 1))) >> DROPPED
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
    fn the_beach_is_the_stated_polynomial_and_joins_smoothly() {
        let edge = BEACH_M << FINE_BITS;
        for fine in (-edge - 10..=edge + 10).step_by(7) {
            let r = f64::from(fine) / f64::from(edge);
            let exact = if r.abs() >= 1.0 { r } else { 0.2 * r + 1.6 * r.powi(3) - 0.8 * r.powi(5) };
            assert!((f64::from(beach(fine)) - exact * f64::from(edge)).abs() < 2.0, "at {fine}");
        }
        assert_eq!(beach(0), 0);
    }

    #[test]
    fn every_home_island_has_sea_beach_hills_and_high_ground() {
        for seed in 0..12 {
            let land = Land::new(seed);
            let (mut sea, mut beach, mut hills, mut high) = (0, 0, 0, 0);
            for i in -110..110 {
                for j in -110..110 {
                    match height(&land, i * 64 * 256, j * 64 * 256) / UNITS_PER_METRE {
                        h if h < -2 => sea += 1,
                        -2..5 => beach += 1,
                        5..120 => hills += 1,
                        _ => high += 1,
                    }
                }
            }
            assert!(
                sea > 10_000 && beach > 400 && hills > 5_000 && high > 3_000,
                "{sea} {beach} {hills} {high}"
            );
        }
    }

    #[test]
    fn heights_stay_far_inside_the_exact_f32_range() {
        let land = Land::new(5);
        for n in 0..200_000u32 {
            let h = height(&land, mix(n) as i32 >> 1, mix(n ^ 0xabcd) as i32 >> 1);
            assert!((SEA_FLOOR - (16 << 8)..600 << 8).contains(&h) && h.abs() < HEIGHT_LIMIT, "{h}");
        }
    }

    #[test]
    fn land_is_continuous_across_every_octave_cell_and_both_signs() {
        let land = Land::new(9);
        for boundary in (0..=18).map(|bits| 1i32 << bits).chain([0, 1 << 22, WORLD_HALF - 1]) {
            for sign in [-1, 1] {
                for shift in crate::constants::OCTAVE_SHIFT {
                    let x = (boundary * sign - shift.0).clamp(-WORLD_HALF, WORLD_HALF - 1);
                    let delta = height(&land, x + 1, 12_345) - height(&land, x, 12_345);
                    // One unit east: a slope below 4 and one unit of rounding.
                    assert!(delta.abs() <= 5, "step {delta} at {x}");
                }
            }
        }
    }
}
