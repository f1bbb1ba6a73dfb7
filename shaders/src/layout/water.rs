//! Water: draw call and wave map.

/// Vertices of the `draw_water` call: eight sectors of a plane, and a triangle behind everything
/// for an eye under water.
pub const WATER_VERTICES: u32 = 27;

/// Texels along a side of the waves' distortion map. Equal to the constant of `shared/waves.wesl`.
pub const WAVE_MAP_SIDE: u32 = 256;

/// Invocations along each side of a workgroup of `bake_waves`.
pub const WAVE_WORKGROUP: u32 = 8;
