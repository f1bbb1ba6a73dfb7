//! The uniforms of a frame.

use super::pom::PomParams;
use bytemuck::{Pod, Zeroable};

/// The uniforms of a frame; `shared/frame.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Frame {
    /// Camera-relative metres to clip space, column by column; infinite reversed-Z.
    pub clip_from_camera: [[f32; 4]; 4],
    /// Half the width of the image plane at distance 1, along the camera's right.
    pub ray_right: [f32; 3],
    /// Seconds; moves water, clouds and plants in the wind.
    pub time_s: f32,
    /// Half the height of the image plane at distance 1, along the camera's up.
    pub ray_up: [f32; 3],
    /// Eye above sea level, metres.
    pub eye_height_m: f32,
    /// Unit vector into the picture.
    pub ray_forward: [f32; 3],
    /// End of the land, metres.
    pub view_distance_m: f32,
    /// Unit vector to the sun.
    pub sun: [f32; 3],
    /// Multiplies the light before the tone curve; 1 is neutral.
    pub exposure: f32,
    /// The eye's position below one unit, metres (0 to 2^-8).
    pub eye_fraction_m: [f32; 3],
    /// 1 / height of the target in pixels.
    pub pixel: f32,
    /// Eye east and south, metres modulo [`PATTERN_PERIOD_M`].
    pub pattern_eye_m: [f32; 2],
    /// Target size, pixels.
    pub viewport: [f32; 2],
    /// 0 Lambert, 1 Burley.
    pub diffuse: u32,
    /// 0 exact, 1 fast.
    pub visibility: u32,
    /// 0 off, 1 two scales, 2 hexagons.
    pub tiling: u32,
    /// 0 flat, 1 one offset, 2 to 4 that many steps, 5 marched.
    pub water_tier: u32,
    /// 0 none, 1 hard, 2 soft.
    pub shadows: u32,
    /// 0 picture, 1 wireframe, 2 levels, 3 normals, 4 error, 5 chunks, 6 light.
    pub show: u32,
    /// Pixels per radian in the middle of the picture.
    pub pixels_per_radian: f32,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f32,
    /// Depth of the waves' parallax, 0 to 1; 0.2 is their true height.
    pub parallax_factor: f32,
    /// Raises the surface of the water, metres.
    pub parallax_bias_m: f32,
    /// Multiplies heights and slopes of the waves; 1 is a fresh breeze.
    pub wave_steepness: f32,
    /// Grass, two 16-bit fractions, the lower one first: its range, of [`GRASS_RANGE_M`]; its
    /// density where it is densest, of the highest.
    pub grass: u32,
    /// How reliefs are marched.
    pub pom: PomParams,
    /// Written on the GPU, by `integrate_sky`.
    pub atmosphere: Atmosphere,
}

/// Light of sun and sky in a frame; `shared/frame.wesl` documents each field. Three components and
/// a gap each.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Atmosphere {
    /// White ground that faces the sun.
    pub sun: [f32; 4],
    /// The same at the height of the clouds.
    pub sun_aloft: [f32; 4],
    /// Sunlight in the air, level towards the sun.
    pub toward: [f32; 4],
    /// Level away from it.
    pub away: [f32; 4],
    /// Upwards.
    pub upward: [f32; 4],
    /// Light scattered more than once.
    pub multiple_scattering: [f32; 4],
    /// The sky on a white surface, mean over all normals.
    pub sky_mean: [f32; 4],
    /// Its growth with the normal's axis east.
    pub sky_east: [f32; 4],
    /// Up.
    pub sky_up: [f32; 4],
    /// South.
    pub sky_south: [f32; 4],
}

/// Period of every pattern in the world, metres; a power of two. Equal to the constant of
/// `shared/frame.wesl`.
pub const PATTERN_PERIOD_M: i32 = 8192;

/// Unit of the range in [`Frame::grass`], metres. Equal to the constant of
/// `shared/undergrowth.wesl`.
pub const GRASS_RANGE_M: f32 = 4096.0;
