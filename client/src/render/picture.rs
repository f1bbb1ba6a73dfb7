//! Pictures off screen: a target that no window owns, and its way back to the CPU.

use crate::render::gpu::{Gpu, GpuError};
use std::sync::mpsc;

/// Format of off-screen pictures: encoded by the tone pass, so not an sRGB format.
pub const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// A finished picture.
#[derive(Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// sRGB-encoded RGBA, 8 bits each, row by row from the top; alpha is 255.
    pub rgba: Vec<u8>,
}

impl std::fmt::Debug for Picture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Picture({} x {})", self.width, self.height)
    }
}

/// An off-screen target.
#[derive(Debug)]
pub struct Canvas {
    texture: wgpu::Texture,
    /// What to draw into.
    pub view: wgpu::TextureView,
}

impl Canvas {
    /// A canvas of at least 1 x 1 pixels.
    #[must_use]
    pub fn new(device: &wgpu::Device, width: u32, height: u32) -> Self {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width: width.max(1), height: height.max(1), depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: PICTURE_FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        Self { texture, view }
    }

    /// Copies the picture to the CPU; blocks until it is drawn.
    pub fn read(&self, gpu: &Gpu) -> Result<Picture, GpuError> {
        let rgba = read_texture(gpu, &self.texture, 4)?;
        Ok(Picture { width: self.texture.width(), height: self.texture.height(), rgba })
    }
}

/// Copies a texture of `pixel_bytes` bytes a pixel to the CPU, row by row from the top; blocks
/// until it is drawn.
pub fn read_texture(gpu: &Gpu, texture: &wgpu::Texture, pixel_bytes: usize) -> Result<Vec<u8>, GpuError> {
    read_level(gpu, texture, 0, pixel_bytes)
}

/// The same of one mip level, of the first layer.
///
/// # Errors
/// The device fails.
pub fn read_level(
    gpu: &Gpu,
    texture: &wgpu::Texture,
    level: u32,
    pixel_bytes: usize,
) -> Result<Vec<u8>, GpuError> {
    let (width, height) = ((texture.width() >> level).max(1), (texture.height() >> level).max(1));
    let row = pixel_bytes * width as usize;
    let stride = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("texture, read back"),
        size: (stride * height as usize) as u64,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        wgpu::TexelCopyTextureInfo { mip_level: level, ..texture.as_image_copy() },
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(stride as u32),
                rows_per_image: None,
            },
        },
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
    );
    gpu.queue.submit([encoder.finish()]);
    let (told, tell) = mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |outcome| {
        // Nobody listens only if the wait below failed first.
        let _ = told.send(outcome);
    });
    gpu.wait()?;
    let fault = |cause: &dyn std::fmt::Display| GpuError::Fault(format!("read-back failed: {cause}"));
    tell.recv().map_err(|error| fault(&error))?.map_err(|error| fault(&error))?;
    let mapped = buffer.get_mapped_range(..).map_err(|error| fault(&error))?;
    Ok(mapped.chunks_exact(stride).flat_map(|line| &line[..row]).copied().collect())
}
