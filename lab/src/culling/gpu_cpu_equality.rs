//! Whether the GPU keeps the clumps that the twin keeps, word for word and in the same order.

use crate::culling::poses::Trial;
use crate::culling::scene::Scene;
use anyhow::{Context, Result};
use client::plants::kept::{Kept, kept_of};
use client::plants::{PlantFrame, Stand};
use client::render::cull::{Chosen, CullPasses};
use client::render::pool::ChunkPool;
use client::render::{Gpu, gpu};
use serde::Serialize;
use shaders::layout::{CULL_FRUSTUM, Culling, GRASS_VERTICES, TREE_VERTICES};
use terrain::Land;

/// What the comparison came to.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Same {
    /// Who chose.
    pub adapter: String,
    /// Poses compared.
    pub poses: u64,
    /// Of these on stretched land, and 10^6 m from the origin.
    pub stretched: u64,
    /// See `stretched`.
    pub far: u64,
    /// Clumps that the twin keeps.
    pub clumps: u64,
    /// Places in the order at which the two have other clumps, or one has none.
    pub differing: u64,
    /// The same against a twin that does not ask the land: a control that must differ.
    pub differing_control: u64,
}

/// Slots of the pool; trials with more drawn chunks are cut to it, in both.
const SLOTS: u32 = 1500;

/// Clumps that there is room for in each level of detail.
const ROOM: [u32; 3] = [60_000, 120_000, 240_000];

/// Compares all trials.
///
/// # Errors
/// There is no GPU, it failed, or it had not enough room.
pub fn compare(land: &Land, trials: &[Trial]) -> Result<Same> {
    let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None)).context("culling needs a GPU")?;
    let pool = ChunkPool::new(&gpu.device, SLOTS);
    let passes = CullPasses::new(&gpu.device);
    let [near, middle, far] = GRASS_VERTICES;
    let grass = passes.room_for(&gpu.device, &pool, ROOM, [near, middle, far]);
    let trees = passes.room_for(&gpu.device, &pool, ROOM, [TREE_VERTICES[0], TREE_VERTICES[1], 0]);
    let mut same = Same { adapter: gpu.name(), ..Same::default() };
    for trial in trials {
        let Some(scene) = Scene::of(land, trial, SLOTS) else { continue };
        same.poses += 1;
        same.stretched += u64::from(trial.stretch != client::world::stretch::ONE);
        same.far += u64::from(trial.shot.pose.position_m.x > 5e5);
        scene.world.residents().for_each(|chunk| pool.upload(&gpu.queue, chunk));
        passes.prepare(&gpu.queue, &scene.plants.square);
        for (index, stand) in scene.plants.stands.iter().enumerate() {
            let chosen = if index == 0 { &grass } else { &trees };
            let found = choose(&gpu, &passes, &scene.plants, index, chosen)
                .with_context(|| format!("choosing plants failed at pose {}", trial.name))?;
            let expected = words_of(&scene, stand);
            same.clumps += expected.len() as u64;
            same.differing += differing(&found, &expected);
            let blind = Stand { culling: Culling { path: CULL_FRUSTUM, ..stand.culling }, ..stand.clone() };
            same.differing_control += differing(&found, &words_of(&scene, &blind));
        }
    }
    Ok(same)
}

fn choose(
    gpu: &Gpu,
    passes: &CullPasses,
    plants: &PlantFrame,
    index: usize,
    chosen: &Chosen,
) -> Result<Vec<[u32; 4]>> {
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    passes.record(&gpu.queue, plants, index, 1, chosen, &mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let told = chosen.told(gpu)?;
    anyhow::ensure!(told.blocks_lost + told.clumps_lost == 0, "no room for all that is kept: {told:?}");
    // The normal in the highest bytes is a float's business.
    let bare = |clump: &[u32; 4]| [clump[0] & 0xff_ffff, clump[1] & 0xff_ffff, clump[2], clump[3]];
    Ok(chosen.read(gpu)?.concat().iter().map(bare).collect())
}

/// What the twin keeps, in the order of the GPU: each level of detail by itself.
fn words_of(scene: &Scene, stand: &Stand) -> Vec<[u32; 4]> {
    let mut kept: Vec<Kept> = kept_of(&scene.world, &scene.plants, stand);
    kept.sort_by_key(|kept| kept.detail);
    kept.iter()
        .map(|Kept { clump, .. }| [clump.x as u32, clump.z as u32, clump.y as u32, clump.looks])
        .collect()
}

fn differing(found: &[[u32; 4]], expected: &[[u32; 4]]) -> u64 {
    let others = found.iter().zip(expected).filter(|(found, expected)| found != expected).count();
    (others + found.len().abs_diff(expected.len())) as u64
}
