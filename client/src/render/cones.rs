//! Baking of relaxed cones on the GPU. The definition is `relief::cones`; here is the work cut into
//! pieces that every driver bears.

use crate::relief::cones::{self, MOST_CONES};
use crate::render::pipeline::{compute_pipelines, uniform_entry};
use crate::render::relief::{EXACT, ReliefMaps, texture, whole};
use shaders::SHADERS;
use shaders::layout::{CONE_WORKGROUP, ConeOrder};
use wgpu::util::DeviceExt as _;

/// Heights that a dispatch looks up at most; two cores of a software driver take no more than a
/// quarter of a second for them.
const LOOKUPS: u32 = 1 << 25;

/// Cones over some layers of exact heights with all mip levels and their bounds, [`MOST_CONES`] a
/// side at most; those of other layers are 0. Each dispatch is submitted alone and waited for:
/// several long ones in one queue make some drivers give up on the device.
#[must_use]
pub fn bake(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    heights: &wgpu::Texture,
    tops: &wgpu::TextureView,
    layers: &[u32],
) -> wgpu::Texture {
    let side = heights.width();
    let (block, most) = (cones::block(side), side.min(MOST_CONES));
    let levels = most.ilog2() + 1;
    let baked = texture(device, "cones", EXACT, most, most, heights.depth_or_array_layers(), levels);
    let shader = SHADERS.bake_cones;
    let [numbers, ..] = ReliefMaps::layout_entries(1, wgpu::ShaderStages::COMPUTE);
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(shader.name),
        entries: &[
            wgpu::BindGroupLayoutEntry { visibility: wgpu::ShaderStages::COMPUTE, ..uniform_entry(0) },
            numbers,
            wgpu::BindGroupLayoutEntry { binding: 2, ..numbers },
            wgpu::BindGroupLayoutEntry {
                binding: 3,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::StorageTexture {
                    access: wgpu::StorageTextureAccess::WriteOnly,
                    format: EXACT,
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                },
                count: None,
            },
        ],
    });
    let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["bake_cones"]);
    let read = whole(heights);
    for lod in 0..levels {
        let written = baked.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            base_mip_level: lod,
            mip_level_count: Some(1),
            ..Default::default()
        });
        let per_cone = cones::DIRECTIONS as u32 * (side >> lod);
        let count = (LOOKUPS / per_cone).next_multiple_of(CONE_WORKGROUP);
        let all = (most >> lod).pow(2);
        for (layer, first) in
            layers.iter().flat_map(|layer| (0..all).step_by(count as usize).map(move |first| (*layer, first)))
        {
            let count = count.min(all - first);
            let directions = cones::directions();
            let order = ConeOrder { side, lod, layer, block, first, count, reserved: [0; 2], directions };
            let order = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("cones to bake"),
                contents: bytemuck::bytes_of(&order),
                usage: wgpu::BufferUsages::UNIFORM,
            });
            let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(shader.name),
                layout: &layout,
                entries: &[
                    wgpu::BindGroupEntry { binding: 0, resource: order.as_entire_binding() },
                    wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&read) },
                    wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(tops) },
                    wgpu::BindGroupEntry {
                        binding: 3,
                        resource: wgpu::BindingResource::TextureView(&written),
                    },
                ],
            });
            let mut encoder =
                device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(shader.name) });
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: Some(shader.name),
                    timestamp_writes: None,
                });
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &bindings, &[]);
                pass.dispatch_workgroups(count.div_ceil(CONE_WORKGROUP), 1, 1);
            }
            queue.submit([encoder.finish()]);
            // A device that has failed says so where its picture is asked for.
            let _ = device.poll(wgpu::PollType::wait_indefinitely());
        }
    }
    baked
}
