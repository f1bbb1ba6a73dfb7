//! Options of the passes after the HDR pass.

use crate::features::post::{Antialias, PostSettings, Tone};
use crate::native::parse::parse_within;
use crate::native::quality::Preset;
use crate::scene::Scene;
use clap::{Args, ValueEnum};

const LEAST_SCALE: f64 = PostSettings::MIN_SCALE as f64;
const MOST_SCALE: f64 = PostSettings::MAX_SCALE as f64;

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// On.
    On,
    /// Off.
    Off,
}

/// The options; each is a field of [`PostSettings`].
#[derive(Clone, Debug, PartialEq, Args)]
#[command(next_help_heading = "Image")]
pub struct PostArgs {
    /// Tone curve
    #[arg(long, value_enum, default_value_t)]
    pub tone: Tone,

    /// Exposure that follows the picture's light, at most 1.5 EV either way: --exposure then is
    /// relative to it [default: on in the scenes with land]
    #[arg(long, value_name = "on|off", value_enum)]
    pub auto_exposure: Option<Switch>,

    /// Share of the light that spreads around bright places, 0 to 1; 0 is off [default: 0.03 in the
    /// scenes with land, else 0; 0 with --quality low]
    #[arg(long, value_name = "F", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub bloom: Option<f64>,

    /// Antialiasing of the image [default: fxaa with one sample per pixel]
    #[arg(long, value_enum)]
    pub antialias: Option<Antialias>,

    /// Sharpening, 0 to 1; 0 is off
    #[arg(long, value_name = "F", default_value_t = 0.0, allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub sharpen: f64,

    /// Rendered size over the size of the image or window, 0.25 to 2; level of detail follows the
    /// rendered size [default: 1; 0.5 with --quality low]
    #[arg(long, value_name = "F", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, LEAST_SCALE, MOST_SCALE))]
    pub render_scale: Option<f64>,
}

impl PostArgs {
    /// The settings in a scene, with so many samples per pixel and those of a preset for the
    /// others.
    #[must_use]
    pub fn post_settings(&self, scene: Scene, samples: u32, preset: &Preset) -> PostSettings {
        let has_land = !scene.is_local();
        let bloom = if has_land { preset.bloom } else { 0.0 };
        PostSettings {
            tone: self.tone,
            auto_exposure: self.auto_exposure.map_or(has_land, |switch| switch == Switch::On),
            bloom: self.bloom.map_or(bloom, |bloom| bloom as f32),
            antialias: self.antialias.unwrap_or(if samples == 1 { Antialias::Fxaa } else { Antialias::None }),
            sharpen: self.sharpen as f32,
            render_scale: self.render_scale.map_or(preset.render_scale, |scale| scale as f32),
        }
    }
}
