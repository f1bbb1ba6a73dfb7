//! The passes that draw waves: frame's uniforms and the distortion map.

use crate::render::pipeline::{Depth, LightPass, uniform_entry};
use crate::render::waves::WaveMap;
use shaders::layout::WATER_VERTICES;
use shaders::{SHADERS, Shader};

/// A pass that reads the waves and needs no other data.
#[derive(Debug)]
pub struct WaterPass {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    vertices: u32,
}

impl WaterPass {
    /// The surface of the sea.
    #[must_use]
    pub fn sea(device: &wgpu::Device, frame: &wgpu::Buffer, waves: &WaveMap, samples: u32) -> Self {
        Self::new(device, frame, waves, &SHADERS.draw_water, (Depth::Transparent, WATER_VERTICES), samples)
    }

    /// The scene of the water: the whole picture.
    #[must_use]
    pub fn bay(device: &wgpu::Device, frame: &wgpu::Buffer, waves: &WaveMap, samples: u32) -> Self {
        Self::new(device, frame, waves, &SHADERS.draw_bay, (Depth::Background, 3), samples)
    }

    fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        waves: &WaveMap,
        shader: &Shader,
        (depth, vertices): (Depth, u32),
        samples: u32,
    ) -> Self {
        let [map, sampler] = WaveMap::layout_entries(1, wgpu::ShaderStages::FRAGMENT);
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(shader.name),
            entries: &[uniform_entry(0), map, sampler],
        });
        let [map, sampler] = waves.entries(1);
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                map,
                sampler,
            ],
        });
        let pipeline =
            LightPass { shader, layouts: &[&layout], buffers: &[], depth, samples }.pipeline(device);
        Self { pipeline, bindings, vertices }
    }

    /// Draws it.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.draw(0..self.vertices, 0..1);
    }
}
