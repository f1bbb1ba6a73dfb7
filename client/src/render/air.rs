//! The pass before all others: what sun and sky give in a frame, measured on the GPU and written into the frame's uniforms.

use shaders::SHADERS;
use shaders::layout::{Air, Frame};
use std::mem::offset_of;

const AIR_BYTES: u64 = size_of::<Air>() as u64;

/// The pass.
#[derive(Debug)]
pub struct AirPass {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    /// Where the shader writes: uniforms are read-only to it.
    measured: wgpu::Buffer,
}

impl AirPass {
    /// The pass over a frame's uniforms.
    #[must_use]
    pub fn new(device: &wgpu::Device, frame: &wgpu::Buffer) -> Self {
        let shader = SHADERS.measure_sky;
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(shader.name),
            entries: &[
                entry(0, wgpu::BufferBindingType::Uniform),
                entry(1, wgpu::BufferBindingType::Storage { read_only: false }),
            ],
        });
        let measured = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("air"),
            size: AIR_BYTES,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: measured.as_entire_binding() },
            ],
        });
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(shader.name),
            source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(shader.name),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(shader.name),
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        Self { pipeline, bindings, measured }
    }

    /// Records the measurement; passes that are recorded later read it from `frame`, the buffer that the pass was made for.
    pub fn measure(&self, encoder: &mut wgpu::CommandEncoder, frame: &wgpu::Buffer) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("air"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&self.measured, 0, frame, offset_of!(Frame, air) as u64, AIR_BYTES);
    }
}
