//! Window surface with a non-sRGB format, and handling of every surface-texture error.

use crate::gpu::device::ADAPTER_NAME;
use crate::gpu::{Gpu, GpuError};

/// A window's surface.
#[derive(Debug)]
pub struct WindowSurface {
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    /// Format of the views; never sRGB.
    pub format: wgpu::TextureFormat,
    configured: bool,
}

/// Result of [`WindowSurface::next`].
#[derive(Debug)]
pub enum NextTexture {
    /// Draw into the view, then present.
    Ready(wgpu::SurfaceTexture, wgpu::TextureView),
    /// No texture now: the window is hidden, empty, or was reconfigured. Retry with the next
    /// redraw.
    Skip,
    /// The surface is lost: create a new one from the window.
    Lost,
}

impl WindowSurface {
    /// A surface for a window of `size` pixels; a size of zero waits for the first resize.
    pub fn new(gpu: &Gpu, surface: wgpu::Surface<'static>, size: (u32, u32)) -> Result<Self, GpuError> {
        let mut config =
            surface.get_default_config(&gpu.adapter, size.0.max(1), size.1.max(1)).ok_or_else(|| {
                GpuError::Fault(format!(
                    "the GPU cannot present to this window: choose another with {ADAPTER_NAME}"
                ))
            })?;
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        let unorm_format = formats.iter().copied().find(|format| {
            matches!(format, wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Rgba8Unorm)
        });
        if let Some(unorm_format) = unorm_format {
            config.format = unorm_format;
        }
        let format = config.format.remove_srgb_suffix();
        if format != config.format {
            config.view_formats.push(format);
        }
        config.present_mode = wgpu::PresentMode::AutoVsync;
        let mut window = Self { surface, config, format, configured: false };
        window.resize(gpu, size);
        Ok(window)
    }

    /// Replaces the surface. The old one is dropped before the new one is configured: a window has
    /// at most one swapchain.
    ///
    /// # Errors
    /// The GPU cannot present to the new one.
    pub fn replace(
        &mut self,
        gpu: &Gpu,
        surface: wgpu::Surface<'static>,
        size: (u32, u32),
    ) -> Result<(), GpuError> {
        *self = Self::new(gpu, surface, (0, 0))?;
        self.resize(gpu, size);
        Ok(())
    }

    /// Resizes the surface; ignored at size 0 (minimised).
    pub fn resize(&mut self, gpu: &Gpu, size: (u32, u32)) {
        if size.0 == 0 || size.1 == 0 {
            self.configured = false;
            return;
        }
        let limit = gpu.device.limits().max_texture_dimension_2d;
        (self.config.width, self.config.height) = (size.0.min(limit), size.1.min(limit));
        self.surface.configure(&gpu.device, &self.config);
        self.configured = true;
    }

    /// Image size, pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        (self.config.width, self.config.height)
    }

    /// The texture of the next frame.
    pub fn next(&mut self, gpu: &Gpu) -> NextTexture {
        use wgpu::CurrentSurfaceTexture as Current;
        if !self.configured {
            return NextTexture::Skip;
        }
        match self.surface.get_current_texture() {
            Current::Success(texture) | Current::Suboptimal(texture) => {
                // Suboptimal is drawn: the resize that causes it has its own event.
                let view = texture.texture.create_view(&wgpu::TextureViewDescriptor {
                    format: Some(self.format),
                    ..Default::default()
                });
                NextTexture::Ready(texture, view)
            }
            Current::Outdated => {
                self.surface.configure(&gpu.device, &self.config);
                NextTexture::Skip
            }
            Current::Lost => NextTexture::Lost,
            // A validation error is recorded by the device and found by the frame loop.
            Current::Timeout | Current::Occluded | Current::Validation => NextTexture::Skip,
        }
    }
}
