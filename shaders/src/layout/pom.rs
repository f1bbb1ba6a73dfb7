//! Parallax occlusion mapping: parameters, maximum mipmaps, relaxed cones, scene objects.

use bytemuck::{Pod, Zeroable};

/// Parameters of parallax occlusion mapping; `shared/pom.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PomParams {
    /// 0 flat, 1 one offset, 2 linear search, 3 relaxed cones, 4 max pyramid, 5 by travel.
    pub tier: u32,
    /// Steps of the linear search looking straight down, 1 to 256.
    pub steps_min: u32,
    /// The same along the plane.
    pub steps_max: u32,
    /// 0 none, 1 segment, 2 secant, 3 bisection.
    pub refine: u32,
    /// Rounds of the last two.
    pub refinements: u32,
    /// 0 leaves the loop at the crossing, 1 runs to its end.
    pub loop_form: u32,
    /// 0 by the sampler, 1 by f32.
    pub heights: u32,
    /// Of the relief on itself: 0 none, 1 hard, 2 soft.
    pub shadow: u32,
    /// 0 none, 1 rectangle, 2 curved edge, 3 shell.
    pub silhouette: u32,
    /// 1: depth of the relief, 0: of the plane.
    pub depth: u32,
    /// Height that lies on the plane, 0 to 1.
    pub pivot: f32,
    /// Multiplies the relief of every material.
    pub amplitude: f32,
    /// Of a curved edge: strength, height bias, safe threshold, falloff power.
    pub horizon: [f32; 4],
    /// Texels of travel up to which nothing is displaced.
    pub travel_flat: f32,
    /// Up to which one offset is taken.
    pub travel_offset: f32,
    /// Up to which the search is linear.
    pub travel_linear: f32,
    /// Height of a relief on screen at which its amplitude begins to fade, pixels; 0 for never.
    pub fade_px: f32,
}

/// One pass over the bounds of a height map; `reduce_max_mip.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MaxMipReduction {
    /// Texels a side of the map.
    pub side: u32,
    /// Mip level of the map.
    pub lod: u32,
    /// Level of bounds.
    pub level: u32,
    /// Unused.
    pub reserved: u32,
}

/// Threads of a workgroup of `reduce_max_mip` along either side.
pub const MAX_MIP_WORKGROUP: u32 = 8;

/// One dispatch of the baking of cones; `bake_cones.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ConeOrder {
    /// Texels a side of the map.
    pub side: u32,
    /// Mip level.
    pub lod: u32,
    /// Layer of the map.
    pub layer: u32,
    /// Texels a side of the block that a cone holds for.
    pub block: u32,
    /// First cone, row by row.
    pub first: u32,
    /// Cones.
    pub count: u32,
    /// Unused.
    pub reserved: [u32; 2],
    /// Directions in which cones are measured, 1/4096 texels along u and v.
    pub directions: [[i32; 2]; 32],
}

/// Threads of a workgroup of `bake_cones`.
pub const CONE_WORKGROUP: u32 = 64;

/// An object of the parallax scenes; `shared/pom_object.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PomObject {
    /// Middle, camera-relative metres.
    pub origin_m: [f32; 3],
    /// 0 by the settings, 1 flat, 2 one offset, 3 displaced geometry, 4 plain.
    pub mode: u32,
    /// The object's first axis in those of the world.
    pub tangent: [f32; 3],
    /// As [`PomParams::silhouette`], where that says none.
    pub silhouette: u32,
    /// The second axis.
    pub bitangent: [f32; 3],
    /// 0 plane, 1 capsule, 2 cube.
    pub shape: u32,
    /// The third axis.
    pub normal: [f32; 3],
    /// Material set.
    pub layer: u32,
    /// Width and height; radius and half length; half side twice. Metres.
    pub size_m: [f32; 2],
    /// Metres that a tile covers along u and v.
    pub tile_m: [f32; 2],
    /// Colour of a plain object, linear.
    pub tint: [f32; 3],
    /// Metres from height 0 to height 1.
    pub relief_m: f32,
    /// Tiles around a capsule, else over those of the mesh; over those of the mesh along v.
    pub repeats: [f32; 2],
    /// Unused.
    pub reserved: [f32; 2],
}
