//! Occlusion of chunks of 128 m: visible if any vertex of any clump in them is.

use crate::culling::clump_vertices::clump_vertices;
use crate::culling::clumps::{LEAST_M, exact_test, is_tested, level_of};
use crate::culling::reference::{VisibilityReference, eye_of};
use crate::culling::scene::Scene;
use crate::gpu_probes::cpu_cull::{blocks_of, clumps_of};
use client::features::vegetation::SpeciesParams;
use shaders::twin::placement::BLOCK_CELL_BITS;
use shaders::twin::raymarch_occlusion::raymarch_occlusion_of_corners;
use shaders::twin::surface::{Slots, Surface, TILE_BITS};
use shaders::twin::visibility::{
    BlockExtent, block_extent, block_is_seen, extent_of, may_be_in_view, slope_at,
};
use std::collections::BTreeMap;

/// Visibility of a chunk by the reference and by the tests.
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

/// Every `every`-th of the chunks in view that have plants.
pub fn chunks_of<S: Slots>(
    scene: &Scene,
    reference: &VisibilityReference,
    surface: &Surface<'_, S>,
    species: &SpeciesParams,
    every: usize,
) -> Vec<ChunkVerdict> {
    let (culling, planting, eye) = (&species.culling, &species.planting, eye_of(&scene.shot.pose));
    let tile = |block: [i32; 2]| block.map(|at| (at << (planting.cell_bits + BLOCK_CELL_BITS)) >> TILE_BITS);
    let mut chunks: BTreeMap<[i32; 2], Vec<([i32; 2], BlockExtent)>> = BTreeMap::new();
    for block in blocks_of(species) {
        let bits = planting.cell_bits + BLOCK_CELL_BITS;
        let extent = block_extent(surface, culling, planting, bits, block[0], block[1]);
        let Some(extent) = extent.filter(|block| may_be_in_view(culling, &block.extent)) else { continue };
        chunks.entry(tile(block)).or_default().push((block, extent));
    }
    let clumps = |block: [i32; 2]| {
        clumps_of(surface, species, block).filter(|clump| {
            let slope = || slope_at(surface, clump.x, clump.z);
            is_tested(species, clump)
                && may_be_in_view(culling, &extent_of(culling, planting, clump, slope()))
        })
    };
    let is_tested = culling.occlusion_enabled != 0;
    let mut verdicts = Vec::new();
    for (at, blocks) in chunks.iter().step_by(every) {
        let (mut grows, mut hint_m) = (false, 0.0);
        let is_seen = blocks.iter().flat_map(|(block, _)| clumps(*block)).any(|clump| {
            let vertices = clump_vertices(scene, surface, species, &clump, level_of(species, &clump));
            let is_tested = vertices.height_m >= LEAST_M;
            grows |= is_tested;
            is_tested && reference.sees_any(eye, &vertices.points, &mut hint_m)
        });
        if !grows {
            continue;
        }
        let kept = blocks.iter().filter(|(block, extent)| {
            !is_tested || block_is_seen(surface, culling, planting, block[0], block[1], extent)
        });
        let kept: Vec<[i32; 2]> = kept.map(|(block, _)| *block).collect();
        verdicts.push(ChunkVerdict {
            at: *at,
            is_seen,
            has_clump: kept
                .iter()
                .any(|block| clumps(*block).any(|clump| !exact_test(surface, species, &clump).is_occluded)),
            has_block: !kept.is_empty(),
            has_point: !is_tested
                || !raymarch_occlusion_of_corners(surface, culling, TILE_BITS, at[0], at[1]),
        });
    }
    verdicts
}
