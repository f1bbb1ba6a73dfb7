//! A material as the land sees it, read back: for measurements and tests of what hides repetition.

use crate::render::gpu::{Gpu, GpuError};
use crate::render::materials::{MATERIAL_SIZE, Materials};
use crate::render::pipeline::compute_pipelines;
use shaders::SHADERS;
use shaders::layout::{TILING_WORKGROUP, TilingProbe};
use std::sync::mpsc;

/// Texels of the field that is looked at: four tiles across, two down.
pub const FIELD: (u32, u32) = (4 * MATERIAL_SIZE, 2 * MATERIAL_SIZE);

/// What is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The baked textures, by the `TILING_*` word of a knob.
    Textures(u32),
    /// The recipe itself, which repeats after 64 tiles: the truth.
    Recipe,
}

/// The probe.
#[derive(Debug)]
pub struct ProbeTiling {
    look: wgpu::ComputePipeline,
    without_period: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    order: wgpu::Buffer,
    luminances: wgpu::Buffer,
    landing: wgpu::Buffer,
}

const BYTES: u64 = 4 * FIELD.0 as u64 * FIELD.1 as u64;

impl ProbeTiling {
    /// A probe of these materials.
    #[must_use]
    pub fn new(gpu: &Gpu, materials: &Materials) -> Self {
        use wgpu::BufferUsages as Usage;
        let device = &gpu.device;
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let order =
            buffer("probe of tiling", size_of::<TilingProbe>() as u64, Usage::UNIFORM | Usage::COPY_DST);
        let luminances = buffer("luminances", BYTES, Usage::STORAGE | Usage::COPY_SRC);
        let landing = buffer("luminances, read back", BYTES, Usage::COPY_DST | Usage::MAP_READ);
        let shader = SHADERS.probe_tiling;
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
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: order.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: luminances.as_entire_binding() },
            ],
        });
        let [look, without_period] =
            compute_pipelines(device, &shader, &[&layout, materials.layout()], ["look", "without_period"]);
        Self { look, without_period, bindings, order, luminances, landing }
    }

    /// Looks, and leaves what was seen on the GPU. Blocks until it is done.
    ///
    /// # Errors
    /// The device fails.
    pub fn run(
        &self,
        gpu: &Gpu,
        materials: &Materials,
        material: u32,
        look: Look,
        anchor_m: [f32; 2],
    ) -> Result<(), GpuError> {
        let tiling = match look {
            Look::Textures(tiling) => tiling,
            Look::Recipe => 0,
        };
        let (width, height) = FIELD;
        let probe =
            TilingProbe { anchor_m, material, tiling, width, height, size: MATERIAL_SIZE, period: 64 };
        gpu.queue.write_buffer(&self.order, 0, bytemuck::bytes_of(&probe));
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("probe_tiling"),
                timestamp_writes: None,
            });
            pass.set_pipeline(if look == Look::Recipe { &self.without_period } else { &self.look });
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.set_bind_group(1, materials.bindings(), &[]);
            pass.dispatch_workgroups(width.div_ceil(TILING_WORKGROUP), height, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()
    }

    /// What the last run saw: luminances, row by row.
    ///
    /// # Errors
    /// The device fails.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&self.luminances, 0, &self.landing, 0, BYTES);
        gpu.queue.submit([encoder.finish()]);
        let (told, tell) = mpsc::channel();
        self.landing.map_async(wgpu::MapMode::Read, .., move |outcome| {
            // Nobody listens only if the wait below failed first.
            let _ = told.send(outcome);
        });
        gpu.wait()?;
        let fault = |cause: &dyn std::fmt::Display| GpuError::Fault(format!("read-back failed: {cause}"));
        tell.recv().map_err(|error| fault(&error))?.map_err(|error| fault(&error))?;
        let view = self.landing.get_mapped_range(..).map_err(|error| fault(&error))?;
        let seen = bytemuck::cast_slice(&view).to_vec();
        drop(view);
        self.landing.unmap();
        Ok(seen)
    }
}
