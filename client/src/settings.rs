//! Render settings: accuracy against speed, and debug views. Each one is an option of the viewer, a
//! control of the panel and a word of the uniforms; the numbers are those of `shared/frame.wesl`.

use crate::features::pom::PomSettings;
use crate::features::vegetation::VegetationSettings;
use crate::features::water::{WaterTier, WaveSettings};
use clap::ValueEnum;

/// All render settings: what a frame depends on apart from camera and chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderSettings {
    /// Diffuse reflection.
    pub diffuse: Diffuse,
    /// Visibility term of the specular reflection.
    pub visibility: Visibility,
    /// What hides that materials repeat.
    pub tiling: Tiling,
    /// Method of the waves' parallax.
    pub water: WaterTier,
    /// Shadows of the terrain on itself.
    pub shadows: Shadows,
    /// What is shown.
    pub show: Show,
    /// Position of the sun; that of the scene if none.
    pub sun: Option<SunPosition>,
    /// Exposure in stops relative to the scene's, -8 to 8.
    pub exposure_ev: f32,
    /// Waves and their parallax.
    pub waves: WaveSettings,
    /// Parallax occlusion mapping of materials.
    pub pom: PomSettings,
    /// Vegetation.
    pub plants: VegetationSettings,
}

/// Direction of the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunPosition {
    /// Degrees clockwise from north.
    pub azimuth_deg: f32,
    /// Degrees above the horizon, -90 to 90.
    pub elevation_deg: f32,
}

/// Diffuse reflection of rough surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Diffuse {
    /// Constant (Lambertian).
    Lambert,
    /// Brighter towards the light at grazing angles (Burley, "Physically-Based Shading at Disney",
    /// 2012).
    #[default]
    Burley,
}

/// Visibility term of GGX (Heitz, "Understanding the Masking-Shadowing Function", JCGT 3(2), 2014).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Visibility {
    /// Height-correlated Smith term, two square roots.
    #[default]
    Exact,
    /// Its approximation without square roots.
    Fast,
}

/// What hides that materials repeat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Tiling {
    /// Nothing: one sample.
    Off,
    /// The same texture at two scales: two samples.
    TwoScale,
    /// Hexagonal tiles, each turned and shifted: three samples (Mikkelsen, JCGT 11(3), 2022).
    #[default]
    Hex,
}

/// Shadows of the terrain on itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Shadows {
    /// No shadows.
    Off,
    /// Hard edge: the sun is a point.
    Hard,
    /// Penumbra: the sun is a disc.
    #[default]
    Soft,
}

/// What is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Show {
    /// The rendered image.
    #[default]
    #[value(name = "picture", alias = "image")]
    Image,
    /// The edges of all triangles.
    Wireframe,
    /// A colour for each level, blended towards the next one by the morph.
    Levels,
    /// Normals as colours.
    Normals,
    /// Bound of the geometric error on screen: green is 0, red the tolerance, white more.
    Error,
}
