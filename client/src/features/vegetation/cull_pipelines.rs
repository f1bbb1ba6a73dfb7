//! Pipelines of the culling passes, one set for each method and species: see
//! `bound/cull_method.wesl`. Built on first use.

use crate::gpu::pipeline::compute_pipelines_with;
use shaders::SHADERS;
use shaders::layout::{Culling, Planting};

/// The pipelines of one method.
#[derive(Debug)]
pub struct MethodPipelines {
    method: Method,
    /// Tests blocks.
    pub blocks: wgpu::ComputePipeline,
    /// Tests the clumps of visible blocks.
    pub test: wgpu::ComputePipeline,
    /// Compacts the visible clumps.
    pub write: wgpu::ComputePipeline,
}

/// Inputs of the constants of the pipelines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Method {
    kind: u32,
    path: u32,
    occludes: bool,
}

/// The pipelines of all methods that have been used: at most 24.
#[derive(Debug, Default)]
pub struct CullPipelines {
    sets: Vec<MethodPipelines>,
}

impl Method {
    fn of(culling: &Culling, planting: &Planting) -> Self {
        Self { kind: planting.kind, path: culling.path, occludes: culling.occlusion_enabled != 0 }
    }
}

impl CullPipelines {
    /// The pipelines of a method.
    pub fn of(
        &mut self,
        device: &wgpu::Device,
        (culling, planting): (&Culling, &Planting),
        block_layouts: &[&wgpu::BindGroupLayout],
        clump_layouts: &[&wgpu::BindGroupLayout],
    ) -> &MethodPipelines {
        let method = Method::of(culling, planting);
        let known = self.sets.iter().position(|set| set.method == method);
        let index = known.unwrap_or_else(|| {
            self.sets.push(MethodPipelines::new(device, method, block_layouts, clump_layouts));
            self.sets.len() - 1
        });
        &self.sets[index]
    }
}

impl MethodPipelines {
    fn new(
        device: &wgpu::Device,
        method: Method,
        block_layouts: &[&wgpu::BindGroupLayout],
        clump_layouts: &[&wgpu::BindGroupLayout],
    ) -> Self {
        let constants = [
            ("KIND", f64::from(method.kind)),
            ("METHOD", f64::from(method.path)),
            ("OCCLUDES", f64::from(u8::from(method.occludes))),
        ];
        let [blocks] =
            compute_pipelines_with(device, &SHADERS.cull_blocks, block_layouts, ["cull_blocks"], &constants);
        let [test, write] = compute_pipelines_with(
            device,
            &SHADERS.cull_clumps,
            clump_layouts,
            ["test_clumps", "write_clumps"],
            &constants,
        );
        Self { method, blocks, test, write }
    }
}
