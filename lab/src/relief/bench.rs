//! The shipped marches on this machine's GPU: rays in, places out.

use anyhow::{Context, Result};
use client::relief::HeightMap;
use client::render::pipeline::{compute_pipelines, storage_entry, uniform_entry};
use client::render::relief::ReliefMaps;
use client::render::{Gpu, gpu};
use shaders::SHADERS;
use shaders::layout::{Relief, ReliefFinding, ReliefProbe};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// The bench: a device and height maps on it.
pub struct ReliefBench {
    gpu: Gpu,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

impl ReliefBench {
    /// Opens the best adapter.
    ///
    /// # Errors
    /// There is none; the line says what to install.
    pub fn open() -> Result<Self> {
        let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None))?;
        let compute = wgpu::ShaderStages::COMPUTE;
        let mut entries = vec![wgpu::BindGroupLayoutEntry { visibility: compute, ..uniform_entry(0) }];
        entries.extend(ReliefMaps::layout_entries(1, compute));
        entries.extend([storage_entry(6, compute, true), storage_entry(7, compute, false)]);
        let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(SHADERS.probe_relief.name),
            entries: &entries,
        });
        let [pipeline] = compute_pipelines(&gpu.device, &SHADERS.probe_relief, &[&layout], ["probe_relief"]);
        Ok(Self { gpu, pipeline, layout })
    }

    /// Name of the adapter, for people.
    #[must_use]
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Whether the driver has no GPU.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.gpu.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Puts maps of one side on the GPU, with or without cones; the layer of a probe is the place in this list.
    #[must_use]
    pub fn upload(&self, maps: &[HeightMap], has_cones: bool) -> ReliefMaps {
        ReliefMaps::upload_with(&self.gpu.device, &self.gpu.queue, maps, has_cones)
    }

    /// Runs probes, `repeats` times for a time that outweighs what a submission costs; also how long the GPU took, upload and read-back excluded.
    ///
    /// # Errors
    /// The device fails.
    pub fn run(
        &self,
        maps: &ReliefMaps,
        relief: &Relief,
        probes: &[ReliefProbe],
        repeats: u32,
    ) -> Result<(Vec<ReliefFinding>, Duration)> {
        use wgpu::BufferUsages as Usage;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let buffer = |label, size: usize, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: size as u64,
                usage,
                mapped_at_creation: false,
            })
        };
        let how = buffer("relief", size_of::<Relief>(), Usage::UNIFORM | Usage::COPY_DST);
        queue.write_buffer(&how, 0, bytemuck::bytes_of(relief));
        let input = buffer("probes", size_of_val(probes), Usage::STORAGE | Usage::COPY_DST);
        queue.write_buffer(&input, 0, bytemuck::cast_slice(probes));
        let bytes = size_of::<ReliefFinding>() * probes.len();
        let output = buffer("findings", bytes, Usage::STORAGE | Usage::COPY_SRC);
        let landing = buffer("findings, on the CPU", bytes, Usage::MAP_READ | Usage::COPY_DST);
        let mut entries = vec![wgpu::BindGroupEntry { binding: 0, resource: how.as_entire_binding() }];
        entries.extend(maps.entries(1));
        entries.push(wgpu::BindGroupEntry { binding: 6, resource: input.as_entire_binding() });
        entries.push(wgpu::BindGroupEntry { binding: 7, resource: output.as_entire_binding() });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(SHADERS.probe_relief.name),
            layout: &self.layout,
            entries: &entries,
        });
        queue.submit([]);
        self.gpu.wait()?;
        let begun = Instant::now();
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            for _ in 0..repeats {
                pass.dispatch_workgroups((probes.len() as u32).div_ceil(64), 1, 1);
            }
        }
        queue.submit([encoder.finish()]);
        self.gpu.wait()?;
        let took = begun.elapsed();
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&output, 0, &landing, 0, bytes as u64);
        queue.submit([encoder.finish()]);
        let (done, mapped) = mpsc::channel();
        landing.slice(..).map_async(wgpu::MapMode::Read, move |outcome| {
            // Nobody listens any more only if waiting has failed.
            let _ = done.send(outcome);
        });
        self.gpu.wait()?;
        mapped.recv().context("the GPU dropped the findings")?.context("the findings cannot be read")?;
        let view = landing.slice(..).get_mapped_range().context("the findings cannot be read")?;
        let findings: &[ReliefFinding] = bytemuck::cast_slice(&view);
        Ok((findings.to_vec(), took))
    }
}
