//! Relaxed cones over a height map (Policarpo and Oliveira, GPU Gems 3, chapter 18): for each block
//! of texels the widest cone, tip down on the surface, within which no ray that comes from above
//! enters the relief and leaves it again.
//!
//! The CPU definition; the `bake_cones` shader computes the same and is used for drawing.

use crate::features::pom::height_map::HeightMap;
use std::f64::consts::TAU;

/// Largest radius: wider cones would step over a whole tile.
pub const WIDEST: f32 = 1.0;

/// Most cones along a side; of larger maps, one cone covers a block of texels. The cost grows with
/// the cube of the side.
pub const MOST_CONES: u32 = 256;

/// Sampled directions.
pub const DIRECTIONS: usize = 32;

/// Fraction bits of a direction.
const STEP_BITS: u32 = 12;

/// Unit vectors around the circle, 1/4096 texel: integers, so that CPU and GPU read the same
/// texels.
#[must_use]
pub fn directions() -> [[i32; 2]; DIRECTIONS] {
    std::array::from_fn(|index| {
        let (sin, cos) = (TAU * index as f64 / DIRECTIONS as f64).sin_cos();
        [cos, sin].map(|part| (part * f64::from(1 << STEP_BITS)).round() as i32)
    })
}

/// Side of the block of one cone, texels: 1 up to [`MOST_CONES`] texels a side.
#[must_use]
pub fn block(side: u32) -> u32 {
    (side / MOST_CONES).max(1)
}

/// Radius over height of each block's cone, tiles over the whole height of the relief, row by row.
/// Costs `32 * cones * side` lookups at most.
///
/// A lower tip gives a narrower cone, so the tip is the lowest texel of the block. The limiting
/// heights are read at full resolution: block maxima would close gaps between neighbouring
/// features, where a ray can leave the surface.
///
/// Heights are piecewise constant here, while the march uses the bilinear surface. A cone is
/// therefore safe along its 32 directions through the block centre, except within a texel; between
/// two directions it may step over features narrower than their gap.
#[must_use]
pub fn relaxed_cones(map: &HeightMap, block: u32) -> Vec<f32> {
    let (block, side) = (i64::from(block), map.side() as i64);
    let (cones, directions) = (side / block, directions());
    let top = map.heights().iter().copied().fold(0.0, f32::max);
    let cone = |index: i64| {
        let at = [index % cones, index / cones];
        let within = (0..block * block)
            .map(|step| map.texel(at[0] * block + step % block, at[1] * block + step / block));
        let tip = within.fold(1.0, f32::min);
        // In halves of the directions' unit.
        let middle = at.map(|at| ((2 * at + 1) * block) << STEP_BITS);
        directions.iter().fold(WIDEST, |widest, along| {
            let height = |steps: i64| {
                let [column, row] =
                    [0, 1].map(|axis| (middle[axis] + steps * i64::from(along[axis])) >> (STEP_BITS + 1));
                map.texel(column, row)
            };
            // Through centres of texels: a block's middle is one if it is a single texel, else a
            // corner.
            narrowed((tip, top), side, if block == 1 { 2 } else { 1 }, widest, height)
        })
    };
    (0..cones * cones).map(cone).collect()
}

/// Narrows a cone by one direction, with heights at half texels. A limit is where a ray leaves the
/// surface below the cone: the edge behind which heights fall.
fn narrowed((tip, top): (f32, f32), side: i64, first: i64, widest: f32, height: impl Fn(i64) -> f32) -> f32 {
    let per_half_texel = 0.5 / side as f32;
    let mut ratio = widest;
    let mut here = height(first);
    for steps in (first..=2 * side).step_by(2) {
        let way = steps as f32 * per_half_texel;
        // From here on the cone is above the whole map.
        if ratio * (top - tip) <= way {
            break;
        }
        let next = height(steps + 2);
        if here > tip && next < here {
            // Leaves the surface on the far side of this texel.
            ratio = ratio.min((way + per_half_texel) / (here - tip));
        }
        here = next;
    }
    ratio
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_a_plane_cones_are_as_wide_as_can_be_and_beside_a_post_they_are_not() {
        let plane = HeightMap::of(16, |_, _| 0.5).unwrap();
        assert!(relaxed_cones(&plane, 1).iter().all(|cone| *cone == WIDEST));
        let post =
            HeightMap::of(32, |u, v| f64::from(u8::from((u - 0.5).abs() < 0.1 && (v - 0.5).abs() < 0.1)))
                .unwrap();
        for block in [1, 2] {
            let (cones, side) = (relaxed_cones(&post, block as u32), 32 / block);
            let at = |column: usize, row: usize| cones[row / block * side + column / block];
            assert_eq!(cones.len(), side * side);
            assert_eq!(at(16, 16), WIDEST, "nothing is higher than the top of the post");
            // The post's far side is 0.5 + 0.1 tiles from the middle of the western edge.
            assert!(at(6, 16) < at(0, 16) && (0.2..0.6).contains(&at(6, 16)), "{}", at(6, 16));
        }
    }

    #[test]
    fn a_gap_between_two_blocks_is_not_closed_and_a_slope_that_only_rises_limits_nothing() {
        // Walls of a texel at columns 8 and 10: in blocks of two, the highest texels of both stand
        // side by side.
        let walls =
            HeightMap::of(32, |u, _| f64::from(u8::from([8, 10].contains(&((u * 32.0) as u32))))).unwrap();
        let highest =
            HeightMap::of(16, |u, _| f64::from(u8::from([4, 5].contains(&((u * 16.0) as u32))))).unwrap();
        let (fine, coarse) = (relaxed_cones(&walls, 2), relaxed_cones(&highest, 1));
        // Seen from column 4, the first wall ends at column 9, what has no gap at column 12.
        let expected = |ends: f32| (ends - 5.0) / 32.0;
        assert_eq!((fine[2], coarse[2]), (expected(9.0), expected(12.0)));
        let rising = HeightMap::of(32, |u, _| u).unwrap();
        let eastward = narrowed((0.0, 1.0), 32, 2, WIDEST, |steps| rising.texel(steps / 2, 0));
        // The fall is that from one tile to the next.
        assert!(eastward > 0.9, "{eastward}");
    }

    #[test]
    fn blocks_are_single_texels_up_to_the_most_cones() {
        assert_eq!([1, 64, 256, 512, 4096].map(block), [1, 1, 1, 2, 16]);
    }
}
