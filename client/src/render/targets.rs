//! The textures that a frame is gathered in: linear light and depth, both as large as the picture.

/// Linear light, more than 1 allowed.
pub const LIGHT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Reversed-Z needs floats: their fine steps near 0 are where the far land is.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Names of plants, see `shaders/wgsl/shared/name.wesl`; only checks draw them.
pub const NAME_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;

/// The targets of one picture size.
#[derive(Debug)]
pub struct Targets {
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// What the passes draw into; several samples per pixel where asked for.
    pub gathered: wgpu::TextureView,
    /// One sample per pixel, what the tone pass reads; none if `gathered` already is that.
    pub resolved: Option<wgpu::TextureView>,
    /// Depth, with as many samples as `gathered`.
    pub depth: wgpu::TextureView,
}

impl Targets {
    /// Textures for a picture of at least 1 x 1.
    #[must_use]
    pub fn new(device: &wgpu::Device, size: (u32, u32), samples: u32) -> Self {
        let size = (size.0.max(1), size.1.max(1));
        let view = |label, format, samples, usage| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size.0, height: size.1, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | usage,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        let (none, read) = (wgpu::TextureUsages::empty(), wgpu::TextureUsages::TEXTURE_BINDING);
        // Only checks copy it.
        let read_back = read | wgpu::TextureUsages::COPY_SRC;
        let resolved = (samples > 1).then(|| view("light, resolved", LIGHT_FORMAT, 1, read));
        let gathered = view("light", LIGHT_FORMAT, samples, if samples > 1 { none } else { read_back });
        Self { size, gathered, resolved, depth: view("depth", DEPTH_FORMAT, samples, none) }
    }

    /// One sample per pixel.
    #[must_use]
    pub fn light(&self) -> &wgpu::TextureView {
        self.resolved.as_ref().unwrap_or(&self.gathered)
    }
}

/// A texture of names of a size of at least 1 x 1, which can be copied.
#[must_use]
pub fn names(device: &wgpu::Device, (width, height): (u32, u32)) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("names"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: NAME_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}
