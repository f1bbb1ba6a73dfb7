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
pub fn level_of(stand: &SpeciesParams, clump: &Clump) -> u32 {
    let far = distance_squared(&stand.culling, clump.x, clump.y, clump.z);
    u32::from(far > stand.planting.detail[0]) + u32::from(far > stand.planting.detail[1])
}

/// Result of T3 for a clump.
#[derive(Clone, Copy, Debug)]
pub struct Judged {
    /// Bound of the clump.
    pub extent: Extent,
    /// Whether all of it is occluded.
    pub is_occluded: bool,
}

/// Applies T3 to a clump.
pub fn judged<S: Slots>(surface: &Surface<'_, S>, stand: &SpeciesParams, clump: &Clump) -> Judged {
    let culling = &stand.culling;
    let extent = extent_of(culling, &stand.planting, clump, slope_at(surface, clump.x, clump.z));
    let is_occluded =
        culling.occlusion_enabled != 0 && is_occluded(surface, culling.eye, &extent.occludee, culling.start);
    Judged { extent, is_occluded }
}

/// Clumps of a species inside the view, evenly from all of its blocks; at most [`SAMPLE`].
pub fn sample<S: Slots>(surface: &Surface<'_, S>, stand: &SpeciesParams) -> Vec<Clump> {
    let blocks: Vec<[i32; 2]> = stand.patches.iter().copied().flat_map(blocks_of_patch).collect();
    let mut found = Vec::new();
    // A stride that shares no factor with the blocks of a patch or with the cells of a block.
    let stride = (blocks.len() / (30 * SAMPLE)).max(1) | 1;
    for (n, block) in blocks.iter().step_by(stride).enumerate() {
        let lane = (n * 7) as u32 % (16 * stand.planting.per_cell);
        let (cell, index) = ((lane % 16) as i32, lane / 16);
        let (column, row) = (block[0] * 4 + cell % 4, block[1] * 4 + cell / 4);
        let clump = clump_at(surface, &stand.planting, column, row, index);
        let Some(clump) = clump.filter(|clump| is_judged(stand, clump)) else { continue };
        let extent = extent_of(&stand.culling, &stand.planting, &clump, slope_at(surface, clump.x, clump.z));
        if may_be_in_view(&stand.culling, &extent) {
            found.push(clump);
        }
    }
    let every = (found.len() / SAMPLE).max(1);
    let mut found: Vec<Clump> = found.into_iter().step_by(every).collect();
    found.truncate(SAMPLE);
    found
}

/// Whether thinning keeps a clump.
pub fn is_judged(stand: &SpeciesParams, clump: &Clump) -> bool {
    let far = distance_squared(&stand.culling, clump.x, clump.y, clump.z);
    is_within_draw_distance(&stand.planting, clump, far)
}
