//! The shaders: WGSL passes linked and validated at build time, and the Rust side of their data.
//!
//! `wgsl/shared/` holds modules without bindings, `wgsl/bound/` those over buffers that several
//! passes read, `wgsl/<verb_noun>.wesl` one pass each. `build.rs` links a pass with the modules it
//! imports (WESL), validates the result with naga as portable WebGPU and puts it into [`SHADERS`].
//!
//! Excluded from this crate: a GPU API (nothing here depends on wgpu), reading files at run time,
//! and native-only shader features.
//!
//! Reading order: [`SHADERS`], [`layout`] (uniforms and instances, as bytes), [`twin`] (integer
//! modules in Rust).

#![forbid(unsafe_code)]

pub mod layout;
pub mod twin;
#[cfg(test)]
mod validate;

/// One linked pass.
#[derive(Clone, Copy, Debug)]
pub struct Shader {
    /// Stem of its file, also the label of its pipeline.
    pub name: &'static str,
    /// Self-contained WGSL.
    pub wgsl: &'static str,
    /// Its entry points.
    pub entry_points: &'static [EntryPoint],
}

/// An entry point of a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EntryPoint {
    /// Name of the function.
    pub name: &'static str,
    /// The stage it runs in.
    pub stage: Stage,
}

/// A pipeline stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Once per vertex.
    Vertex,
    /// Once per covered pixel.
    Fragment,
    /// Once per invocation of a grid.
    Compute,
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));

#[cfg(test)]
mod limits;
#[cfg(test)]
mod tests;
