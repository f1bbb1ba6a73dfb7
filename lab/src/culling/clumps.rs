//! Samples of clumps, and T3 applied to a clump.

use crate::gpu_probes::cpu_cull::blocks_of_patch;
use client::features::vegetation::SpeciesParams;
use shaders::twin::placement::{Clump, clump_at, distance_squared, is_within_draw_distance};
use shaders::twin::surface::{Slots, Surface};
use shaders::twin::terrain_occlusion::is_occluded;
use shaders::twin::visibility::{Extent, extent_of, may_be_in_view, slope_at};

/// Clumps sampled of each kind in a scene.
pub const SAMPLE: usize = 500;

/// Plants lower than this are left out, metres: at the end of their range they have sunk into the
/// ground.
pub const LEAST_M: f64 = 0.1;

/// The level of detail in which a clump is drawn.
pub fn level_of(species: &SpeciesParams, clump: &Clump) -> u32 {
    let far = distance_squared(&species.culling, clump.x, clump.y, clump.z);
    u32::from(far > species.planting.detail[0]) + u32::from(far > species.planting.detail[1])
}

/// Result of T3 for a clump.
#[derive(Clone, Copy, Debug)]
pub struct ExactTest {
    /// Bound of the clump.
    pub extent: Extent,
    /// Whether all of it is occluded.
    pub is_occluded: bool,
}

/// Applies T3 to a clump.
pub fn exact_test<S: Slots>(surface: &Surface<'_, S>, species: &SpeciesParams, clump: &Clump) -> ExactTest {
    let culling = &species.culling;
    let extent = extent_of(culling, &species.planting, clump, slope_at(surface, clump.x, clump.z));
    let is_occluded =
        culling.occlusion_enabled != 0 && is_occluded(surface, culling.eye, &extent.occludee, culling.start);
    ExactTest { extent, is_occluded }
}

/// Clumps of a species inside the view, evenly from all of its blocks; at most [`SAMPLE`].
pub fn sample<S: Slots>(surface: &Surface<'_, S>, species: &SpeciesParams) -> Vec<Clump> {
    let blocks: Vec<[i32; 2]> = species.patches.iter().copied().flat_map(blocks_of_patch).collect();
    let mut found = Vec::new();
    // A stride that shares no factor with the blocks of a patch or with the cells of a block.
    let stride = (blocks.len() / (30 * SAMPLE)).max(1) | 1;
    for (n, block) in blocks.iter().step_by(stride).enumerate() {
        let lane = (n * 7) as u32 % (16 * species.planting.per_cell);
        let (cell, index) = ((lane % 16) as i32, lane / 16);
        let (column, row) = (block[0] * 4 + cell % 4, block[1] * 4 + cell / 4);
        let clump = clump_at(surface, &species.planting, column, row, index);
        let Some(clump) = clump.filter(|clump| is_tested(species, clump)) else { continue };
        let extent =
            extent_of(&species.culling, &species.planting, &clump, slope_at(surface, clump.x, clump.z));
        if may_be_in_view(&species.culling, &extent) {
            found.push(clump);
        }
    }
    let every = (found.len() / SAMPLE).max(1);
    let mut found: Vec<Clump> = found.into_iter().step_by(every).collect();
    found.truncate(SAMPLE);
    found
}

/// Whether thinning keeps a clump.
pub fn is_tested(species: &SpeciesParams, clump: &Clump) -> bool {
    let far = distance_squared(&species.culling, clump.x, clump.y, clump.z);
    is_within_draw_distance(&species.planting, clump, far)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::culling::cases;
    use crate::culling::clump_vertices::clump_vertices;
    use crate::culling::scene::Scene;
    use client::features::vegetation::VegetationSettings;
    use client::features::vegetation::by_slot::BySlot;
    use shaders::layout::KIND_GRASS;
    use shaders::twin::placement::BLOCK_CELL_BITS;
    use shaders::twin::visibility::{block_extent, sloped_occludee};
    use terrain::Land;

    /// The bounds of quarters of blocks are derived from the vertices of the ground and the largest
    /// plants; this looks at the plants that stand there.
    #[test]
    fn every_drawn_vertex_of_grass_is_below_the_plane_of_its_quarter() {
        let land = Land::new(1);
        let (mut tested, mut sloped, mut closest_m) = (0, 0, f64::MIN);
        for case in cases::seeded(&land, 12, VegetationSettings::STANDARD) {
            let Some(scene) = Scene::of(&land, &case, 4000) else { continue };
            let slots = BySlot::new(&scene.world);
            let square = &scene.plants.grid;
            let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
            let corner = square.corner.map(|units| f64::from(units) / 256.0);
            let metres = |fine: i32| f64::from(fine) / 4096.0;
            let rise = |share: i32| f64::from(share) / 16_384.0;
            for species in scene.plants.species.iter().filter(|species| species.planting.kind == KIND_GRASS) {
                let (culling, planting) = (&species.culling, &species.planting);
                let bits = planting.cell_bits + BLOCK_CELL_BITS - 1;
                for clump in sample(&surface, species) {
                    let (column, row) = (clump.x >> bits, clump.z >> bits);
                    let part = block_extent(&surface, culling, planting, bits, column, row).unwrap();
                    let bound = sloped_occludee(&surface, planting, bits, column, row, &part);
                    sloped += u32::from(bound != part.extent.occludee);
                    let vertices =
                        clump_vertices(&scene, &surface, species, &clump, level_of(species, &clump));
                    for [x, y, z] in vertices.points {
                        let east = x - corner[0] - metres(bound.x);
                        let south = z - corner[1] - metres(bound.z);
                        let plane = east * rise(bound.slope_east) + south * rise(bound.slope_south);
                        let above_m = y - metres(bound.top) - plane;
                        let beside_m = east.hypot(south) - metres(bound.radius);
                        assert!(above_m.max(beside_m) < 1e-3, "{}: {clump:?} {bound:?}", case.name);
                        closest_m = closest_m.max(above_m);
                        tested += 1;
                    }
                }
            }
        }
        assert!(tested > 10_000 && sloped > 500, "{tested} {sloped}");
        // A bound a little lower, the control, would leave something out.
        assert!(closest_m > -0.1, "{closest_m}");
    }
}
