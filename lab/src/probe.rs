//! Buffers and dispatches of measurements on the GPU.

use crate::adapters::OpenGpu;
use anyhow::{Context, Result};
use bytemuck::Pod;
use client::gpu::Gpu;
use shaders::Shader;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use wgpu::BufferUsages as Usage;
use wgpu::util::DeviceExt as _;

/// A device that reports its faults.
pub trait Opened {
    /// The device.
    fn device(&self) -> &wgpu::Device;
    /// Its queue.
    fn queue(&self) -> &wgpu::Queue;
    /// Blocks until everything submitted is done.
    fn finish(&self) -> Result<()>;
}

impl Opened for Gpu {
    fn device(&self) -> &wgpu::Device {
        &self.device
    }
    fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }
    fn finish(&self) -> Result<()> {
        Ok(self.wait()?)
    }
}

impl Opened for OpenGpu {
    fn device(&self) -> &wgpu::Device {
        &self.device
    }
    fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }
    fn finish(&self) -> Result<()> {
        self.wait()
    }
}

/// The compute pipeline of a shader, with the layout of its bindings; without a name its only entry
/// point.
pub fn pipeline(gpu: &impl Opened, shader: &Shader, entry_point: Option<&str>) -> wgpu::ComputePipeline {
    let module = gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name),
        source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
    });
    gpu.device().create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(shader.name),
        layout: None,
        module: &module,
        entry_point,
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}

/// Bindings 0, 1, ... of group 0.
pub fn bind<'a>(
    gpu: &impl Opened,
    pipeline: &wgpu::ComputePipeline,
    resources: impl IntoIterator<Item = wgpu::BindingResource<'a>>,
) -> wgpu::BindGroup {
    let entries: Vec<_> =
        (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &entries,
    })
}

/// A uniform buffer with a value.
pub fn uniform<T: Pod>(gpu: &impl Opened, label: &str, value: &T) -> wgpu::Buffer {
    filled(gpu, label, bytemuck::bytes_of(value), Usage::UNIFORM)
}

/// A storage buffer with values, to be read.
pub fn input<T: Pod>(gpu: &impl Opened, label: &str, values: &[T]) -> wgpu::Buffer {
    filled(gpu, label, bytemuck::cast_slice(values), Usage::STORAGE)
}

fn filled(gpu: &impl Opened, label: &str, contents: &[u8], usage: Usage) -> wgpu::Buffer {
    gpu.device().create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(label), contents, usage })
}

/// A storage buffer for `count` values, to be written and [`read`].
pub fn output<T: Pod>(gpu: &impl Opened, label: &str, count: usize) -> wgpu::Buffer {
    gpu.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: (size_of::<T>() * count) as u64,
        usage: Usage::STORAGE | Usage::COPY_SRC,
        mapped_at_creation: false,
    })
}

/// Dispatches a row of workgroups, `repeats` times for a time that outweighs what a submission
/// costs; how long the GPU took, uploads excluded.
pub fn dispatch(
    gpu: &impl Opened,
    pipeline: &wgpu::ComputePipeline,
    bindings: &wgpu::BindGroup,
    groups: u32,
    repeats: u32,
) -> Result<Duration> {
    gpu.queue().submit([]);
    gpu.finish()?;
    let begun = Instant::now();
    let mut encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, bindings, &[]);
        for _ in 0..repeats {
            pass.dispatch_workgroups(groups, 1, 1);
        }
    }
    gpu.queue().submit([encoder.finish()]);
    gpu.finish()?;
    Ok(begun.elapsed())
}

/// All values of an [`output`].
pub fn read<T: Pod>(gpu: &impl Opened, output: &wgpu::Buffer) -> Result<Vec<T>> {
    let landing = gpu.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some("results on the CPU"),
        size: output.size(),
        usage: Usage::MAP_READ | Usage::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(output, 0, &landing, 0, output.size());
    gpu.queue().submit([encoder.finish()]);
    let (done, mapped) = mpsc::channel();
    landing.map_async(wgpu::MapMode::Read, .., move |outcome| {
        // The receiver is gone only if waiting has failed.
        let _ = done.send(outcome);
    });
    gpu.finish()?;
    mapped.recv().context("the GPU dropped the results")?.context("the results cannot be read")?;
    let view = landing.get_mapped_range(..).context("the results cannot be read")?;
    Ok(bytemuck::cast_slice(&view).to_vec())
}
