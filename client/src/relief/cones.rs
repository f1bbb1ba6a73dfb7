//! Relaxed cones over a height map (Policarpo and Oliveira, GPU Gems 3, chapter 18): for each block
//! of texels the widest cone, tip down on the surface, within which no ray that comes from above
//! enters the relief and leaves it again.
//!
//! The definition, on the CPU; `bake_cones.wesl` is its twin and what is drawn with.

use crate::relief::HeightMap;
use std::f64::consts::TAU;

/// Wider cones would step over a whole tile.
pub const WIDEST: f32 = 1.0;

/// Cones along a side at most; of larger maps a cone holds for a block of texels. The work grows
/// with the cube of the map's side.
pub const MOST_CONES: u32 = 256;

/// Directions in which a cone looks for what limits it.
pub const DIRECTIONS: usize = 32;

/// Fraction bits of a direction.
const STEP_BITS: u32 = 12;

/// Unit vectors all around, 1/4096 texels along u and v: integers, so that the CPU and a GPU look
/// at the same texels.
#[must_use]
pub fn directions() -> [[i32; 2]; DIRECTIONS] {
    std::array::from_fn(|index| {
        let (sin, cos) = (TAU * index as f64 / DIRECTIONS as f64).sin_cos();
        [cos, sin].map(|part| (part * f64::from(1 << STEP_BITS)).round() as i32)
    })
}

/// Texels a side of the block that one cone of a map holds for: 1 up to [`MOST_CONES`] texels a
/// side.
#[must_use]
pub fn block(side: u32) -> u32 {
    (side / MOST_CONES).max(1)
}

/// Radius over height of each block's cone, tiles over the whole height of the relief, row by row.
/// Costs `32 * cones * side` lookups at most.
///
/// A lower tip makes a narrower cone, so the tip is the block's lowest texel. What limits it is
/// looked for at full resolution: the highest texel of each block would close the gaps between what
/// stands in two blocks, and a gap is where a ray comes out.
///
/// Heights are taken as steps, each texel as wide as it is, not as the bilinear surface between
/// centres of texels that is marched. So a cone is safe for that surface along its 32 directions,
/// for rays through the block's middle and but for what happens within a texel; between two
/// directions it may step over what is narrower than their gap. That is what makes cones nearly
/// safe only.
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

/// The cone after one direction, whose heights are asked for by half texels. A ray limits it where
/// it has gone through something and comes out again below the tip's cone: the narrowest such cone
/// passes through the edge where the relief falls off.
fn narrowed((tip, top): (f32, f32), side: i64, first: i64, widest: f32, height: impl Fn(i64) -> f32) -> f32 {
    let per_half_texel = 0.5 / side as f32;
    let mut ratio = widest;
    let mut here = height(first);
    for steps in (first..=2 * side).step_by(2) {
        let way = steps as f32 * per_half_texel;
        // Beyond this distance the cone is above the whole map.
        if ratio * (top - tip) <= way {
            break;
        }
        let next = height(steps + 2);
        if here > tip && next < here {
            // Out of the relief on the far side of this texel.
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
