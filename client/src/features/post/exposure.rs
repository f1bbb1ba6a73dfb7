//! Automatic exposure: meters the HDR colour on the GPU. The result stays there.

use crate::gpu::bind::{bind, compute_uniform_entry, layout, storage_entry, texture_entry};
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::compute_pipelines;
use shaders::SHADERS;
use shaders::layout::{Exposure, METER_GROUPS};

/// A buffer for the metered exposure.
#[must_use]
pub fn exposure_buffer(device: &wgpu::Device) -> wgpu::Buffer {
    use wgpu::BufferUsages as Usage;
    // Only checks copy it.
    let usage = Usage::STORAGE | Usage::UNIFORM | Usage::COPY_SRC;
    create_buffer(device, "exposure", size_of::<Exposure>() as u64, usage)
}

/// The metering pass.
#[derive(Debug)]
pub struct ExposurePass {
    layout: wgpu::BindGroupLayout,
    pipelines: [wgpu::ComputePipeline; 2],
    sums: wgpu::Buffer,
}

impl ExposurePass {
    /// The pass.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        let (compute, d2) = (wgpu::ShaderStages::COMPUTE, wgpu::TextureViewDimension::D2);
        let shader = &SHADERS.meter_exposure;
        let entries = [
            compute_uniform_entry(0),
            compute_uniform_entry(1),
            texture_entry(2, compute, d2, false),
            storage_entry(3, compute, false),
            storage_entry(4, compute, false),
        ];
        let layout = layout(device, shader.name, &entries);
        let pipelines = compute_pipelines(device, shader, &[&layout], ["meter_light", "adapt_exposure"]);
        let bytes = u64::from(METER_GROUPS) * size_of::<[f32; 2]>() as u64;
        let sums = create_buffer(device, "metered sums", bytes, wgpu::BufferUsages::STORAGE);
        Self { layout, pipelines, sums }
    }

    /// Bindings over the HDR colour, which has one sample per pixel. The buffers: uniforms of the
    /// frame, parameters of the post-processing, and the exposure, which is written.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        [frame, post, exposure]: [&wgpu::Buffer; 3],
        hdr: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        let resources = [
            frame.as_entire_binding(),
            post.as_entire_binding(),
            wgpu::BindingResource::TextureView(hdr),
            self.sums.as_entire_binding(),
            exposure.as_entire_binding(),
        ];
        bind(device, SHADERS.meter_exposure.name, &self.layout, &resources)
    }

    /// Records the metering and the adaptation.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, bindings: &wgpu::BindGroup) {
        let [meter, adapt] = &self.pipelines;
        let descriptor = wgpu::ComputePassDescriptor { label: Some("exposure"), timestamp_writes: None };
        let mut pass = encoder.begin_compute_pass(&descriptor);
        pass.set_bind_group(0, bindings, &[]);
        pass.set_pipeline(meter);
        pass.dispatch_workgroups(METER_GROUPS, 1, 1);
        pass.set_pipeline(adapt);
        pass.dispatch_workgroups(1, 1, 1);
    }
}
