//! The words of a wgpu device: WGSL, translated by naga for its driver.

use crate::adapters::OpenGpu;
use crate::digest::probes::Probe;
use crate::probe;
use anyhow::Result;
use shaders::Shader;
use shaders::layout::{FILL_WORKGROUP, PROBE_WORDS, World};
use terrain::Land;

/// Probes of one dispatch: 2 MB up, 5 MB down, and short enough for the watchdog of a slow driver.
const BATCH: usize = 1 << 18;

/// Runs `probe_heights` or its float control over all probes.
pub fn words(gpu: &OpenGpu, shader: &Shader, land: &Land, probes: &[Probe]) -> Result<Vec<i32>> {
    let pipeline = probe::pipeline(gpu, shader, None);
    let world = probe::input(gpu, "world", &[World::from(land.parameters())]);

    let mut words = Vec::with_capacity(probes.len() * PROBE_WORDS);
    for batch in probes.chunks(BATCH) {
        let input = probe::input(gpu, "probes", batch);
        let output = probe::output::<i32>(gpu, "words", PROBE_WORDS * batch.len());
        let bindings =
            probe::bind(gpu, &pipeline, [&world, &input, &output].map(wgpu::Buffer::as_entire_binding));
        probe::dispatch(gpu, &pipeline, &bindings, (batch.len() as u32).div_ceil(FILL_WORKGROUP), 1)?;
        words.extend(probe::read::<i32>(gpu, &output)?);
    }
    Ok(words)
}
