//! Passes that draw water: the sea and the bay scene.

use crate::features::water::waves::WaveMap;
use crate::gpu::bind::{self, uniform_entry};
use crate::gpu::pipeline::{Depth, HdrPass};
use shaders::layout::WATER_VERTICES;
use shaders::{SHADERS, Shader};

/// A pass over the frame's uniforms and the wave map.
#[derive(Debug)]
pub struct WaterPass {
    pipeline: wgpu::RenderPipeline,
    /// For an eye under water, if that is another one.
    below: Option<wgpu::RenderPipeline>,
    bindings: wgpu::BindGroup,
    vertices: u32,
}

impl WaterPass {
    /// The surface of the sea.
    #[must_use]
    pub fn sea(device: &wgpu::Device, frame: &wgpu::Buffer, waves: &WaveMap, samples: u32) -> Self {
        Self::new(
            device,
            frame,
            waves,
            &SHADERS.draw_water,
            (Depth::Transparent, WATER_VERTICES),
            samples,
            true,
        )
    }

    /// The bay scene: the whole image.
    #[must_use]
    pub fn bay(device: &wgpu::Device, frame: &wgpu::Buffer, waves: &WaveMap, samples: u32) -> Self {
        Self::new(device, frame, waves, &SHADERS.draw_bay, (Depth::Background, 3), samples, false)
    }

    fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        waves: &WaveMap,
        shader: &Shader,
        (depth, vertices): (Depth, u32),
        samples: u32,
        has_below: bool,
    ) -> Self {
        let [map, sampler] = WaveMap::layout_entries(1, wgpu::ShaderStages::FRAGMENT);
        let layout = bind::layout(device, shader.name, &[uniform_entry(0), map, sampler]);
        let [map, sampler] = waves.resources();
        let resources = [frame.as_entire_binding(), map, sampler];
        let bindings = bind::bind(device, shader.name, &layout, &resources);
        let pass = HdrPass { shader, layouts: &[&layout], buffers: &[], depth, samples };
        let below = has_below.then(|| pass.pipeline_with_fragment(device, "fragment_below"));
        Self { pipeline: pass.pipeline(device), below, bindings, vertices }
    }

    /// Records the draw, for an eye above or under water.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, is_under_water: bool) {
        let below = self.below.as_ref().filter(|_| is_under_water);
        pass.set_pipeline(below.unwrap_or(&self.pipeline));
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.draw(0..self.vertices, 0..1);
    }
}
