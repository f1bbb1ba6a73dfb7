//! Uniforms of the passes after the HDR pass.

use bytemuck::{Pod, Zeroable};

/// Settings of these passes; `shared/post.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Post {
    /// 0 filmic, 1 neutral, 2 `AgX`.
    pub tone: u32,
    /// 1 if the metered exposure applies.
    pub auto_exposure: u32,
    /// Share of the light that bloom spreads, 0 to 1.
    pub bloom: f32,
    /// Sharpening, 0 to 1.
    pub sharpen: f32,
    /// Factor of the metered light.
    pub meter: f32,
    /// Share of the way to the metered exposure in this frame.
    pub adaptation: f32,
    /// Rendered pixels over output pixels, along x and y.
    pub scale: [f32; 2],
}

/// Result of the metering, on the GPU only.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Exposure {
    /// Stops over the scene's exposure.
    pub ev: f32,
    /// Two to that power.
    pub factor: f32,
    /// 1 after the first frame.
    pub is_set: u32,
    /// Unused; fills 16 bytes.
    pub reserved: u32,
}

/// Workgroups of the metering, whose sums one workgroup adds.
pub const METER_GROUPS: u32 = 64;
