//! Target of a pass after the HDR pass: the image, or colours for a filter pass.

use crate::gpu::pipeline::screen_pipeline;
use crate::gpu::targets::HDR_FORMAT;
use shaders::Shader;

/// Output of a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The image, dithered.
    Image,
    /// Encoded colours for a pass that filters; alpha 0 marks light that is not finite.
    Graded,
}

impl Target {
    /// In the order of their numbers.
    pub const ALL: [Self; 2] = [Self::Image, Self::Graded];

    /// Entry point of the fragment shader.
    #[must_use]
    pub fn fragment(self) -> &'static str {
        match self {
            Self::Image => "fragment",
            Self::Graded => "fragment_graded",
        }
    }

    /// Format of the target, with that of the image.
    #[must_use]
    pub fn format(self, image: wgpu::TextureFormat) -> wgpu::TextureFormat {
        match self {
            Self::Image => image,
            // More bits than the image has: the dither comes after the filters.
            Self::Graded => HDR_FORMAT,
        }
    }
}

/// A target of encoded colours.
#[must_use]
pub fn graded_target(device: &wgpu::Device, (width, height): (u32, u32)) -> wgpu::TextureView {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("graded"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: HDR_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// The pipelines of a pass to each target, in the order of [`Target::ALL`].
#[must_use]
pub fn pipelines(
    device: &wgpu::Device,
    shader: &Shader,
    layout: &wgpu::BindGroupLayout,
    image: wgpu::TextureFormat,
) -> [wgpu::RenderPipeline; 2] {
    Target::ALL
        .map(|target| screen_pipeline(device, shader, layout, target.fragment(), target.format(image).into()))
}
