//! The shipped parallax of waves on this machine's GPU: rays in, places out.

use crate::probe;
use anyhow::Result;
use bytemuck::Zeroable as _;
use client::looks::WaveKnobs;
use client::render::waves::WaveMap;
use client::render::{Gpu, gpu};
use shaders::SHADERS;
use shaders::layout::{Frame, WaveProbe};
use std::time::Duration;

/// What a method found of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundWave {
    /// Place of the surface, pattern metres.
    pub place_m: [f32; 2],
    /// Height on the ray above the mean plane, metres.
    pub at_m: f32,
    /// How far the waves at that place are above that height, metres: 0 where the ray truly meets
    /// them.
    pub residual_m: f32,
}

/// The bench.
pub struct WaveBench {
    gpu: Gpu,
    waves: WaveMap,
    pipeline: wgpu::ComputePipeline,
}

impl WaveBench {
    /// Bakes the map on the best adapter.
    ///
    /// # Errors
    /// There is none; the line says what to install.
    pub fn open() -> Result<Self> {
        let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None))?;
        let waves = WaveMap::bake(&gpu.device, &gpu.queue);
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(SHADERS.probe_waves.name),
            source: wgpu::ShaderSource::Wgsl(SHADERS.probe_waves.wgsl.into()),
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(SHADERS.probe_waves.name),
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        Ok(Self { gpu, waves, pipeline })
    }

    /// Name of the adapter, for people.
    #[must_use]
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Runs probes under some knobs at a moment, `repeats` times for a time that outweighs what a
    /// submission costs; also how long the GPU took, upload and read-back excluded.
    ///
    /// # Errors
    /// The device fails.
    pub fn run(
        &self,
        knobs: WaveKnobs,
        time_s: f32,
        probes: &[WaveProbe],
        repeats: u32,
    ) -> Result<(Vec<FoundWave>, Duration)> {
        let knobs = knobs.sane();
        let uniforms = Frame {
            time_s,
            // Fine enough that no wave is faded for being small on screen.
            pixels_per_radian: 1e4,
            parallax_factor: knobs.parallax_factor,
            parallax_bias_m: knobs.parallax_bias_m,
            wave_steepness: knobs.steepness,
            ..Frame::zeroed()
        };
        let frame = probe::uniform(&self.gpu, "frame", &uniforms);
        let input = probe::input(&self.gpu, "probes", probes);
        let output = probe::output::<[f32; 4]>(&self.gpu, "found", probes.len());
        let [map, sampler] = self.waves.entries(1);
        let bindings = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(SHADERS.probe_waves.name),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                map,
                sampler,
                wgpu::BindGroupEntry { binding: 3, resource: input.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 4, resource: output.as_entire_binding() },
            ],
        });
        let groups = (probes.len() as u32).div_ceil(64);
        let took = probe::dispatch(&self.gpu, &self.pipeline, &bindings, groups, repeats)?;
        let words: Vec<[f32; 4]> = probe::read(&self.gpu, &output)?;
        let found = words
            .iter()
            .map(|[x, z, at_m, residual_m]| FoundWave {
                place_m: [*x, *z],
                at_m: *at_m,
                residual_m: *residual_m,
            })
            .collect();
        Ok((found, took))
    }
}
