//! Passes over probes on the GPU: probes in, results out, timed.

use anyhow::Result;
use bytemuck::Pod;
use client::gpu::Gpu;
use shaders::Shader;
use std::time::{Duration, Instant};
use wgpu::BufferUsages as Usage;
use wgpu::util::DeviceExt as _;

/// The compute pipeline of a shader, with the layout of its bindings; without a name its only entry
/// point.
pub fn pipeline(gpu: &Gpu, shader: &Shader, entry_point: Option<&str>) -> wgpu::ComputePipeline {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name),
        source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
    });
    gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(shader.name),
        layout: None,
        module: &module,
        entry_point,
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}

/// A buffer with values, to be read.
pub fn filled(gpu: &Gpu, contents: &[u8], usage: Usage) -> wgpu::Buffer {
    gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
}

/// How a pass is dispatched.
#[derive(Clone, Copy, Debug)]
pub struct Dispatch {
    /// Invocations, and results.
    pub count: usize,
    /// Invocations of a workgroup.
    pub workgroup: u32,
    /// Dispatches, for a time that outweighs what a submission costs.
    pub repeats: u32,
}

impl Dispatch {
    /// One dispatch in workgroups of 64.
    pub const fn once(count: usize) -> Self {
        Self { count, workgroup: 64, repeats: 1 }
    }
}

/// Runs a pass whose last two bindings are its probes and its results, behind those given; also how
/// long the GPU took, uploads and read-back excluded.
pub fn run<'a, P: Pod, R: Pod>(
    gpu: &Gpu,
    pipeline: &wgpu::ComputePipeline,
    resources: impl IntoIterator<Item = wgpu::BindingResource<'a>>,
    probes: &[P],
    Dispatch { count, workgroup, repeats }: Dispatch,
) -> Result<(Vec<R>, Duration)> {
    let input = filled(gpu, bytemuck::cast_slice(probes), Usage::STORAGE);
    let output = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("results"),
        size: (size_of::<R>() * count) as u64,
        usage: Usage::STORAGE | Usage::COPY_SRC,
        mapped_at_creation: false,
    });
    let given: Vec<wgpu::BindingResource<'a>> = resources.into_iter().collect();
    let mut resources: Vec<wgpu::BindingResource<'_>> = given;
    resources.extend([&input, &output].map(wgpu::Buffer::as_entire_binding));
    let entries: Vec<_> =
        (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &entries,
    });
    // Uploads are done before the time begins.
    gpu.queue.submit([]);
    gpu.wait()?;
    let begun = Instant::now();
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        for _ in 0..repeats {
            pass.dispatch_workgroups((count as u32).div_ceil(workgroup), 1, 1);
        }
    }
    gpu.queue.submit([encoder.finish()]);
    gpu.wait()?;
    let took = begun.elapsed();
    let bytes = gpu.read_buffer(&output, 0..output.size())?;
    Ok((bytemuck::pod_collect_to_vec(&bytes), took))
}
