//! The shipped marches on this machine's GPU: rays in, places out.

use crate::probe;
use anyhow::Result;
use client::relief::HeightMap;
use client::render::pipeline::{compute_pipelines, storage_entry, uniform_entry};
use client::render::relief::ReliefMaps;
use client::render::{Gpu, gpu, picture};
use shaders::SHADERS;
use shaders::layout::{Relief, ReliefFinding, ReliefProbe};
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

    /// Puts maps of one side on the GPU, with or without cones; the layer of a probe is the place
    /// in this list.
    #[must_use]
    pub fn upload(&self, maps: &[HeightMap], has_cones: bool) -> ReliefMaps {
        let mut uploaded = ReliefMaps::upload(&self.gpu.device, &self.gpu.queue, maps);
        if has_cones {
            self.bake_cones(&mut uploaded, maps.len());
        }
        uploaded
    }

    /// Bakes the cones of the first so many layers; how long it took.
    pub fn bake_cones(&self, maps: &mut ReliefMaps, layers: usize) -> Duration {
        let start = Instant::now();
        let layers: Vec<u32> = (0..layers as u32).collect();
        maps.bake_cones(&self.gpu.device, &self.gpu.queue, &layers);
        start.elapsed()
    }

    /// The baked cones of the first layer at a mip level, row by row.
    ///
    /// # Errors
    /// The device fails.
    pub fn cones(&self, maps: &ReliefMaps, level: u32) -> Result<Vec<f32>> {
        let bytes = picture::read_level(&self.gpu, maps.cones(), level, size_of::<f32>())?;
        Ok(bytes
            .chunks_exact(4)
            .map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]))
            .collect())
    }

    /// Runs probes, `repeats` times for a time that outweighs what a submission costs; also how
    /// long the GPU took, upload and read-back excluded.
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
        let how = probe::uniform(&self.gpu, "relief", relief);
        let input = probe::input(&self.gpu, "probes", probes);
        let output = probe::output::<ReliefFinding>(&self.gpu, "findings", probes.len());
        let mut entries = vec![wgpu::BindGroupEntry { binding: 0, resource: how.as_entire_binding() }];
        entries.extend(maps.entries(1));
        entries.push(wgpu::BindGroupEntry { binding: 6, resource: input.as_entire_binding() });
        entries.push(wgpu::BindGroupEntry { binding: 7, resource: output.as_entire_binding() });
        let bindings = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(SHADERS.probe_relief.name),
            layout: &self.layout,
            entries: &entries,
        });
        let groups = (probes.len() as u32).div_ceil(64);
        let took = probe::dispatch(&self.gpu, &self.pipeline, &bindings, groups, repeats)?;
        Ok((probe::read(&self.gpu, &output)?, took))
    }
}
