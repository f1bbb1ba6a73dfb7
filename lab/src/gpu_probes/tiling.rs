//! Read-back of a tiled material: for measurements and tests of tiling.

use client::features::materials::{MATERIAL_SIZE, Materials};
use client::gpu::bind;
use client::gpu::buffer::create_buffer;
use client::gpu::pipeline::{compute_pass, compute_pipelines};
use client::gpu::{Gpu, GpuError};
use shaders::SHADERS;
use shaders::layout::{TILING_WORKGROUP, TilingProbe};

/// Texels of the probed field: four tiles across, two down.
pub const FIELD: (u32, u32) = (4 * MATERIAL_SIZE, 2 * MATERIAL_SIZE);

/// Input of the probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The baked textures, with this `TILING_*` mode.
    Textures(u32),
    /// The procedural recipe, which repeats after 64 tiles: the reference.
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
}

const BYTES: u64 = 4 * FIELD.0 as u64 * FIELD.1 as u64;

impl ProbeTiling {
    /// A probe of these materials.
    #[must_use]
    pub fn new(gpu: &Gpu, materials: &Materials) -> Self {
        use wgpu::BufferUsages as Usage;
        let device = &gpu.device;
        let buffer = |label, size, usage| create_buffer(device, label, size, usage);
        let order =
            buffer("probe of tiling", size_of::<TilingProbe>() as u64, Usage::UNIFORM | Usage::COPY_DST);
        let luminances = buffer("luminances", BYTES, Usage::STORAGE | Usage::COPY_SRC);
        let shader = SHADERS.probe_tiling;
        let entries =
            [bind::compute_uniform_entry(0), bind::storage_entry(1, wgpu::ShaderStages::COMPUTE, false)];
        let layout = bind::layout(device, shader.name, &entries);
        let bindings = bind::bind_buffers(device, shader.name, &layout, &[&order, &luminances]);
        let [look, without_period] = compute_pipelines(
            device,
            &shader,
            &[&layout, materials.layout()],
            ["sample_material", "without_period"],
        );
        Self { look, without_period, bindings, order, luminances }
    }

    /// Runs the probe and keeps the result on the GPU. Blocks until it is done.
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
            let mut pass = compute_pass(&mut encoder, "probe_tiling");
            pass.set_pipeline(if look == Look::Recipe { &self.without_period } else { &self.look });
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.set_bind_group(1, materials.bindings(), &[]);
            pass.dispatch_workgroups(width.div_ceil(TILING_WORKGROUP), height, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()
    }

    /// Luminances of the last run, row by row.
    ///
    /// # Errors
    /// The device fails.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        Ok(bytemuck::pod_collect_to_vec(&gpu.read_buffer(&self.luminances, 0..BYTES)?))
    }
}
