//! Settings of water. Each one is an option of the viewer, a control of the panel and a word of the
//! uniforms; the numbers are those of `shared/frame.wesl`.

use clap::ValueEnum;

/// Shape of the waves and depth of their parallax.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WaveSettings {
    /// Depth of the parallax, 0 to 1: 0 is flat water, 0.2 the true height of the waves.
    pub parallax_factor: f32,
    /// Offset of the surface, metres, -2 to 2; its image shifts with the slope of the view.
    pub parallax_bias_m: f32,
    /// Multiplies heights and slopes of the waves, 0 to 4; 1 is a fresh breeze.
    pub steepness: f32,
}

impl Default for WaveSettings {
    fn default() -> Self {
        Self { parallax_factor: 0.2, parallax_bias_m: 0.0, steepness: 1.0 }
    }
}

impl WaveSettings {
    /// Largest bias either way, metres.
    pub const MAX_BIAS_M: f32 = 2.0;
    /// Largest steepness.
    pub const MAX_STEEPNESS: f32 = 4.0;

    /// The settings clamped to their ranges; NaN becomes the default. The shaders rely on it.
    #[must_use]
    pub fn sanitized(self) -> Self {
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

/// Method of the waves' parallax, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum WaterTier {
    /// A flat surface with the slope of the waves in its lighting.
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
    /// Ray march to the intersection: the reference.
    March,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wave_settings_are_clamped_and_nan_is_the_default() {
        let settings = |value| {
            WaveSettings { parallax_factor: value, parallax_bias_m: value, steepness: value }.sanitized()
        };
        assert_eq!(settings(f32::NAN), WaveSettings::default());
        assert_eq!(
            settings(f32::INFINITY),
            WaveSettings { parallax_factor: 1.0, parallax_bias_m: 2.0, steepness: 4.0 }
        );
        assert_eq!(
            settings(-1e30),
            WaveSettings { parallax_factor: 0.0, parallax_bias_m: -2.0, steepness: 0.0 }
        );
        assert_eq!(WaveSettings::default().sanitized(), WaveSettings::default());
    }
}
