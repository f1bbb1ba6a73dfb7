//! The shipped parallax of waves on this machine's GPU: rays in, intersections out.

use crate::probe_pass::{self, Dispatch};
use anyhow::Result;
use bytemuck::Zeroable as _;
use client::features::water::WaveSettings;
use client::features::water::waves::WaveMap;
use client::gpu::Gpu;
use shaders::SHADERS;
use shaders::layout::{Frame, WaveProbe};
use std::time::Duration;

/// Intersection of a ray.
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
        let gpu = Gpu::open_blocking()?;
        let waves = WaveMap::bake(&gpu.device, &gpu.queue);
        let pipeline = probe_pass::pipeline(&gpu, &SHADERS.probe_waves, None);
        Ok(Self { gpu, waves, pipeline })
    }

    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Runs probes under some knobs at a moment, `repeats` times for a time that outweighs what a
    /// submission costs; also how long the GPU took, upload and read-back excluded.
    pub fn run(
        &self,
        knobs: WaveSettings,
        time_s: f32,
        probes: &[WaveProbe],
        repeats: u32,
    ) -> Result<(Vec<FoundWave>, Duration)> {
        let knobs = knobs.sanitized();
        let uniforms = Frame {
            time_s,
            // Fine enough that no wave is faded for being small on screen.
            pixels_per_radian: 1e4,
            parallax_factor: knobs.parallax_factor,
            parallax_bias_m: knobs.parallax_bias_m,
            wave_steepness: knobs.steepness,
            ..Frame::zeroed()
        };
        let frame = probe_pass::filled(&self.gpu, bytemuck::bytes_of(&uniforms), wgpu::BufferUsages::UNIFORM);
        let [map, sampler] = self.waves.entries(1).map(|entry| entry.resource);
        let dispatch = Dispatch { repeats, ..Dispatch::once(probes.len()) };
        let resources = [frame.as_entire_binding(), map, sampler];
        let (words, took): (Vec<[f32; 4]>, _) =
            probe_pass::run(&self.gpu, &self.pipeline, resources, probes, dispatch)?;
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
