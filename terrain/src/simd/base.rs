//! The base field at many points: the statements of [`crate::base`] and [`crate::island`] on
//! vectors.

use super::curves::{clamp, lattice, smoothstep, square, window};
use super::lanes::Lanes;
use crate::base::{Base, INLAND_REACH, MAX_ROUGHNESS, MAX_STEEPNESS, Node, SHORE_REACH};
use crate::constants::{FINE_BITS, MOUNTAIN_M, RIM_M, SEA_FLOOR_M, SHORE_M, UPLIFT_M, WARP_AMPLITUDE_M};
use crate::curves::ALMOST_ONE_Q30;
use crate::island::{CRATER_Q26, Lobe, OFFSET_LIMIT, TWO_Q24};

/// [`crate::base::Node`]s in lanes.
#[derive(Clone, Copy)]
pub(super) struct Nodes<L> {
    pub(super) height: L,
    pub(super) roughness: L,
    pub(super) exposure: L,
}

/// [`Base::at`] of every lane.
///
/// # Safety
/// The CPU has the features of `L`, here and below.
#[inline(always)]
pub(super) unsafe fn nodes<L: Lanes>(base: &Base, lobes: &[Lobe], x: L, z: L, octaves: usize) -> Nodes<L> {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let one = L::splat(ALMOST_ONE_Q30);
        let (mass, height) = mass(base, lobes, x, z);
        if !mass.any() {
            let (floor, zero) = (L::splat(Node::SEA.height), L::splat(0));
            return Nodes { height: floor, roughness: zero, exposure: zero };
        }
        let (exposed, _, _) = lattice::<L, false>(&base.exposure, x, z);
        let exposure = clamp(exposed.add(exposed.shl(1)).sub(L::splat(1 << 24)), 0, 1 << 29);
        let ruggedness = L::splat(3 << 28).add(exposure);
        let mut shore = shore(mass);
        let mut wide_shore = shore;
        let (mut relief, mut slope_x, mut slope_z) = (L::splat(0), L::splat(0), L::splat(0));
        let mut flatness = one;
        for (index, octave) in base.octaves.iter().enumerate().take(octaves) {
            let (value, gradient_x, gradient_z) = lattice::<L, true>(octave, x, z);
            let (gradient_x, gradient_z) = (gradient_x.sar(2), gradient_z.sar(2));
            let folded = if index == 0 {
                (slope_x, slope_z) = (gradient_x, gradient_z);
                value
            } else {
                (slope_x, slope_z) = (slope_x.add(half_more(gradient_x)), slope_z.add(half_more(gradient_z)));
                L::splat(3 << 26).sub(half_more(value.abs()))
            };
            let steepness = slope_x.mul_hi(slope_x).add(slope_z.mul_hi(slope_z));
            flatness = L::splat(MAX_STEEPNESS).sub(steepness).max(L::splat(0)).mul(L::splat(80));
            let squared = flatness.mul_hi(flatness);
            let damping = squared.sub(squared.sar(3)).add(L::splat(1 << 25));
            relief = relief.add(folded.mul_hi(damping).sar(index as u32));
            let added = match index {
                0 | 1 => value.mul_hi(L::splat(SHORE_M[index] << 19)),
                2 => value.mul_hi(L::splat(SHORE_M[2] << 21).mul_hi(ruggedness)),
                _ => {
                    let near = window(clamp(shore, -SHORE_REACH, SHORE_REACH).shl(7));
                    value.mul_hi(near).shl(2).mul_hi(L::splat(SHORE_M[3] << 21).mul_hi(ruggedness))
                }
            };
            shore = shore.add(added);
            if index <= 2 {
                wide_shore = shore;
            }
        }
        let inland = smoothstep(clamp(wide_shore.sub(L::splat(8 << FINE_BITS)), 0, INLAND_REACH).shl(7));
        let share = height.shl(1).mul_hi(inland.shl(1));
        let relief = L::splat(13 << 20).add(relief.mul(L::splat(11)).sar(3)).max(L::splat(0));
        let mountain = share.shl(1).mul_hi(relief.add(L::splat(5 << 20))).shl(5);
        let mountain = mountain.mul_hi(L::splat(MOUNTAIN_M << 19));
        let floor = L::splat(SEA_FLOOR_M << FINE_BITS);
        let sum = lowland(shore).add(mountain).add(floor).max(L::splat(0));
        let rim = mass.min(L::splat((1 << 27) - 1)).shl(3);
        let at_rim = sum.shl(2).mul_hi(smoothstep(rim));
        let raised = mass.select_below(L::splat(1 << 27), at_rim, sum);
        let shown = exposure.sar(14).min(L::splat((1 << 15) - 1));
        Nodes {
            height: raised.sub(floor),
            roughness: roughness(shore, exposure, rim, height, inland, flatness),
            exposure: L::splat(0).select_below(mass, shown, L::splat(0)),
        }
    }
}

/// One and a half times a number.
#[inline(always)]
unsafe fn half_more<L: Lanes>(value: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe { value.add(value.sar(1)) }
}

/// [`crate::island::Mass::at`] of warped points: mass and height.
#[inline(always)]
unsafe fn mass<L: Lanes>(base: &Base, lobes: &[Lobe], x: L, z: L) -> (L, L) {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let one = L::splat(ALMOST_ONE_Q30);
        let warp_x = warp(base, 0, x, z).add(warp(base, 2, x, z));
        let warp_z = warp(base, 1, x, z).add(warp(base, 3, x, z));
        let (mut mass_left, mut height_left) = (one, one);
        for lobe in lobes {
            let (dx, dz) = (offset(x, lobe.centre.0, warp_x), offset(z, lobe.centre.1, warp_z));
            let (along, across) = (axis_squared(dx, dz, lobe.long), axis_squared(dx, dz, lobe.short));
            let u = L::splat((1 << 26) - 1).sub(along).sub(across).max(L::splat(0));
            if !u.any() {
                continue;
            }
            let s = square(u.shl(4));
            let inner = L::splat(lobe.mass.0 << 24).add(s.sar(6).mul(L::splat(lobe.mass.1)));
            let taken = clamp(s.shl(1).mul_hi(inner), 0, (1 << 26) - 1);
            mass_left = mass_left.sub(mass_left.mul_hi(taken.shl(5)).shl(1));
            let mut top = s.min(L::splat(ALMOST_ONE_Q30 >> lobe.plateau)).shl(lobe.plateau);
            if lobe.crater {
                let w = u.sub(L::splat(CRATER_Q26)).max(L::splat(0)).shl(8);
                top = top.sub(square(w).sar(4).mul(L::splat(7)));
            }
            let taken = top.sar(8).mul(L::splat(lobe.height));
            height_left = height_left.sub(height_left.mul_hi(taken.shl(1)).shl(1));
        }
        (one.sub(mass_left), one.sub(height_left))
    }
}

/// One of the four noises of the warp, Q16 metres.
#[inline(always)]
unsafe fn warp<L: Lanes>(base: &Base, index: usize, x: L, z: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let (value, _, _) = lattice::<L, false>(&base.warp[index], x, z);
        value.mul_hi(L::splat(WARP_AMPLITUDE_M[index / 2] << 19))
    }
}

/// [`crate::island::offset`].
#[inline(always)]
unsafe fn offset<L: Lanes>(coordinate: L, centre: i32, warp: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let units = clamp(coordinate.sub(L::splat(centre)), -OFFSET_LIMIT >> 8, OFFSET_LIMIT >> 8);
        clamp(units.shl(8).add(warp), -OFFSET_LIMIT, OFFSET_LIMIT - 1).shl(2)
    }
}

/// The square of a point along an axis of a lobe, Q26.
#[inline(always)]
unsafe fn axis_squared<L: Lanes>(x: L, z: L, axis: (i32, i32)) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let along = x.mul_hi(L::splat(axis.0)).add(z.mul_hi(L::splat(axis.1)));
        let along = clamp(along, -TWO_Q24, TWO_Q24).shl(5);
        along.mul_hi(along)
    }
}

/// [`crate::base`]'s shore without noise.
#[inline(always)]
unsafe fn shore<L: Lanes>(mass: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let rim = L::splat(ALMOST_ONE_Q30).sub(mass.min(L::splat((1 << 27) - 1)).shl(3));
        let middle = mass.sub(L::splat(5 << 27)).max(L::splat(0));
        square(middle).mul_hi(L::splat(UPLIFT_M << 18)).sub(square(rim).mul_hi(L::splat(RIM_M << 18)))
    }
}

/// [`crate::base`]'s land below the mountains.
#[inline(always)]
unsafe fn lowland<L: Lanes>(shore: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let near = shore.min(L::splat((1 << 21) - 1));
        // Half of the shore on both sides of the water line; the square is subtracted on land.
        let bend = square(near.max(L::splat(0)).shl(9)).sar(11);
        shore.sar(5).add(near.sar(1).sub(bend))
    }
}

/// [`crate::base`]'s share of the fine octaves.
#[inline(always)]
unsafe fn roughness<L: Lanes>(shore: L, exposure: L, rim: L, height: L, inland: L, flatness: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let near = window(clamp(shore, 1 - (1 << 21), (1 << 21) - 1).shl(9));
        let coast = near.shl(1).mul_hi(L::splat(9 << 27).add(exposure.sar(2).mul(L::splat(3))));
        let inland_twice = inland.shl(1);
        let foot = inland_twice.mul_hi(L::splat(ALMOST_ONE_Q30).sub(inland).shl(1));
        let rocky = inland_twice.mul_hi(flatness.shl(1)).add(foot.shl(1)).add(foot.sar(1));
        let sum = coast.sar(1).add(height.shl(1).mul_hi(rocky)).add(L::splat(1 << 23));
        let sum = sum.min(L::splat(MAX_ROUGHNESS)).shl(2);
        sum.mul_hi(rim.shl(1)).add(L::splat(1 << 14)).sar(15)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::island::Archipelago;

    #[test]
    fn nodes_equal_the_definition() {
        let (base, archipelago) = (Base::new(7), Archipelago::new(7));
        for n in 0..200_000u32 {
            let (x, z) = (crate::hash::mix(n) as i32 >> 9, crate::hash::mix(!n) as i32 >> 9);
            let lobes = archipelago.lobes_near(x, z, 1);
            let expected = base.at(&lobes, (x, z), 4);
            let got = unsafe { nodes::<i32>(&base, &lobes, x, z, 4) };
            assert_eq!(
                (got.height, got.roughness, got.exposure),
                (expected.height, expected.roughness, expected.exposure),
                "{x} {z}"
            );
        }
    }
}
