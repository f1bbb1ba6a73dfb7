//! The shipped marches on this machine's GPU: rays in, intersections out.

use crate::probe_pass::{self, Dispatch};
use anyhow::Result;
use client::features::pom::HeightMap;
use client::features::pom::maps::PomMaps;
use client::gpu::bind::{storage_entry, uniform_entry};
use client::gpu::pipeline::compute_pipelines;
use client::gpu::{Gpu, offscreen};
use shaders::SHADERS;
use shaders::layout::{PomParams, PomProbe, PomResult};
use std::time::Duration;

/// The bench: a device and height maps on it.
pub struct PomBench {
    gpu: Gpu,
    pipeline: wgpu::ComputePipeline,
}

impl PomBench {
    /// Opens the best adapter.
    ///
    /// # Errors
    /// There is none; the message says what to install.
    pub fn open() -> Result<Self> {
        let gpu = Gpu::open_blocking()?;
        let compute = wgpu::ShaderStages::COMPUTE;
        let mut entries = vec![wgpu::BindGroupLayoutEntry { visibility: compute, ..uniform_entry(0) }];
        entries.extend(PomMaps::layout_entries(1, compute));
        entries.extend([storage_entry(6, compute, true), storage_entry(7, compute, false)]);
        let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(SHADERS.probe_pom.name),
            entries: &entries,
        });
        let [pipeline] = compute_pipelines(&gpu.device, &SHADERS.probe_pom, &[&layout], ["probe_pom"]);
        Ok(Self { gpu, pipeline })
    }

    /// Name of the adapter, for people.
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Whether the driver has no GPU.
    pub fn is_software(&self) -> bool {
        self.gpu.is_software()
    }

    /// Puts maps of one side on the GPU, with or without cones; the layer of a probe is the place
    /// in this list.
    ///
    /// # Errors
    /// The GPU fails.
    pub fn upload(&self, maps: &[HeightMap], has_cones: bool) -> Result<PomMaps> {
        let mut uploaded = PomMaps::upload(&self.gpu.device, &self.gpu.queue, maps);
        if has_cones {
            let layers: Vec<u32> = (0..maps.len() as u32).collect();
            uploaded.bake_cones(&self.gpu, &layers)?;
        }
        Ok(uploaded)
    }

    /// The baked cones of the first layer at a mip level, row by row.
    pub fn cones(&self, maps: &PomMaps, level: u32) -> Result<Vec<f32>> {
        let bytes = offscreen::read_level(&self.gpu, maps.cones(), level, size_of::<f32>())?;
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }

    /// Runs probes, `repeats` times for a time that outweighs what a submission costs; also how
    /// long the GPU took, upload and read-back excluded.
    pub fn run(
        &self,
        maps: &PomMaps,
        relief: &PomParams,
        probes: &[PomProbe],
        repeats: u32,
    ) -> Result<(Vec<PomResult>, Duration)> {
        let how = probe_pass::filled(&self.gpu, bytemuck::bytes_of(relief), wgpu::BufferUsages::UNIFORM);
        let maps = maps.entries(1).into_iter().map(|entry| entry.resource);
        let resources = [how.as_entire_binding()].into_iter().chain(maps);
        let dispatch = Dispatch { repeats, ..Dispatch::once(probes.len()) };
        probe_pass::run(&self.gpu, &self.pipeline, resources, probes, dispatch)
    }
}
