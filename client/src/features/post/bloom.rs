//! Bloom: bright light spreads over its surroundings, as in a lens (Jimenez, "Next Generation Post
//! Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014).

use crate::gpu::bind::{bind, layout, sampler_entry, texture_entry};
use crate::gpu::pipeline::screen_pipeline;
use crate::gpu::targets::HDR_FORMAT;
use shaders::SHADERS;

/// Levels at most: the widest has a 32nd of the rendered size.
const LEVELS: u32 = 5;

/// Share of the wider levels in what a level passes on. Every level but the last keeps the rest.
const WIDER: f64 = 0.6;

/// The passes of bloom.
#[derive(Debug)]
pub struct BloomPass {
    layout: wgpu::BindGroupLayout,
    first: wgpu::RenderPipeline,
    down: wgpu::RenderPipeline,
    up: wgpu::RenderPipeline,
}

/// Targets of one rendered size, with their bindings.
#[derive(Debug)]
pub struct BloomTargets {
    /// Level 0 is half the rendered size.
    views: Vec<wgpu::TextureView>,
    /// Over the HDR colour, then over every level.
    sources: Vec<wgpu::BindGroup>,
}

impl BloomPass {
    /// The passes.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        let (fragment, d2) = (wgpu::ShaderStages::FRAGMENT, wgpu::TextureViewDimension::D2);
        let shader = &SHADERS.filter_bloom;
        let layout =
            layout(device, shader.name, &[texture_entry(0, fragment, d2, true), sampler_entry(1, fragment)]);
        let mix = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::Constant,
            dst_factor: wgpu::BlendFactor::OneMinusConstant,
            operation: wgpu::BlendOperation::Add,
        };
        let mixed = wgpu::ColorTargetState {
            format: HDR_FORMAT,
            blend: Some(wgpu::BlendState { color: mix, alpha: mix }),
            write_mask: wgpu::ColorWrites::ALL,
        };
        let pipeline = |fragment, target| screen_pipeline(device, shader, &layout, fragment, target);
        Self {
            first: pipeline("fragment_first", HDR_FORMAT.into()),
            down: pipeline("fragment_down", HDR_FORMAT.into()),
            up: pipeline("fragment_up", mixed),
            layout,
        }
    }

    /// Targets for an HDR colour of `size` pixels.
    #[must_use]
    pub fn targets(
        &self,
        device: &wgpu::Device,
        size: (u32, u32),
        hdr: &wgpu::TextureView,
        sampler: &wgpu::Sampler,
    ) -> BloomTargets {
        let (width, height) = ((size.0 / 2).max(1), (size.1 / 2).max(1));
        let levels = LEVELS.min(width.max(height).ilog2() + 1);
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("bloom"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: levels,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: HDR_FORMAT,
            // Only checks copy it.
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = |level| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                base_mip_level: level,
                mip_level_count: Some(1),
                ..Default::default()
            })
        };
        let views: Vec<_> = (0..levels).map(view).collect();
        let source = |view| {
            let resources =
                [wgpu::BindingResource::TextureView(view), wgpu::BindingResource::Sampler(sampler)];
            bind(device, SHADERS.filter_bloom.name, &self.layout, &resources)
        };
        let sources = std::iter::once(hdr).chain(&views).map(source).collect();
        BloomTargets { views, sources }
    }

    /// Records all steps; the result is [`BloomTargets::result`].
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, targets: &BloomTargets) {
        let mut step = |pipeline, source: &wgpu::BindGroup, target, load| {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("bloom"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                })],
                ..Default::default()
            });
            pass.set_pipeline(pipeline);
            pass.set_blend_constant(wgpu::Color { r: WIDER, g: WIDER, b: WIDER, a: WIDER });
            pass.set_bind_group(0, source, &[]);
            pass.draw(0..3, 0..1);
        };
        let clear = wgpu::LoadOp::Clear(wgpu::Color::BLACK);
        for (level, (source, target)) in targets.sources.iter().zip(&targets.views).enumerate() {
            step(if level == 0 { &self.first } else { &self.down }, source, target, clear);
        }
        for level in (1..targets.views.len()).rev() {
            step(&self.up, &targets.sources[level + 1], &targets.views[level - 1], wgpu::LoadOp::Load);
        }
    }
}

impl BloomTargets {
    /// The spread light, half the rendered size.
    #[must_use]
    pub fn result(&self) -> &wgpu::TextureView {
        &self.views[0]
    }
}
