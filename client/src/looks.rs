//! Knobs that trade accuracy for speed in a picture, and views that show its machinery instead.
//! Each one is an option of the viewer, a control of the panel and a word in the uniforms; their
//! numbers are those of `shared/frame.wesl`.

use crate::plants::PlantKnobs;
use crate::relief::ReliefKnobs;
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
    /// Waves and their parallax.
    pub waves: WaveKnobs,
    /// Depth on planes.
    pub relief: ReliefKnobs,
    /// What grows.
    pub plants: PlantKnobs,
}

/// Shape of the waves and depth of their parallax.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WaveKnobs {
    /// Depth of the parallax, 0 to 1: 0 shows flat water, 0.2 displaces the waves by their true
    /// height, 1 by five times that.
    pub parallax_factor: f32,
    /// Raises the surface, metres, -2 to 2; what is seen of it shifts with the slope of the view.
    pub parallax_bias_m: f32,
    /// Multiplies heights and slopes of the waves, 0 to 4; 1 is a fresh breeze.
    pub steepness: f32,
}

impl Default for WaveKnobs {
    fn default() -> Self {
        Self { parallax_factor: 0.2, parallax_bias_m: 0.0, steepness: 1.0 }
    }
}

impl WaveKnobs {
    /// Largest bias either way, metres.
    pub const MAX_BIAS_M: f32 = 2.0;
    /// Largest steepness.
    pub const MAX_STEEPNESS: f32 = 4.0;

    /// The knobs within their ranges; what is no number becomes the default. The shaders rely on
    /// it.
    #[must_use]
    pub fn sane(self) -> Self {
        let standard = Self::default();
        let within = |value: f32, low: f32, high: f32, standard: f32| {
            if value.is_nan() { standard } else { value.clamp(low, high) }
        };
        Self {
            parallax_factor: within(self.parallax_factor, 0.0, 1.0, standard.parallax_factor),
            parallax_bias_m: within(self.parallax_bias_m, -Self::MAX_BIAS_M, Self::MAX_BIAS_M, 0.0),
            steepness: within(self.steepness, 0.0, Self::MAX_STEEPNESS, standard.steepness),
        }
    }
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
    /// How far the drawn land may be from the true one on screen: green for nothing, red for the
    /// tolerance, white beyond.
    Error,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wave_knobs_are_held_in_range_and_what_is_no_number_is_the_default() {
        let knobs =
            |value| WaveKnobs { parallax_factor: value, parallax_bias_m: value, steepness: value }.sane();
        assert_eq!(knobs(f32::NAN), WaveKnobs::default());
        assert_eq!(
            knobs(f32::INFINITY),
            WaveKnobs { parallax_factor: 1.0, parallax_bias_m: 2.0, steepness: 4.0 }
        );
        assert_eq!(knobs(-1e30), WaveKnobs { parallax_factor: 0.0, parallax_bias_m: -2.0, steepness: 0.0 });
        assert_eq!(WaveKnobs::default().sane(), WaveKnobs::default());
    }
}
