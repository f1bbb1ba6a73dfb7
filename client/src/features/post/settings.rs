//! Settings of the passes after the HDR pass. Each one is an option of the viewer and a control of
//! the panel; the numbers are those of `shared/post.wesl`.

use clap::ValueEnum;

/// Largest rendered side, pixels: the texture limit of portable WebGPU.
const MAX_SIDE: u32 = 8192;

/// How the HDR target becomes an image. The default is the tone curve alone: measurements see no
/// other pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PostSettings {
    /// Tone curve.
    pub tone: Tone,
    /// Whether the exposure follows the metered light, at most 1.5 EV either way.
    pub auto_exposure: bool,
    /// Share of the light that spreads over its surroundings, 0 to 1; 0 is off.
    pub bloom: f32,
    /// Antialiasing of the image.
    pub antialias: Antialias,
    /// Sharpening, 0 to 1; 0 is off.
    pub sharpen: f32,
    /// Rendered size over the image's, 0.25 to 2.
    pub render_scale: f32,
}

impl Default for PostSettings {
    fn default() -> Self {
        Self {
            tone: Tone::default(),
            auto_exposure: false,
            bloom: 0.0,
            antialias: Antialias::None,
            sharpen: 0.0,
            render_scale: 1.0,
        }
    }
}

impl PostSettings {
    /// Smallest render scale.
    pub const MIN_SCALE: f32 = 0.25;
    /// Largest render scale.
    pub const MAX_SCALE: f32 = 2.0;
    /// Bloom of the viewer where there is a sky.
    pub const STANDARD_BLOOM: f32 = 0.03;

    /// The settings clamped to their ranges; NaN becomes the default.
    #[must_use]
    pub fn sanitized(self) -> Self {
        let standard = Self::default();
        let within = |value: f32, low: f32, high: f32, standard: f32| {
            if value.is_nan() { standard } else { value.clamp(low, high) }
        };
        Self {
            bloom: within(self.bloom, 0.0, 1.0, standard.bloom),
            sharpen: within(self.sharpen, 0.0, 1.0, standard.sharpen),
            render_scale: within(self.render_scale, Self::MIN_SCALE, Self::MAX_SCALE, standard.render_scale),
            ..self
        }
    }

    /// The rendered size of an image of `size` pixels, each side 1 to 8192. Larger images are
    /// rendered at a smaller scale, so that their shape stays.
    #[must_use]
    pub fn rendered_size(&self, size: (u32, u32)) -> (u32, u32) {
        let scale = f64::from(self.sanitized().render_scale);
        let longest = f64::from(size.0.max(size.1).max(1));
        // An image beyond the limit is not made smaller than asked for.
        let scale = scale.min((f64::from(MAX_SIDE) / longest).max(1.0));
        let side = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
        (side(size.0), side(size.1))
    }
}

/// Tone curve: linear light to the screen's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Tone {
    /// High contrast, dark shadows (Narkowicz, "ACES Filmic Tone Mapping Curve", 2015).
    Filmic,
    /// Keeps the base colours of materials, darkest shadows (Khronos PBR Neutral, 2024).
    Neutral,
    /// Keeps shadows, bleaches bright colours with their hue (Sobotka, 2023).
    #[default]
    #[value(name = "agx")]
    AgX,
}

/// Antialiasing of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Antialias {
    /// None: as many samples a pixel as the target has.
    #[default]
    None,
    /// Smooths edges of the finished image (Lottes, "FXAA 3.11", 2011).
    Fxaa,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn post_settings_are_clamped_and_nan_is_the_default() {
        let settings = |value| {
            PostSettings { bloom: value, sharpen: value, render_scale: value, ..PostSettings::default() }
                .sanitized()
        };
        assert_eq!(settings(f32::NAN), PostSettings::default());
        let most = settings(f32::INFINITY);
        assert_eq!((most.bloom, most.sharpen, most.render_scale), (1.0, 1.0, 2.0));
        let least = settings(-1e30);
        assert_eq!((least.bloom, least.sharpen, least.render_scale), (0.0, 0.0, 0.25));
        assert_eq!(PostSettings::default().sanitized(), PostSettings::default());
    }

    #[test]
    fn the_rendered_size_keeps_shape_and_limits() {
        let at =
            |render_scale, size| PostSettings { render_scale, ..PostSettings::default() }.rendered_size(size);
        assert_eq!(at(1.0, (641, 361)), (641, 361));
        assert_eq!(at(0.5, (640, 360)), (320, 180));
        assert_eq!(at(0.25, (1, 1)), (1, 1));
        assert_eq!(at(2.0, (640, 360)), (1280, 720));
        assert_eq!(at(2.0, (8192, 4096)), (8192, 4096));
        assert_eq!(at(2.0, (6144, 3072)), (8192, 4096));
        assert_eq!(at(9.0, (100, 100)), at(2.0, (100, 100)));
        assert_eq!(at(f32::NAN, (100, 100)), (100, 100));
    }
}
