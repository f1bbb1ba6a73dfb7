//! What only measurements and tests read from the renderer: linear light, and the ids of visible
//! plants. They block, which a browser cannot.

use super::Renderer;
use crate::features::vegetation::draw::ID_FORMAT;
use crate::frame::FrameData;
use crate::gpu::{Gpu, GpuError, OffscreenTarget, offscreen};

impl Renderer {
    /// Draws a frame and returns its linear HDR colour, row by row from the top: RGBA as half
    /// floats. For checks before the tone curve. Blocks until it is drawn; none with several
    /// samples per pixel.
    ///
    /// # Errors
    /// The device fails.
    pub fn read_hdr(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        target: &OffscreenTarget,
    ) -> Result<Option<Vec<u16>>, GpuError> {
        self.finish_bake(gpu, frame)?;
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.draw(gpu, frame, &mut encoder, &target.view);
        gpu.queue.submit([encoder.finish()]);
        if self.targets.resolve_target.is_some() {
            return Ok(None);
        }
        let bytes = offscreen::read_texture(gpu, self.targets.hdr_target.texture(), 8)?;
        Ok(Some(bytes.chunks_exact(2).map(|half| u16::from_le_bytes([half[0], half[1]])).collect()))
    }

    /// Records the culling of the vegetation alone, for measurements; drawing includes it.
    pub fn cull_vegetation(&mut self, gpu: &Gpu, frame: &FrameData, encoder: &mut wgpu::CommandEncoder) {
        // Trees are placed with the patterns of the frame.
        gpu.queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&frame.uniforms));
        self.cull(gpu, frame, encoder);
    }

    /// Draws the ids of the plants that were last culled, behind the frame's land, and returns
    /// those of each pixel, row by row from the top; zeros where no plant is visible. An id is the
    /// position of the plant: fine units east of the field's low corner (24 bits) with the kind of
    /// plant above them, and fine units south with bit 24 set. For checks; blocks until it is
    /// drawn. None with several samples per pixel.
    ///
    /// # Errors
    /// The device fails.
    pub fn read_ids(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<Option<Vec<[u32; 2]>>, GpuError> {
        if self.samples > 1 {
            return Ok(None);
        }
        self.retarget(gpu, frame);
        gpu.queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&frame.uniforms));
        self.terrain.prepare(&gpu.queue, &frame.instances);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let depth = |load, store| {
            let ops = Some(wgpu::Operations { load, store });
            let view = &self.targets.depth;
            Some(wgpu::RenderPassDepthStencilAttachment { view, depth_ops: ops, stencil_ops: None })
        };
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("land before ids"),
                depth_stencil_attachment: depth(wgpu::LoadOp::Clear(0.0), wgpu::StoreOp::Store),
                ..Default::default()
            });
            self.terrain.draw_depth(&gpu.device, &mut pass, &self.materials, &self.clipmap);
        }
        let ids = id_buffer(&gpu.device, self.targets.size);
        if let Some(vegetation) = self.vegetation.as_mut().filter(|_| frame.plants.is_some()) {
            let view = ids.create_view(&wgpu::TextureViewDescriptor::default());
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("ids"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: depth(wgpu::LoadOp::Load, wgpu::StoreOp::Discard),
                ..Default::default()
            });
            vegetation.draw_ids(gpu, &mut pass);
        }
        gpu.queue.submit([encoder.finish()]);
        let bytes = offscreen::read_texture(gpu, &ids, 8)?;
        let word = |four: &[u8]| u32::from_le_bytes([four[0], four[1], four[2], four[3]]);
        Ok(Some(bytes.chunks_exact(8).map(|pixel| [word(&pixel[..4]), word(&pixel[4..])]).collect()))
    }
}

/// An id buffer of at least 1 x 1 pixels.
fn id_buffer(device: &wgpu::Device, (width, height): (u32, u32)) -> wgpu::Texture {
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
