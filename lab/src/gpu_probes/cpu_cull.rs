//! Vegetation culling on the CPU: the reference of the GPU passes, in the same order.

use client::cache::ChunkCache;
use client::cache::vertical_scale::scaled_height;
use client::features::vegetation::by_slot::BySlot;
use client::features::vegetation::occlusion_grid::OcclusionGrid;
use client::features::vegetation::species::{SpeciesParams, VegetationFrame};
use shaders::layout::{CULL_MARCH, NOISE_OCTAVES};
use shaders::twin::placement::{BLOCK_CELL_BITS, BLOCK_CELLS, Clump, PATCH_BLOCKS, clump_at};
use shaders::twin::raymarch_occlusion::raymarch_occlusion_of_corners;
use shaders::twin::surface::{FINE_BITS, Slots, Surface};
use shaders::twin::visibility::{block_is_visible, visible_level};
use terrain::land::SEA_FLOOR;
use terrain::{Octaves, Position};

/// A visible clump.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct VisibleClump {
    /// Level of detail.
    pub detail: u32,
    /// The clump.
    pub clump: Clump,
}

/// The visible clumps of a species.
#[must_use]
pub fn cull_on_cpu(
    cache: &ChunkCache,
    plants: &VegetationFrame,
    species: &SpeciesParams,
) -> Vec<VisibleClump> {
    let slots = BySlot::new(cache);
    let grid = &plants.grid;
    let surface = Surface { slots: &slots, nodes: &grid.nodes, chunks: &grid.chunks };
    let (culling, planting) = (&species.culling, &species.planting);
    let noise = noise_of(cache, grid);
    let is_march = culling.path == CULL_MARCH && culling.occlusion_enabled != 0;
    let patch_bits = planting.cell_bits + BLOCK_CELL_BITS + PATCH_BLOCKS.ilog2();
    let patches = species.patches.iter().copied().filter(|[column, row]| {
        !is_march || !raymarch_occlusion_of_corners(&surface, culling, patch_bits, *column, *row)
    });
    let blocks = patches
        .flat_map(blocks_of_patch)
        .filter(|[column, row]| block_is_visible(&surface, culling, planting, *column, *row));
    let clumps = blocks.flat_map(|block| clumps_of(&surface, species, block).collect::<Vec<_>>());
    let test = |clump: Clump| {
        visible_level(&surface, &noise, culling, planting, &clump)
            .map(|detail| VisibleClump { detail, clump })
    };
    clumps.filter_map(test).collect()
}

/// Height of the noise at a grid position, fine units: the input of T2. The sea floor without a
/// known seed.
pub fn noise_of(cache: &ChunkCache, grid: &OcclusionGrid) -> impl Fn(i32, i32) -> i32 {
    let (land, corner, scale) = (cache.land().copied(), grid.corner, cache.vertical_scale());
    let octaves = Octaves::new(NOISE_OCTAVES).expect("fewer than the land has");
    move |x: i32, z: i32| {
        let at = Position::new(corner[0] + (x >> FINE_BITS), corner[1] + (z >> FINE_BITS));
        match (&land, at) {
            (Some(land), Ok(at)) => scaled_height(land.height_keeping(at, octaves), scale) << FINE_BITS,
            _ => SEA_FLOOR << FINE_BITS,
        }
    }
}

/// All blocks of a species' patches, column and row in the grid.
pub fn blocks_of(species: &SpeciesParams) -> impl Iterator<Item = [i32; 2]> {
    species.patches.iter().copied().flat_map(blocks_of_patch)
}

/// The blocks of a patch, column and row in the grid.
pub fn blocks_of_patch([column, row]: [i32; 2]) -> impl Iterator<Item = [i32; 2]> {
    let side = PATCH_BLOCKS as i32;
    let (west, north) = (column * side, row * side);
    (0..side * side).map(move |index| [west + index % side, north + index / side])
}

/// All clumps of a block, visible or not, in the order of the GPU passes.
pub fn clumps_of<'a, S: Slots>(
    surface: &'a Surface<'a, S>,
    species: &'a SpeciesParams,
    [column, row]: [i32; 2],
) -> impl Iterator<Item = Clump> + 'a {
    let cells = 1 << BLOCK_CELL_BITS;
    (0..species.planting.per_cell * BLOCK_CELLS).filter_map(move |lane| {
        let (cell, index) = ((lane % BLOCK_CELLS) as i32, lane / BLOCK_CELLS);
        clump_at(surface, &species.planting, column * cells + cell % cells, row * cells + cell / cells, index)
    })
}
