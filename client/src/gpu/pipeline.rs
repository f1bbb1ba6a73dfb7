//! Render and compute pipelines of linked shaders.

use crate::gpu::targets::{DEPTH_FORMAT, HDR_FORMAT};
use shaders::{Shader, Stage};

/// Depth test and depth write of a pass. Reversed-Z: nearer is greater, infinity is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// Tests and writes depth.
    Solid,
    /// Tests depth only; blends.
    Transparent,
    /// Drawn only where no depth was written.
    Background,
}

/// Color target and entry points of a pass; the shader's first entry points where none is named.
#[derive(Clone, Copy, Debug)]
pub struct Output<'a> {
    /// Vertex entry point.
    pub vertex: Option<&'a str>,
    /// Fragment entry point.
    pub fragment: Option<&'a str>,
    /// Format of the colour target; none for depth only.
    pub format: Option<wgpu::TextureFormat>,
}

/// Linear HDR colour, by the first entry points.
pub const HDR: Output<'static> = Output { vertex: None, fragment: None, format: Some(HDR_FORMAT) };

/// Depth only: no fragment shader.
pub const DEPTH: Output<'static> = Output { vertex: None, fragment: None, format: None };

/// A pass that writes the HDR target.
#[derive(Debug)]
pub struct HdrPass<'a> {
    /// The shader.
    pub shader: &'a Shader,
    /// Layouts of its bind groups, group 0 first.
    pub layouts: &'a [&'a wgpu::BindGroupLayout],
    /// Its vertex buffers.
    pub buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    /// Depth test and write.
    pub depth: Depth,
    /// Samples per pixel of the targets.
    pub samples: u32,
}

impl HdrPass<'_> {
    /// The pipeline of the pass.
    #[must_use]
    pub fn pipeline(&self, device: &wgpu::Device) -> wgpu::RenderPipeline {
        self.build(device, HDR, SOLID, &[])
    }

    /// The depth-only pipeline.
    #[must_use]
    pub fn depth_pipeline(&self, device: &wgpu::Device) -> wgpu::RenderPipeline {
        self.build(device, DEPTH, SOLID, &[])
    }

    /// The pipeline with another fragment entry point.
    #[must_use]
    pub fn pipeline_with_fragment(&self, device: &wgpu::Device, fragment: &str) -> wgpu::RenderPipeline {
        self.build(device, Output { fragment: Some(fragment), ..HDR }, SOLID, &[])
    }

    /// The pipeline of plants: two-sided, at a level of detail that the shader reads as its
    /// constant `LEVEL`.
    #[must_use]
    pub fn clump_pipeline(
        &self,
        device: &wgpu::Device,
        output: Output<'_>,
        topology: wgpu::PrimitiveTopology,
        level: usize,
    ) -> wgpu::RenderPipeline {
        let primitive = wgpu::PrimitiveState { topology, cull_mode: None, ..Default::default() };
        self.build(device, output, primitive, &[("LEVEL", level as f64)])
    }

    /// The pipeline of triangles that both sides of are drawn.
    #[must_use]
    pub fn two_sided_pipeline(&self, device: &wgpu::Device, output: Output<'_>) -> wgpu::RenderPipeline {
        self.build(device, output, wgpu::PrimitiveState { cull_mode: None, ..SOLID }, &[])
    }

    fn build(
        &self,
        device: &wgpu::Device,
        output: Output<'_>,
        primitive: wgpu::PrimitiveState,
        constants: &[(&str, f64)],
    ) -> wgpu::RenderPipeline {
        let (compare, write, blend) = match self.depth {
            Depth::Solid => (wgpu::CompareFunction::Greater, true, None),
            Depth::Transparent => {
                (wgpu::CompareFunction::Greater, false, Some(wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING))
            }
            Depth::Background => (wgpu::CompareFunction::GreaterEqual, false, None),
        };
        let depth_stencil = wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(write),
            depth_compare: Some(compare),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        };
        build(
            device,
            (self.shader, output, constants),
            self.layouts,
            self.buffers,
            primitive,
            Some(depth_stencil),
            self.samples,
            output.format.map(|format| wgpu::ColorTargetState {
                format,
                blend,
                write_mask: wgpu::ColorWrites::ALL,
            }),
        )
    }
}

/// A pipeline without depth test, one sample per pixel, by one fragment entry point.
#[must_use]
pub fn screen_pipeline(
    device: &wgpu::Device,
    shader: &Shader,
    layout: &wgpu::BindGroupLayout,
    fragment: &str,
    target: wgpu::ColorTargetState,
) -> wgpu::RenderPipeline {
    let output = Output { fragment: Some(fragment), ..HDR };
    build(device, (shader, output, &[]), &[layout], &[], SOLID, None, 1, Some(target))
}

/// Back-face culled triangles.
const SOLID: wgpu::PrimitiveState = wgpu::PrimitiveState {
    topology: wgpu::PrimitiveTopology::TriangleList,
    strip_index_format: None,
    front_face: wgpu::FrontFace::Ccw,
    cull_mode: Some(wgpu::Face::Back),
    unclipped_depth: false,
    polygon_mode: wgpu::PolygonMode::Fill,
    conservative: false,
};

#[expect(
    clippy::too_many_arguments,
    reason = "called twice, both above, with everything that a pipeline is made of"
)]
fn build(
    device: &wgpu::Device,
    (shader, output, constants): (&Shader, Output<'_>, &[(&str, f64)]),
    layouts: &[&wgpu::BindGroupLayout],
    buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
    primitive: wgpu::PrimitiveState,
    depth_stencil: Option<wgpu::DepthStencilState>,
    samples: u32,
    target: Option<wgpu::ColorTargetState>,
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name),
        source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
    });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(shader.name),
        bind_group_layouts: &layouts.iter().copied().map(Some).collect::<Vec<_>>(),
        immediate_size: 0,
    });
    let options = wgpu::PipelineCompilationOptions { constants, ..Default::default() };
    let entry = |stage| shader.entry_points.iter().find(|entry| entry.stage == stage).map(|entry| entry.name);
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(shader.name),
        layout: Some(&pipeline_layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: output.vertex.or_else(|| entry(Stage::Vertex)),
            compilation_options: options.clone(),
            buffers,
        },
        primitive,
        depth_stencil,
        multisample: wgpu::MultisampleState { count: samples, ..Default::default() },
        fragment: target.is_some().then_some(wgpu::FragmentState {
            module: &module,
            entry_point: output.fragment.or_else(|| entry(Stage::Fragment)),
            compilation_options: options,
            targets: &[target],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// The pipelines of a pass's compute entry points, over bind groups of these layouts, group 0
/// first. The shader is compiled once for all of them.
#[must_use]
pub fn compute_pipelines<const N: usize>(
    device: &wgpu::Device,
    shader: &Shader,
    layouts: &[&wgpu::BindGroupLayout],
    entry_points: [&str; N],
) -> [wgpu::ComputePipeline; N] {
    compute_pipelines_with(device, shader, layouts, entry_points, &[])
}

/// [`compute_pipelines`] with values of the shader's overrides, each of which it must have.
#[must_use]
pub fn compute_pipelines_with<const N: usize>(
    device: &wgpu::Device,
    shader: &Shader,
    layouts: &[&wgpu::BindGroupLayout],
    entry_points: [&str; N],
    constants: &[(&str, f64)],
) -> [wgpu::ComputePipeline; N] {
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(shader.name),
        bind_group_layouts: &layouts.iter().copied().map(Some).collect::<Vec<_>>(),
        immediate_size: 0,
    });
    build_compute(device, shader, Some(&layout), entry_points, constants)
}

/// [`compute_pipelines`] with layouts derived from the shader, for each entry point its own.
#[must_use]
pub fn derived_compute_pipelines<const N: usize>(
    device: &wgpu::Device,
    shader: &Shader,
    entry_points: [&str; N],
) -> [wgpu::ComputePipeline; N] {
    build_compute(device, shader, None, entry_points, &[])
}

fn build_compute<const N: usize>(
    device: &wgpu::Device,
    shader: &Shader,
    layout: Option<&wgpu::PipelineLayout>,
    entry_points: [&str; N],
    constants: &[(&str, f64)],
) -> [wgpu::ComputePipeline; N] {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name),
        source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
    });
    entry_points.map(|entry_point| {
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry_point),
            layout,
            module: &module,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            cache: None,
        })
    })
}

/// Begins a compute pass without timestamps.
#[must_use]
pub fn compute_pass<'a>(encoder: &'a mut wgpu::CommandEncoder, label: &str) -> wgpu::ComputePass<'a> {
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(label), timestamp_writes: None })
}
