//! Bakes relaxed cones on the GPU. The definition is in `cones`; here the work is cut into
//! dispatches that every driver completes.
//!
//! Three steps, as of a read-back: [`ConeBake::start`], [`ConeBake::poll`] until it says that all
//! is done, [`ConeBake::result`]. None of them waits, because a browser cannot.

use crate::features::pom::cones;
use crate::features::pom::cones::MOST_CONES;
use crate::features::pom::textures::{UNFILTERED_FORMAT, texture, whole};
use crate::gpu::bind;
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use crate::gpu::readback::{PendingWork, ReadbackError};
use shaders::SHADERS;
use shaders::layout::{CONE_WORKGROUP, ConeOrder};
use std::collections::VecDeque;

/// Most height lookups of a dispatch: at most a quarter of a second on two cores of a software
/// driver.
const LOOKUPS: u32 = 1 << 25;

/// Cones in the making.
#[derive(Debug)]
pub struct ConeBake {
    baked: wgpu::Texture,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    heights: wgpu::TextureView,
    max_mips: wgpu::TextureView,
    side: u32,
    /// Dispatches that are left.
    parts: VecDeque<Part>,
    /// The dispatch that was submitted. Each is submitted alone: several long ones in one queue
    /// make some drivers lose the device.
    running: Option<PendingWork>,
}

/// Some cones of one mip level of one layer.
#[derive(Clone, Copy, Debug)]
struct Part {
    lod: u32,
    layer: u32,
    first: u32,
    count: u32,
}

impl ConeBake {
    /// Cones of some layers of exact heights with all mip levels and their max mips, at most
    /// [`MOST_CONES`] a side; 0 in other layers. Nothing is submitted yet.
    #[must_use]
    pub fn start(
        device: &wgpu::Device,
        heights: &wgpu::Texture,
        max_mips: &wgpu::TextureView,
        layers: &[u32],
    ) -> Self {
        let side = heights.width();
        let most = side.min(MOST_CONES);
        let levels = most.ilog2() + 1;
        let shader = SHADERS.bake_cones;
        let (stages, array) = (wgpu::ShaderStages::COMPUTE, wgpu::TextureViewDimension::D2Array);
        let entries = [
            bind::compute_uniform_entry(0),
            bind::texture_entry(1, stages, array, false),
            bind::texture_entry(2, stages, array, false),
            bind::storage_texture_entry(3, UNFILTERED_FORMAT, wgpu::StorageTextureAccess::WriteOnly),
        ];
        let layout = bind::layout(device, shader.name, &entries);
        let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["bake_cones"]);
        let mut parts = VecDeque::new();
        for lod in 0..levels {
            let per_cone = cones::DIRECTIONS as u32 * (side >> lod);
            let count = (LOOKUPS / per_cone).next_multiple_of(CONE_WORKGROUP);
            let all = (most >> lod).pow(2);
            for layer in layers {
                let firsts = (0..all).step_by(count as usize);
                parts.extend(firsts.map(|first| {
                    let count = count.min(all - first);
                    Part { lod, layer: *layer, first, count }
                }));
            }
        }
        Self {
            baked: texture(
                device,
                "cones",
                UNFILTERED_FORMAT,
                most,
                most,
                heights.depth_or_array_layers(),
                levels,
            ),
            pipeline,
            layout,
            heights: whole(heights),
            max_mips: max_mips.clone(),
            side,
            parts,
            running: None,
        }
    }

    /// Submits the next dispatch if the one before is done. Returns whether all are. Never blocks.
    ///
    /// # Errors
    /// The device is lost.
    pub fn poll(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) -> Result<bool, ReadbackError> {
        if let Some(running) = &mut self.running
            && !running.poll(device)?
        {
            return Ok(false);
        }
        self.running = self.parts.pop_front().map(|part| self.submit(part, device, queue));
        Ok(self.running.is_none())
    }

    fn submit(&self, part: Part, device: &wgpu::Device, queue: &wgpu::Queue) -> PendingWork {
        let Part { lod, layer, first, count } = part;
        let (shader, directions) = (SHADERS.bake_cones, cones::directions());
        let (side, block) = (self.side, cones::block(self.side));
        let order = ConeOrder { side, lod, layer, block, first, count, reserved: [0; 2], directions };
        let uniforms = create_buffer(
            device,
            "cones to bake",
            size_of::<ConeOrder>() as u64,
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        );
        queue.write_buffer(&uniforms, 0, bytemuck::bytes_of(&order));
        let written = self.baked.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            base_mip_level: lod,
            mip_level_count: Some(1),
            ..Default::default()
        });
        let view = wgpu::BindingResource::TextureView;
        let resources =
            [uniforms.as_entire_binding(), view(&self.heights), view(&self.max_mips), view(&written)];
        let bindings = bind::bind(device, shader.name, &self.layout, &resources);
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(shader.name) });
        {
            let mut pass = compute_pass(&mut encoder, shader.name);
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups(count.div_ceil(CONE_WORKGROUP), 1, 1);
        }
        queue.submit([encoder.finish()]);
        PendingWork::start(queue)
    }

    /// The cones, complete once [`ConeBake::poll`] has returned true.
    #[must_use]
    pub fn result(self) -> wgpu::Texture {
        self.baked
    }
}
