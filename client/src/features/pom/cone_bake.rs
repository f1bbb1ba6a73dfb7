//! Bakes relaxed cones on the GPU. The definition is in `cones`; here the work is cut into
//! dispatches that every driver completes.

use crate::features::pom::cones;
use crate::features::pom::cones::MOST_CONES;
use crate::features::pom::textures::{EXACT, texture, whole};
use crate::gpu::bind;
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use shaders::SHADERS;
use shaders::layout::{CONE_WORKGROUP, ConeOrder};
use wgpu::util::DeviceExt as _;

/// Most height lookups of a dispatch: at most a quarter of a second on two cores of a software
/// driver.
const LOOKUPS: u32 = 1 << 25;

/// Cones of some layers of exact heights with all mip levels and their max mips, at most
/// [`MOST_CONES`] a side; 0 in other layers. Each dispatch is submitted alone and waited for:
/// several long ones in one queue make some drivers lose the device.
#[must_use]
pub fn bake(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    heights: &wgpu::Texture,
    max_mips: &wgpu::TextureView,
    layers: &[u32],
) -> wgpu::Texture {
    let side = heights.width();
    let (block, most) = (cones::block(side), side.min(MOST_CONES));
    let levels = most.ilog2() + 1;
    let baked = texture(device, "cones", EXACT, most, most, heights.depth_or_array_layers(), levels);
    let shader = SHADERS.bake_cones;
    let (stages, array) = (wgpu::ShaderStages::COMPUTE, wgpu::TextureViewDimension::D2Array);
    let entries = [
        bind::compute_uniform_entry(0),
        bind::texture_entry(1, stages, array, false),
        bind::texture_entry(2, stages, array, false),
        bind::storage_texture_entry(3, EXACT, wgpu::StorageTextureAccess::WriteOnly),
    ];
    let layout = bind::layout(device, shader.name, &entries);
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
            let view = wgpu::BindingResource::TextureView;
            let resources = [order.as_entire_binding(), view(&read), view(max_mips), view(&written)];
            let bindings = bind::bind(device, shader.name, &layout, &resources);
            let mut encoder =
                device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(shader.name) });
            {
                let mut pass = compute_pass(&mut encoder, shader.name);
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &bindings, &[]);
                pass.dispatch_workgroups(count.div_ceil(CONE_WORKGROUP), 1, 1);
            }
            queue.submit([encoder.finish()]);
            // A failed device reports its fault at the next check.
            let _ = device.poll(wgpu::PollType::wait_indefinitely());
        }
    }
    baked
}
