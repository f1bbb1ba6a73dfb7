//! The tone pass: gathered light to encoded screen colours.

use crate::render::pipeline::{flat_pipeline, uniform_entry};
use crate::render::targets::Targets;
use shaders::SHADERS;

/// The pass.
#[derive(Debug)]
pub struct TonePass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
}

impl TonePass {
    /// The pass from `targets` to pictures of `format`, which must not encode sRGB by itself: the
    /// shader does.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        targets: &Targets,
        format: wgpu::TextureFormat,
    ) -> Self {
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("tone_picture"),
            entries: &[
                uniform_entry(0),
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: false },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                },
            ],
        });
        let pipeline = flat_pipeline(device, &SHADERS.tone_picture, &layout, format);
        let bindings = bind(device, &layout, frame, targets);
        Self { layout, pipeline, bindings }
    }

    /// Reads from new targets from now on.
    pub fn retarget(&mut self, device: &wgpu::Device, frame: &wgpu::Buffer, targets: &Targets) {
        self.bindings = bind(device, &self.layout, frame, targets);
    }

    /// Draws the picture.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn bind(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    frame: &wgpu::Buffer,
    targets: &Targets,
) -> wgpu::BindGroup {
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("tone_picture"),
        layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
            wgpu::BindGroupEntry {
                binding: 1,
                resource: wgpu::BindingResource::TextureView(targets.light()),
            },
        ],
    })
}
