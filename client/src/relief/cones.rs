//! Relaxed cones over a height map (Policarpo and Oliveira, GPU Gems 3, chapter 18): for each texel the widest cone, tip down on its surface, within which
//! no ray that comes from above enters the relief and leaves it again.

use crate::relief::HeightMap;
use std::f32::consts::TAU;

/// Wider cones would step over a whole tile.
pub const WIDEST: f32 = 1.0;

/// Directions in which a cone looks for what limits it.
const DIRECTIONS: usize = 32;

/// Radius over height of each texel's cone, tiles, row by row. Costs `32 * side^3` lookups at most: for maps of some 256 texels a side.
///
/// Looks along 32 directions texel by texel, so it may step over what is narrower than the gap between two of them. That is what makes cones nearly
/// safe only, besides that a cone holds for the whole texel at whose centre it was found.
#[must_use]
pub fn relaxed_cones(map: &HeightMap) -> Vec<f32> {
    let side = map.side() as i64;
    let way = |direction: usize| {
        let angle = TAU * direction as f32 / DIRECTIONS as f32;
        (angle.cos(), angle.sin())
    };
    let cone = |index: usize| {
        let (column, row) = (index as i64 % side, index as i64 / side);
        let tip = map.texel(column, row);
        (0..DIRECTIONS).map(way).fold(WIDEST, |widest, (east, south)| {
            let height = |steps: i64| {
                let at = |start: i64, part: f32| start + (steps as f32 * part).round() as i64;
                map.texel(at(column, east), at(row, south))
            };
            narrowed(tip, side, widest, height)
        })
    };
    (0..map.heights().len()).map(cone).collect()
}

/// The cone after one direction. A ray limits it where it has gone through something and comes out again below the tip's cone: the narrowest such cone passes
/// through the edge where the relief falls off.
fn narrowed(tip: f32, side: i64, widest: f32, height: impl Fn(i64) -> f32) -> f32 {
    let mut ratio = widest;
    for steps in 1..=side {
        let way = steps as f32 / side as f32;
        // Beyond this distance the cone is above everything.
        if ratio * (1.0 - tip) <= way {
            break;
        }
        let (here, next) = (height(steps), height(steps + 1));
        if here > tip && next < here {
            // Out of the relief on the far side of this texel.
            ratio = ratio.min((way + 0.5 / side as f32) / (here - tip));
        }
    }
    ratio
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_a_plane_cones_are_as_wide_as_can_be_and_beside_a_post_they_are_not() {
        let plane = HeightMap::of(16, |_, _| 0.5).unwrap();
        assert!(relaxed_cones(&plane).iter().all(|cone| *cone == WIDEST));
        let post =
            HeightMap::of(32, |u, v| f64::from(u8::from((u - 0.5).abs() < 0.1 && (v - 0.5).abs() < 0.1)))
                .unwrap();
        let cones = relaxed_cones(&post);
        let at = |column: usize, row: usize| cones[row * 32 + column];
        assert_eq!(at(16, 16), WIDEST, "nothing is higher than the top of the post");
        // The post's far side is 0.5 + 0.1 tiles from the middle of the western edge.
        assert!(at(6, 16) < at(0, 16) && (0.2..0.6).contains(&at(6, 16)), "{}", at(6, 16));
    }
}
