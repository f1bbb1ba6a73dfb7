//! Off-screen render targets and their read-back.

use crate::gpu::device::{Gpu, GpuError};
use crate::gpu::readback::Readback;

/// Format of off-screen images. Not an sRGB format: the tonemap pass encodes.
pub const IMAGE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// A rendered image.
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// sRGB-encoded RGBA, 8 bits each, row by row from the top; alpha is 255.
    pub rgba: Vec<u8>,
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Image({} x {})", self.width, self.height)
    }
}

/// An off-screen render target.
#[derive(Debug)]
pub struct OffscreenTarget {
    texture: wgpu::Texture,
    /// The colour attachment.
    pub view: wgpu::TextureView,
}

impl OffscreenTarget {
    /// A target of at least 1 x 1 pixels.
    #[must_use]
    pub fn new(device: &wgpu::Device, width: u32, height: u32) -> Self {
        Self::with_format(device, width, height, IMAGE_FORMAT)
    }

    /// [`OffscreenTarget::new`] with another format of 8 bits a channel: that of a window.
    #[must_use]
    pub fn with_format(device: &wgpu::Device, width: u32, height: u32, format: wgpu::TextureFormat) -> Self {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("image"),
            size: wgpu::Extent3d { width: width.max(1), height: height.max(1), depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        Self { texture, view }
    }

    /// Copies the image to the CPU; blocks until it is drawn.
    ///
    /// # Errors
    /// The device failed.
    pub fn read(&self, gpu: &Gpu) -> Result<Image, GpuError> {
        let mut rgba = read_texture(gpu, &self.texture, 4)?;
        if self.texture.format() == wgpu::TextureFormat::Bgra8Unorm {
            rgba.chunks_exact_mut(4).for_each(|pixel| pixel.swap(0, 2));
        }
        Ok(Image { width: self.texture.width(), height: self.texture.height(), rgba })
    }
}

/// Copies a texture of `pixel_bytes` bytes a pixel to the CPU, row by row from the top; blocks
/// until it is drawn.
///
/// # Errors
/// The device failed.
pub fn read_texture(gpu: &Gpu, texture: &wgpu::Texture, pixel_bytes: usize) -> Result<Vec<u8>, GpuError> {
    read_level(gpu, texture, 0, pixel_bytes)
}

/// [`read_texture`] of one mip level of the first layer.
///
/// # Errors
/// The device failed.
pub fn read_level(
    gpu: &Gpu,
    texture: &wgpu::Texture,
    level: u32,
    pixel_bytes: usize,
) -> Result<Vec<u8>, GpuError> {
    let (width, height) = ((texture.width() >> level).max(1), (texture.height() >> level).max(1));
    let row = pixel_bytes * width as usize;
    let stride = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
    let bytes = (stride * height as usize) as u64;
    let readback = Readback::new(&gpu.device, "texture, read back", bytes);
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        wgpu::TexelCopyTextureInfo { mip_level: level, ..texture.as_image_copy() },
        wgpu::TexelCopyBufferInfo {
            buffer: readback.staging(),
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(stride as u32),
                rows_per_image: None,
            },
        },
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
    );
    gpu.queue.submit([encoder.finish()]);
    gpu.read(&readback, bytes, |mapped| {
        mapped.chunks_exact(stride).flat_map(|line| &line[..row]).copied().collect()
    })
}
