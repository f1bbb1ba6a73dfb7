//! What all passes' pipelines have in common: a linked shader, one bind group, the gathering
//! targets.

use crate::render::targets::{DEPTH_FORMAT, LIGHT_FORMAT, NAME_FORMAT};
use shaders::{Shader, Stage};

/// How a pass meets the depth buffer. Reversed-Z: nearer is greater, the far end is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// Hides and is hidden.
    Solid,
    /// Is hidden, hides nothing.
    Transparent,
    /// Drawn only where nothing solid is.
    Background,
}

/// What a pass writes, and by which entry points; the shader's first ones where none is named.
#[derive(Clone, Copy, Debug)]
pub struct Output<'a> {
    vertex: Option<&'a str>,
    fragment: Option<&'a str>,
    /// Of the one target beside depth; none where depth is all.
    format: Option<wgpu::TextureFormat>,
}

/// Light, by the first entry points.
pub const LIGHT: Output<'static> = Output { vertex: None, fragment: None, format: Some(LIGHT_FORMAT) };

/// Depth alone: no fragment is shaded.
pub const DEPTH: Output<'static> = Output { vertex: None, fragment: None, format: None };

/// Names of what is drawn, for passes whose shaders have entry points for that.
pub const NAMES: Output<'static> =
    Output { vertex: Some("named_vertex"), fragment: Some("named_fragment"), format: Some(NAME_FORMAT) };

/// What differs between the passes that gather light.
#[derive(Debug)]
pub struct LightPass<'a> {
    /// The shader.
    pub shader: &'a Shader,
    /// Layouts of its bind groups, group 0 first.
    pub layouts: &'a [&'a wgpu::BindGroupLayout],
    /// Its vertex buffers.
    pub buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    /// Its place in depth.
    pub depth: Depth,
    /// Samples per pixel of the targets.
    pub samples: u32,
}

impl LightPass<'_> {
    /// The pipeline of the pass.
    #[must_use]
    pub fn pipeline(&self, device: &wgpu::Device) -> wgpu::RenderPipeline {
        self.build(device, LIGHT, SOLID, &[])
    }

    /// The pipeline that leaves nothing but depth.
    #[must_use]
    pub fn depth_pipeline(&self, device: &wgpu::Device) -> wgpu::RenderPipeline {
        self.build(device, DEPTH, SOLID, &[])
    }

    /// The pipeline of one of several ways of writing what the pass draws.
    #[must_use]
    pub fn pipeline_of(&self, device: &wgpu::Device, fragment: &str) -> wgpu::RenderPipeline {
        self.build(device, Output { fragment: Some(fragment), ..LIGHT }, SOLID, &[])
    }

    /// The pipeline of leaves, which are seen from both sides, at a level of detail that the shader
    /// takes as its constant `LEVEL`.
    #[must_use]
    pub fn pipeline_of_leaves(
        &self,
        device: &wgpu::Device,
        output: Output<'_>,
        topology: wgpu::PrimitiveTopology,
        level: usize,
    ) -> wgpu::RenderPipeline {
        let leaves = wgpu::PrimitiveState { topology, cull_mode: None, ..Default::default() };
        self.build(device, output, leaves, &[("LEVEL", level as f64)])
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

/// A pipeline that draws triangles over a plain target, without depth.
#[must_use]
pub fn flat_pipeline(
    device: &wgpu::Device,
    shader: &Shader,
    layout: &wgpu::BindGroupLayout,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    build(device, (shader, LIGHT, &[]), &[layout], &[], SOLID, None, 1, Some(format.into()))
}

/// Triangles that are seen from one side.
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
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name),
        source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(shader.name),
        bind_group_layouts: &layouts.iter().copied().map(Some).collect::<Vec<_>>(),
        immediate_size: 0,
    });
    entry_points.map(|entry_point| {
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry_point),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    })
}

/// A uniform buffer, seen by both stages that draw.
#[must_use]
pub const fn uniform_entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    buffer_entry(binding, wgpu::ShaderStages::VERTEX_FRAGMENT, wgpu::BufferBindingType::Uniform)
}

/// A storage buffer.
#[must_use]
pub const fn storage_entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    read_only: bool,
) -> wgpu::BindGroupLayoutEntry {
    buffer_entry(binding, visibility, wgpu::BufferBindingType::Storage { read_only })
}

const fn buffer_entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    ty: wgpu::BufferBindingType,
) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}
