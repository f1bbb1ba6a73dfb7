//! Equality of the visible clumps of GPU and CPU twin, word by word and in order.

use crate::culling::cases::Case;
use crate::culling::scene::Scene;
use crate::gpu_probes::cpu_cull::{VisibleClump, cull_on_cpu};
use anyhow::{Context, Result};
use client::features::terrain::pool::ChunkPool;
use client::features::vegetation::gpu_cull::{CullBuffers, CullPasses};
use client::features::vegetation::{SpeciesParams, VegetationFrame};
use client::gpu::Gpu;
use serde::Serialize;
use shaders::layout::{CULL_FRUSTUM, Culling, GRASS_VERTICES, TREE_VERTICES};
use terrain::Land;

#[derive(Clone, Debug, Default, Serialize)]
pub struct GpuCpuEquality {
    pub adapter: String,
    pub poses: u64,
    /// Of these on stretched land, and 10^6 m from the origin.
    pub stretched: u64,
    /// See `stretched`.
    pub far: u64,
    /// Clumps that the twin keeps.
    pub clumps: u64,
    /// Positions in the list at which the two differ, or one has no clump.
    pub differing: u64,
    /// Control, must differ: the same against a twin without occlusion tests.
    pub differing_control: u64,
}

/// Slots of the pool; a case with more drawn chunks is cut to it, on both sides.
const SLOTS: u32 = 1500;

/// Capacity of each level of detail, clumps.
const ROOM: [u32; 3] = [60_000, 120_000, 240_000];

pub fn compare(land: &Land, cases: &[Case]) -> Result<GpuCpuEquality> {
    let gpu = Gpu::open_blocking().context("culling needs a GPU")?;
    let pool = ChunkPool::new(&gpu.device, SLOTS);
    let mut passes = CullPasses::new(&gpu.device);
    let [near, middle, far] = GRASS_VERTICES;
    let grass = passes.create_buffers(&gpu.device, &pool, (32_768, ROOM), [near, middle, far]);
    let trees = passes.create_buffers(&gpu.device, &pool, (32_768, ROOM), TREE_VERTICES);
    let mut equality = GpuCpuEquality { adapter: gpu.name(), ..GpuCpuEquality::default() };
    for case in cases {
        let Some(scene) = Scene::of(land, case, SLOTS) else { continue };
        equality.poses += 1;
        equality.stretched += u64::from(case.stretch != client::cache::vertical_scale::ONE);
        equality.far += u64::from(case.shot.pose.position_m.x > 5e5);
        scene.world.residents().for_each(|chunk| pool.upload(&gpu.queue, chunk));
        passes.prepare(&gpu.queue, &scene.plants.grid);
        for (index, species) in scene.plants.species.iter().enumerate() {
            let chosen = if index == 0 { &grass } else { &trees };
            let found = choose(&gpu, &mut passes, &scene.plants, index, chosen)
                .with_context(|| format!("choosing plants failed at pose {}", case.name))?;
            let expected = words_of(&scene, species);
            equality.clumps += expected.len() as u64;
            equality.differing += differing(&found, &expected);
            let frustum = SpeciesParams {
                culling: Culling { path: CULL_FRUSTUM, ..species.culling },
                ..species.clone()
            };
            equality.differing_control += differing(&found, &words_of(&scene, &frustum));
        }
    }
    Ok(equality)
}

fn choose(
    gpu: &Gpu,
    passes: &mut CullPasses,
    plants: &VegetationFrame,
    index: usize,
    chosen: &CullBuffers,
) -> Result<Vec<[u32; 4]>> {
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    passes.record(gpu, plants, index, 1, chosen, &mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let stats = chosen.read_stats(gpu)?;
    anyhow::ensure!(stats.blocks_lost + stats.clumps_lost == 0, "no room for all visible clumps: {stats:?}");
    // The highest bytes hold the normal, a float result.
    let bare = |clump: &[u32; 4]| [clump[0] & 0xff_ffff, clump[1] & 0xff_ffff, clump[2], clump[3]];
    Ok(chosen.read(gpu)?.concat().iter().map(bare).collect())
}

/// Clumps that the twin keeps, in the order of the GPU: level of detail by level of detail.
fn words_of(scene: &Scene, species: &SpeciesParams) -> Vec<[u32; 4]> {
    let mut kept: Vec<VisibleClump> = cull_on_cpu(&scene.world, &scene.plants, species);
    kept.sort_by_key(|kept| kept.detail);
    kept.iter()
        .map(|VisibleClump { clump, .. }| [clump.x as u32, clump.z as u32, clump.y as u32, clump.attributes])
        .collect()
}

fn differing(found: &[[u32; 4]], expected: &[[u32; 4]]) -> u64 {
    let others = found.iter().zip(expected).filter(|(found, expected)| found != expected).count();
    (others + found.len().abs_diff(expected.len())) as u64
}
