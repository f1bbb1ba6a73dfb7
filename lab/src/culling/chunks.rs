//! Chunks of 128 m, judged by all of their clumps: seen if any vertex of any clump in them is.

use crate::culling::leaves::leaves_of;
use crate::culling::oracle::{Oracle, eye_of};
use crate::culling::scene::Scene;
use crate::culling::sight::{LEAST_M, is_judged, judged, level_of};
use client::plants::Stand;
use client::plants::kept::{blocks_of, clumps_of};
use shaders::twin::march::five_points_are_hidden;
use shaders::twin::planting::{BLOCK_CELL_BITS, Extent, block_extent, extent_of, may_be_in_view, slope_at};
use shaders::twin::sight::is_hidden;
use shaders::twin::surface::{Slots, Surface, TILE_BITS};
use std::collections::BTreeMap;

/// What sight and the tests say of a chunk.
#[derive(Clone, Copy, Debug)]
pub struct ChunkVerdict {
    /// Column and row in the square.
    pub at: [i32; 2],
    /// Whether any vertex of any clump is seen.
    pub is_seen: bool,
    /// Whether T4 keeps a clump of it.
    pub has_clump: bool,
    /// Whether T4 keeps a block of it.
    pub has_block: bool,
    /// Whether the test by five points keeps it.
    pub has_point: bool,
}

/// Of the chunks in view in which something grows, every so many-th.
#[must_use]
pub fn chunks_of<S: Slots>(
    scene: &Scene,
    oracle: &Oracle,
    surface: &Surface<'_, S>,
    stand: &Stand,
    every: usize,
) -> Vec<ChunkVerdict> {
    let (culling, planting, eye) = (&stand.culling, &stand.planting, eye_of(&scene.shot.pose));
    let tile = |block: [i32; 2]| block.map(|at| (at << (planting.cell_bits + BLOCK_CELL_BITS)) >> TILE_BITS);
    let mut chunks: BTreeMap<[i32; 2], Vec<([i32; 2], Extent)>> = BTreeMap::new();
    for block in blocks_of(stand) {
        let extent = block_extent(surface, culling, planting, block[0], block[1]);
        let Some(extent) = extent.filter(|extent| may_be_in_view(culling, extent)) else { continue };
        chunks.entry(tile(block)).or_default().push((block, extent));
    }
    let clumps = |block: [i32; 2]| {
        clumps_of(surface, stand, block).filter(|clump| {
            let slope = || slope_at(surface, clump.x, clump.z);
            is_judged(stand, clump) && may_be_in_view(culling, &extent_of(culling, planting, clump, slope()))
        })
    };
    let asks = culling.sees_land != 0;
    let mut verdicts = Vec::new();
    for (at, blocks) in chunks.iter().step_by(every) {
        let (mut grows, mut hint_m) = (false, 0.0);
        let is_seen = blocks.iter().flat_map(|(block, _)| clumps(*block)).any(|clump| {
            let leaves = leaves_of(scene, surface, stand, &clump, level_of(stand, &clump));
            let is_judged = leaves.height_m >= LEAST_M;
            grows |= is_judged;
            is_judged && oracle.sees_any(eye, &leaves.points, &mut hint_m)
        });
        if !grows {
            continue;
        }
        let kept = blocks
            .iter()
            .filter(|(_, extent)| !asks || !is_hidden(surface, culling.eye, &extent.target, culling.start));
        let kept: Vec<[i32; 2]> = kept.map(|(block, _)| *block).collect();
        verdicts.push(ChunkVerdict {
            at: *at,
            is_seen,
            has_clump: kept
                .iter()
                .any(|block| clumps(*block).any(|clump| !judged(surface, stand, &clump).is_hidden)),
            has_block: !kept.is_empty(),
            has_point: !asks || !five_points_are_hidden(surface, culling, TILE_BITS, at[0], at[1]),
        });
    }
    verdicts
}
