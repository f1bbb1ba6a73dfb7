//! Render targets of a frame: linear HDR colour and depth.

/// Linear colour; values above 1 are allowed.
pub const HDR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Reversed-Z needs floats: their small steps near 0 resolve the far land.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// The targets of one image size.
#[derive(Debug)]
pub struct Targets {
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Colour attachment of the HDR pass, with one or several samples per pixel.
    pub hdr_target: wgpu::TextureView,
    /// Resolve target with one sample per pixel; none if `hdr_target` already has one.
    pub resolve_target: Option<wgpu::TextureView>,
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
        let resolve_target = (samples > 1).then(|| view("hdr, resolved", HDR_FORMAT, 1, read));
        let hdr_target = view("hdr", HDR_FORMAT, samples, if samples > 1 { none } else { read_back });
        Self { size, hdr_target, resolve_target, depth: view("depth", DEPTH_FORMAT, samples, none) }
    }

    /// The HDR colour with one sample per pixel.
    #[must_use]
    pub fn hdr(&self) -> &wgpu::TextureView {
        self.resolve_target.as_ref().unwrap_or(&self.hdr_target)
    }

    /// Begins the HDR pass with a cleared colour and the farthest depth. Stores the resolve target
    /// if there is one, else the attachment.
    pub fn begin_hdr<'a>(
        &self,
        encoder: &'a mut wgpu::CommandEncoder,
        clear: wgpu::Color,
        timestamp_writes: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) -> wgpu::RenderPass<'a> {
        let store = if self.resolve_target.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("hdr"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.hdr_target,
                depth_slice: None,
                resolve_target: self.resolve_target.as_ref(),
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
