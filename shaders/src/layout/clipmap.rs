//! Parameters of the terrain clipmap.

use bytemuck::{Pod, Zeroable};

/// Most levels of the clipmap. Equal to the constant of `shared/terrain_clipmap.wesl`.
pub const CLIPMAP_LEVELS: usize = 10;

/// Parameters of the clipmap; `shared/terrain_clipmap.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Clipmap {
    /// By level: the eye east and south in sides of the level, 0 to 1; 1 / side, per metre; 1 if
    /// all tiles are filled, else 0.
    pub levels: [[f32; 4]; CLIPMAP_LEVELS],
    /// Levels.
    pub count: u32,
    /// Factor of the slopes.
    pub vertical_scale: f32,
    /// Distance along an axis up to which the finest level is filled, metres.
    pub reach_m: f32,
    /// Spacing of the finest level, metres.
    pub spacing_m: f32,
    /// Texels along a side of each level.
    pub texels: f32,
    /// Unused; fills 16 bytes.
    pub reserved: [f32; 3],
}

impl Clipmap {
    /// No level: the shaders use the slopes of the drawn chunks.
    pub const NONE: Self = Self {
        levels: [[0.0; 4]; CLIPMAP_LEVELS],
        count: 0,
        vertical_scale: 1.0,
        reach_m: 1.0,
        spacing_m: 1.0,
        texels: 1.0,
        reserved: [0.0; 3],
    };
}
