//! The base field: everything wider than 128 m, evaluated at the nodes of a lattice of 32 m.
//!
//! At a node the coast is warped, the lobes of islands are joined, and four octaves of noise are
//! added twice: plainly to the *shore* (negative at sea, positive inland), and damped by their own
//! gradient and folded into ridges to the mountains, which rise where the shore is high. Octaves
//! that are shared join valleys with bays. Derivative damping follows Quilez, "Elevated" (2008),
//! with a polynomial instead of a division; the ridges follow Musgrave, "Texturing and Modeling"
//! (2003), chapter 16.

use crate::constants::{
    BASE_CELL_BITS, BASE_OCTAVES, BASE_STREAM, EXPOSURE_CELL_BITS, EXPOSURE_STREAM, FINE_BITS, MOUNTAIN_M,
    RIM_M, SEA_FLOOR_M, SHORE_M, UPLIFT_M, WARP_AMPLITUDE_M, WARP_CELL_BITS, WARP_STREAM,
};
use crate::curves::{ALMOST_ONE_Q30, smoothstep, square, window};
use crate::island::{Lobe, Mass};
use crate::lattice::{Lattice, Sample};
use crate::ring::mul_hi;

/// Noises of the base field, each a stream of the world seed from [`BASE_STREAM`] on.
pub const LATTICES: usize = 9;

/// The base field of one world.
#[derive(Clone, Copy, Debug)]
pub struct Base {
    /// Octaves, widest first.
    pub(crate) octaves: [Lattice; BASE_OCTAVES],
    /// Noises of the warp along x (even) and z (odd), widest first.
    pub(crate) warp: [Lattice; 4],
    pub(crate) exposure: Lattice,
}

/// The base field at a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Node {
    /// Height without fine octaves and coasts, 2^-16 m.
    pub height: i32,
    /// Share of the fine octaves, Q15.
    pub roughness: i32,
    /// Beach (0) or cliff (2^15 - 1), Q15.
    pub exposure: i32,
}

impl Node {
    /// The open sea.
    pub const SEA: Self = Self { height: -SEA_FLOOR_M << FINE_BITS, roughness: 0, exposure: 0 };
}

impl Base {
    /// The base field of a world seed.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        let lattice = |stream: u32, bits: u32| Lattice::new(world_seed, stream, bits);
        Self {
            octaves: std::array::from_fn(|o| lattice(BASE_STREAM + o as u32, BASE_CELL_BITS - o as u32)),
            warp: std::array::from_fn(|n| lattice(WARP_STREAM + n as u32, WARP_CELL_BITS[n / 2])),
            exposure: lattice(EXPOSURE_STREAM, EXPOSURE_CELL_BITS),
        }
    }

    /// The seeds of all its noises in the order of their streams: octaves, warp, exposure.
    #[must_use]
    pub fn seeds(&self) -> [u32; LATTICES] {
        let lattices = self.octaves.iter().chain(&self.warp).chain([&self.exposure]);
        let mut seeds = [0; LATTICES];
        seeds.iter_mut().zip(lattices).for_each(|(seed, lattice)| *seed = lattice.seed);
        seeds
    }

    /// The field at a point (units), from the lobes that may touch it and the octaves that are
    /// kept, at most [`BASE_OCTAVES`].
    #[must_use]
    pub fn at(&self, lobes: &[Lobe], (x, z): (i32, i32), octaves: usize) -> Node {
        if lobes.is_empty() {
            return Node::SEA;
        }
        let Mass { mass, height } = Mass::at(lobes, (x, z), self.warp(x, z));
        if mass == 0 {
            return Node::SEA;
        }
        // Q29: 0 to 1.
        let exposure = (3 * self.exposure.at(x, z).value - (1 << 24)).clamp(0, 1 << 29);
        // Q30: 3/4 to 5/4.
        let ruggedness = (3 << 28) + exposure;
        let mut shore = shore(mass);
        let mut wide_shore = shore;
        let mut relief = 0;
        // Five times the sum of gradients, Q24; five because of the turned axes.
        let (mut slope_x, mut slope_z) = (0, 0);
        let mut flatness = ALMOST_ONE_Q30;
        for (index, octave) in self.octaves.iter().enumerate().take(octaves) {
            let sample = octave.at(x, z);
            let (gradient_x, gradient_z) = octave.turn.back(sample.gradient);
            // The folded octaves count one and a half times.
            let fold = |value: i32| if index == 0 { value } else { value + (value >> 1) };
            slope_x += fold(gradient_x >> 2);
            slope_z += fold(gradient_z >> 2);
            flatness = flatness_of(slope_x, slope_z);
            let damping = damping(flatness);
            let folded = if index == 0 { sample.value } else { (3 << 26) - fold(sample.value.abs()) };
            relief += mul_hi(folded, damping) >> index;
            shore += match index {
                0 | 1 => mul_hi(sample.value, SHORE_M[index] << 19),
                2 => mul_hi(sample.value, mul_hi(SHORE_M[2] << 21, ruggedness)),
                _ => {
                    let amplitude = mul_hi(SHORE_M[3] << 21, ruggedness);
                    let near = window(shore.clamp(-SHORE_REACH, SHORE_REACH) << 7);
                    mul_hi(mul_hi(sample.value, near) << 2, amplitude)
                }
            };
            if index <= 2 {
                wide_shore = shore;
            }
        }
        let inland = smoothstep((wide_shore - (8 << FINE_BITS)).clamp(0, INLAND_REACH) << 7);
        // Mountains: a share in Q30 of relief in Q25.
        let share = mul_hi(height << 1, inland << 1);
        let relief = ((13 << 20) + ((relief * 11) >> 3)).max(0) + (5 << 20);
        let mountain = mul_hi(mul_hi(share << 1, relief) << 5, MOUNTAIN_M << 19);
        let sum = (lowland(shore) + mountain + (SEA_FLOOR_M << FINE_BITS)).max(0);
        let rim = mass.min((1 << 27) - 1) << 3;
        let raised = if mass < 1 << 27 { mul_hi(sum << 2, smoothstep(rim)) } else { sum };
        Node {
            height: raised - (SEA_FLOOR_M << FINE_BITS),
            roughness: roughness(shore, exposure, rim, height, inland, flatness),
            exposure: (exposure >> 14).min((1 << 15) - 1),
        }
    }

    /// One of the octaves at a point, units.
    #[must_use]
    pub fn octave(&self, index: usize, x: i32, z: i32) -> Sample {
        self.octaves[index].at(x, z)
    }

    /// The displacement of a coast, Q16 metres along x and z.
    #[must_use]
    pub fn warp(&self, x: i32, z: i32) -> (i32, i32) {
        let part = |index: usize| mul_hi(self.warp[index].at(x, z).value, WARP_AMPLITUDE_M[index / 2] << 19);
        (part(0) + part(2), part(1) + part(3))
    }
}

/// Within this distance of the water line (128 m of shore, 2^-16 m) the finest octave shapes it.
pub(crate) const SHORE_REACH: i32 = (1 << 23) - 1;
/// Range of shore beyond 8 m over which mountains rise, 2^-16 m.
pub(crate) const INLAND_REACH: i32 = (1 << 23) - 1;

/// The shore without noise, 2^-16 m: the rim of the mass lies deep, its middle high.
fn shore(mass: i32) -> i32 {
    let rim = ALMOST_ONE_Q30 - (mass.min((1 << 27) - 1) << 3);
    let middle = (mass - (5 << 27)).max(0);
    mul_hi(square(middle), UPLIFT_M << 18) - mul_hi(square(rim), RIM_M << 18)
}

/// The squared sum of gradients at which the flatness is zero: 204.8 in Q16, 8.19 per cell.
pub(crate) const MAX_STEEPNESS: i32 = 13_421_772;

/// How flat the octaves so far are, Q30: `1 - |5 gradient|² / 204.8`, not below zero.
fn flatness_of(slope_x: i32, slope_z: i32) -> i32 {
    let steepness = mul_hi(slope_x, slope_x) + mul_hi(slope_z, slope_z);
    (MAX_STEEPNESS - steepness).max(0) * 80
}

/// The factor of an octave, Q28: 1/8 on steep land, 1 on flat land.
fn damping(flatness: i32) -> i32 {
    let squared = mul_hi(flatness, flatness);
    squared - (squared >> 3) + (1 << 25)
}

/// Height of the land below the mountains, 2^-16 m: a shelf of half the shore's slope, a plain at
/// 8 m from 32 m of shore on, and 1/32 of the shore.
fn lowland(shore: i32) -> i32 {
    (shore >> 5)
        + if shore < 0 {
            shore >> 1
        } else {
            let near = shore.min((1 << 21) - 1);
            (near >> 1) - (square(near << 9) >> 11)
        }
}

/// The share of the fine octaves, Q15.
fn roughness(shore: i32, exposure: i32, rim: i32, height: i32, inland: i32, flatness: i32) -> i32 {
    // Near the water line: 9/16 where sheltered, 3/4 where exposed.
    let near = window(shore.clamp(1 - (1 << 21), (1 << 21) - 1) << 9);
    let coast = mul_hi(near << 1, (9 << 27) + (exposure >> 2) * 3);
    // In the mountains where they are flat, and on their feet.
    let foot = mul_hi(inland << 1, (ALMOST_ONE_Q30 - inland) << 1);
    let rocky = mul_hi(inland << 1, flatness << 1) + foot * 2 + (foot >> 1);
    // Everywhere 1/64. Q29, so that the sum fits; rounded once, because a cliff multiplies errors.
    let sum = (coast >> 1) + mul_hi(height << 1, rocky) + (1 << 23);
    // Nothing at the rim, where the sea floor begins.
    (mul_hi(sum.min(MAX_ROUGHNESS) << 2, rim << 1) + (1 << 14)) >> 15
}

/// The largest share of the fine octaves that rounds to less than one, Q29.
pub(crate) const MAX_ROUGHNESS: i32 = (1 << 29) - (1 << 14);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_the_fine_octaves_has_its_parts_and_stays_below_one() {
        let (one, rim, inland) = (ALMOST_ONE_Q30, ((1 << 27) - 1) << 3, (3 << 28) - 1);
        let share = |shore, exposure, height, inland| roughness(shore, exposure, rim, height, inland, one);
        // 1/64 everywhere; at the water line 9/16 more where sheltered, 3/4 where exposed.
        assert_eq!(share(1 << 24, 0, 0, inland), 512);
        assert_eq!(share(0, 0, 0, 0), 512 + 9 * 2048);
        assert_eq!(share(0, 1 << 29, 0, 0), 512 + 3 * 8192);
        // On the foot of the highest mountain the parts add up to more than one.
        assert_eq!(share(1 << 24, 0, one, inland), (1 << 15) - 1);
    }
}
