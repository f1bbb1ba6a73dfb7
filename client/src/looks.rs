//! Knobs that trade accuracy for speed in a picture, and views that show its machinery instead. Each one is an option of the
//! viewer, a control of the panel and a word in the uniforms; their numbers are those of `shared/frame.wesl`.

use clap::ValueEnum;

/// Everything about a picture that is neither the camera nor the land.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Looks {
    /// Diffuse reflection.
    pub diffuse: Diffuse,
    /// Visibility term of the specular reflection.
    pub visibility: Visibility,
    /// What hides that materials repeat.
    pub tiling: Tiling,
    /// How the waves' parallax is found.
    pub water: WaterTier,
    /// Whether the land shadows itself.
    pub shadows: Shadows,
    /// What is shown.
    pub show: Show,
    /// Where the sun stands, if not where the scene puts it.
    pub sun: Option<SunPlace>,
    /// Stops of exposure above the scene's own; -8 to 8.
    pub exposure_ev: f32,
}

/// Direction of the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunPlace {
    /// Degrees clockwise from north.
    pub azimuth_deg: f32,
    /// Degrees above the horizon, -90 to 90.
    pub elevation_deg: f32,
}

/// Diffuse reflection of rough surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Diffuse {
    /// The same in every direction.
    Lambert,
    /// Brighter towards the light at grazing angles (Burley, "Physically-Based Shading at Disney", 2012).
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

/// How the parallax of waves is found, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum WaterTier {
    /// A flat surface with sloped light.
    Flat,
    /// One offset by the height at the flat surface.
    Offset,
    /// Two steps with a slope factor.
    Two,
    /// Three steps.
    #[default]
    Three,
    /// Four steps.
    Four,
    /// Marched until the ray meets the waves: the truth.
    March,
}

/// How the land shadows itself from the sun.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Shadows {
    /// Not at all.
    Off,
    /// With an edge: the sun is a point.
    Hard,
    /// With a penumbra: the sun is a disc.
    #[default]
    Soft,
}

/// What is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Show {
    /// The picture.
    #[default]
    Picture,
    /// The edges of all triangles.
    Wireframe,
    /// A colour for each level, faded towards the next one as the land morphs.
    Levels,
    /// Normals as colours.
    Normals,
    /// How far the drawn land may be from the true one on screen: green for nothing, red for the tolerance, white beyond.
    Error,
}

impl Diffuse {
    /// Its number in the shaders.
    #[must_use]
    pub fn word(self) -> u32 {
        self as u32
    }
}

impl Visibility {
    /// Its number in the shaders.
    #[must_use]
    pub fn word(self) -> u32 {
        self as u32
    }
}

impl Tiling {
    /// Its number in the shaders.
    #[must_use]
    pub fn word(self) -> u32 {
        self as u32
    }
}

impl WaterTier {
    /// Its number in the shaders.
    #[must_use]
    pub fn word(self) -> u32 {
        self as u32
    }
}

impl Shadows {
    /// Its number in the shaders.
    #[must_use]
    pub fn word(self) -> u32 {
        self as u32
    }
}

impl Show {
    /// Its number in the shaders.
    #[must_use]
    pub fn word(self) -> u32 {
        self as u32
    }
}
