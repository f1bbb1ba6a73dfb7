//! The words of a wgpu device: WGSL, translated by naga for its driver.

use crate::digest::probes::Probe;
use crate::probe_pass::{self, Dispatch};
use anyhow::Result;
use client::gpu::Gpu;
use shaders::Shader;
use shaders::layout::{FILL_WORKGROUP, PROBE_WORDS, World};
use terrain::Land;

/// Probes of one dispatch: 2 MB up, 5 MB down, and short enough for the watchdog of a slow driver.
const BATCH: usize = 1 << 18;

/// Runs `probe_heights` or its float control over all probes.
pub fn words(gpu: &Gpu, shader: &Shader, land: &Land, probes: &[Probe]) -> Result<Vec<i32>> {
    let pipeline = probe_pass::pipeline(gpu, shader, None);
    let world = World::from(land.parameters());
    let world = probe_pass::filled(gpu, bytemuck::bytes_of(&world), wgpu::BufferUsages::STORAGE);
    let mut words = Vec::with_capacity(probes.len() * PROBE_WORDS);
    for batch in probes.chunks(BATCH) {
        let dispatch = Dispatch { workgroup: FILL_WORKGROUP, ..Dispatch::once(batch.len()) };
        let (found, _): (Vec<[i32; PROBE_WORDS]>, _) =
            probe_pass::run(gpu, &pipeline, [world.as_entire_binding()], batch, dispatch)?;
        words.extend(found.into_flattened());
    }
    Ok(words)
}
