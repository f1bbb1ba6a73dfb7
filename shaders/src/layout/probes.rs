//! Inputs and outputs of the probe passes, which tests and measurements run.

use bytemuck::{Pod, Zeroable};

/// One ray for `probe_waves`; that file documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct WaveProbe {
    /// Where the ray meets the mean plane, pattern metres.
    pub place_m: [f32; 2],
    /// Size of a pixel there, metres.
    pub footprint_m: f32,
    /// Scales the waves.
    pub strength: f32,
    /// Unit vector to the eye; y positive.
    pub to_eye: [f32; 3],
    /// Eye above the plane, metres.
    pub eye_m: f32,
    /// A tier's word, or one of [`PROBE_STEPPED`], [`PROBE_MARCHED`], [`PROBE_FIXED`].
    pub method: u32,
    /// Steps of the first two.
    pub steps: u32,
    /// Least cosine of [`PROBE_STEPPED`].
    pub floor_cosine: f32,
    /// Unused.
    pub reserved: u32,
}

/// Iterative parallax with steps and least cosine of the probe.
pub const PROBE_STEPPED: u32 = 6;

/// Marched with as many steps as the probe says.
pub const PROBE_MARCHED: u32 = 7;

/// The plain parallax of a fixed view.
pub const PROBE_FIXED: u32 = 8;

/// One ray for `probe_pom`; that file documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PomProbe {
    /// Where it meets the plane, tiles.
    pub uv: [f32; 2],
    /// Height of the relief, tiles.
    pub amplitude: f32,
    /// Mip level of the map.
    pub lod: u32,
    /// Unit vector to the eye: along u, along v, along the normal.
    pub to_eye: [f32; 3],
    /// Layer of the map.
    pub layer: u32,
    /// Unit vector to the sun in the same frame.
    pub to_sun: [f32; 3],
    /// Unused.
    pub reserved: u32,
}

/// The result of `probe_pom`; that file documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PomResult {
    /// Where the ray meets the relief, tiles.
    pub uv: [f32; 2],
    /// Height there on the ray, 0 to 1.
    pub height: f32,
    /// Height of the surface there minus that.
    pub residual: f32,
    /// Share of the sun that is seen from there.
    pub sun: f32,
    /// Heights and bounds looked up to find it.
    pub fetches: u32,
    /// Unused.
    pub reserved: [u32; 2],
}

/// Words per probe that `probe_heights` writes: `mod_trunc(x, z)`, `mod_floor(x, z)`, the sum of
/// the fine octaves, the height, the height with [`PROBE_COARSE_OCTAVES`].
pub const PROBE_WORDS: usize = 5;

/// Octaves of the coarse height of `probe_heights`: so few that the base field is evaluated at the
/// probe itself instead of splined, and one fine octave more than none.
pub const PROBE_COARSE_OCTAVES: usize = 5;

/// Uniforms of `probe_tiling`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TilingProbe {
    /// Multiples of the anchors of materials, 256 m, in [0, [`super::PATTERN_PERIOD_M`]).
    pub anchor_m: [f32; 2],
    /// Number of the set.
    pub material: u32,
    /// `TILING_*` of `shared/frame.wesl`.
    pub tiling: u32,
    /// Texels of the field, across.
    pub width: u32,
    /// Texels of the field, down.
    pub height: u32,
    /// Texels of a tile.
    pub size: u32,
    /// Period of the reference, tiles; a power of two.
    pub period: u32,
}

/// Invocations of a workgroup of both entries of `probe_tiling`, in x.
pub const TILING_WORKGROUP: u32 = 64;

/// One question to `probe_brdf`; its vectors are unit ones, away from the surface.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BrdfProbe {
    /// Of the surface.
    pub normal: [f32; 3],
    /// Perceptual roughness, 0 to 1.
    pub roughness: f32,
    /// To the eye.
    pub to_eye: [f32; 3],
    /// Reflectance at normal incidence.
    pub f0: f32,
    /// To the light.
    pub to_light: [f32; 3],
    /// Unused; keeps the stride of the shader.
    pub gap: f32,
}

/// Words per probe that `probe_brdf` writes: distribution, the naive one, exact and fast
/// visibility, Fresnel term, diffuse term, specular albedo, cosine to the light.
pub const BRDF_TERMS: usize = 8;
