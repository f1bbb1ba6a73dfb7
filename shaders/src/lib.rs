//! The shaders: linked and validated WGSL passes, and the Rust side of their data.
//!
//! `wgsl/shared/` holds modules without bindings, `wgsl/bound/` those over buffers that several
//! passes read, `wgsl/<verb_noun>.wesl` one pass each. `linked/` holds each pass linked with the
//! modules it imports (WESL), and [`SHADERS`] is made of those files. A test links the passes,
//! validates them with naga as portable WebGPU and compares them with `linked/`; after a change
//! `cargo xtask bless shaders --write` writes them.
//!
//! Excluded from this crate: a GPU API (nothing here depends on wgpu), reading files at run time,
//! and native-only shader features.
//!
//! Reading order: [`SHADERS`], [`layout`] (uniforms and instances, as bytes), [`twin`] (integer
//! modules in Rust).

#![forbid(unsafe_code)]

pub mod layout;
#[rustfmt::skip]
mod passes;
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

pub use passes::{SHADERS, Shaders};

#[cfg(test)]
mod limits;
#[cfg(test)]
mod linker;
#[cfg(test)]
mod tests;
