//! The words of a wgpu device: WGSL, translated by naga for its driver.

use crate::adapters::OpenGpu;
use crate::digest::probes::Probe;
use anyhow::{Context, Result};
use shaders::Shader;
use shaders::layout::{FILL_WORKGROUP, PROBE_WORDS, World};
use std::sync::mpsc;
use terrain::Land;

/// Probes of one dispatch: 2 MB up, 5 MB down, and short enough for the watchdog of a slow driver.
const BATCH: usize = 1 << 18;

/// Runs `probe_heights` or its float control over all probes.
///
/// # Errors
/// The device fails.
pub fn words(gpu: &OpenGpu, shader: &Shader, land: &Land, probes: &[Probe]) -> Result<Vec<i32>> {
    use wgpu::BufferUsages as Usage;
    let OpenGpu { device, queue, .. } = gpu;
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name),
        source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(shader.name),
        layout: None,
        module: &module,
        entry_point: None,
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let buffer = |label, size: usize, usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size as u64,
            usage,
            mapped_at_creation: false,
        })
    };
    let world = buffer("world", size_of::<World>(), Usage::STORAGE | Usage::COPY_DST);
    queue.write_buffer(&world, 0, bytemuck::bytes_of(&World::from(land.parameters())));

    let mut words = Vec::with_capacity(probes.len() * PROBE_WORDS);
    for batch in probes.chunks(BATCH) {
        let bytes = 4 * PROBE_WORDS * batch.len();
        let input = buffer("probes", size_of_val(batch), Usage::STORAGE | Usage::COPY_DST);
        let output = buffer("words", bytes, Usage::STORAGE | Usage::COPY_SRC);
        let landing = buffer("words on the CPU", bytes, Usage::MAP_READ | Usage::COPY_DST);
        queue.write_buffer(&input, 0, bytemuck::cast_slice(batch));
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: world.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: input.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: output.as_entire_binding() },
            ],
        });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups((batch.len() as u32).div_ceil(FILL_WORKGROUP), 1, 1);
        }
        encoder.copy_buffer_to_buffer(&output, 0, &landing, 0, bytes as u64);
        queue.submit([encoder.finish()]);

        let (done, mapped) = mpsc::channel();
        landing.slice(..).map_async(wgpu::MapMode::Read, move |outcome| {
            // Nobody listens any more only if waiting has failed.
            let _ = done.send(outcome);
        });
        gpu.wait()?;
        mapped.recv().context("the GPU dropped the words")?.context("the words cannot be read")?;
        let view = landing.slice(..).get_mapped_range().context("the words cannot be read")?;
        words.extend_from_slice(bytemuck::cast_slice(&view));
    }
    Ok(words)
}
