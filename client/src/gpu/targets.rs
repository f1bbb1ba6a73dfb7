//! Render targets of a frame: linear HDR color and depth.

/// Linear color; values above 1 are allowed.
pub const HDR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Reversed-Z needs floats: their small steps near 0 resolve the far land.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Ids of plants; only checks draw them.
pub const ID_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;

/// The targets of one image size.
#[derive(Debug)]
pub struct Targets {
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Color attachment of the HDR pass, with one or several samples per pixel.
    pub hdr_target: wgpu::TextureView,
    /// Resolve target with one sample per pixel; none if `hdr_target` already has one.
    pub resolved: Option<wgpu::TextureView>,
    /// Depth, with as many samples as `hdr_target`.
    pub depth: wgpu::TextureView,
}

impl Targets {
    /// Targets of at least 1 x 1 pixels.
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
        let resolved = (samples > 1).then(|| view("hdr, resolved", HDR_FORMAT, 1, read));
        let hdr_target = view("hdr", HDR_FORMAT, samples, if samples > 1 { none } else { read_back });
        Self { size, hdr_target, resolved, depth: view("depth", DEPTH_FORMAT, samples, none) }
    }

    /// The HDR color with one sample per pixel.
    #[must_use]
    pub fn hdr(&self) -> &wgpu::TextureView {
        self.resolved.as_ref().unwrap_or(&self.hdr_target)
    }

    /// Begins the HDR pass with a cleared color and the farthest depth. Of several samples a pixel
    /// the resolved color is kept, of one that one.
    pub fn begin_hdr<'a>(
        &self,
        encoder: &'a mut wgpu::CommandEncoder,
        clear: wgpu::Color,
        timestamp_writes: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) -> wgpu::RenderPass<'a> {
        let store = if self.resolved.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("hdr"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.hdr_target,
                depth_slice: None,
                resolve_target: self.resolved.as_ref(),
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(clear), store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes,
            ..Default::default()
        })
    }
}

/// An id buffer of at least 1 x 1 pixels.
#[must_use]
pub fn id_buffer(device: &wgpu::Device, (width, height): (u32, u32)) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("ids"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: ID_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}
