//! Texture arrays of parallax occlusion mapping.

/// Format of heights, cones and maximum pyramids. WebGPU does not guarantee that it can be
/// filtered.
pub(super) const UNFILTERED_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

pub(super) fn texture(
    device: &wgpu::Device,
    label: &str,
    format: wgpu::TextureFormat,
    width: u32,
    height: u32,
    layers: u32,
    levels: u32,
) -> wgpu::Texture {
    use wgpu::TextureUsages as Usage;
    let stored = if format == UNFILTERED_FORMAT { Usage::STORAGE_BINDING } else { Usage::empty() };
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: layers },
        mip_level_count: levels,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: Usage::TEXTURE_BINDING | Usage::COPY_DST | Usage::COPY_SRC | stored,
        view_formats: &[],
    })
}

/// All layers and levels.
pub(super) fn whole(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}
