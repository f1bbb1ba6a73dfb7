//! Options of parallax occlusion mapping.

use crate::features::pom::PomSettings;
use crate::features::pom::settings::{Heights, Horizon, LoopForm, PomMethod, PomShadow, Refine, Silhouette};
use crate::native::parse::parse_within;
use crate::scene::Scene;
use clap::Args;
use clap::builder::RangedU64ValueParser;

const MOST_REFINEMENTS: u64 = PomSettings::MAX_REFINEMENTS as u64;

/// The options; each is a field of [`PomSettings`].
#[derive(Clone, Debug, PartialEq, Args)]
#[command(next_help_heading = "Parallax occlusion mapping")]
pub struct PomArgs {
    /// Parallax method of materials [default: auto; offset on land with --quality low]. Cones pass
    /// through single high texels: over spikes of one texel, 36 to 60 % of the pixels are wrong at
    /// view angles of 21 degrees and below. The other marches miss less
    #[arg(long, value_enum)]
    pub relief: Option<PomMethod>,

    /// Steps of the linear search at perpendicular and at grazing view, 1 to 256
    #[arg(long, value_name = "MIN,MAX", default_value = "8,32", value_parser = parse_steps)]
    pub relief_steps: (u32, u32),

    /// Refinement of the intersection
    #[arg(long, value_enum, default_value_t)]
    pub relief_refine: Refine,

    /// Iterations of secant or bisection, 0 to 16
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 3,
          value_parser = RangedU64ValueParser::<u32>::new().range(0..=MOST_REFINEMENTS))]
    pub relief_refinements: u32,

    /// Exit of the search loop
    #[arg(long, value_enum, default_value_t)]
    pub relief_loop: LoopForm,

    /// Height interpolation between texels
    #[arg(long, value_enum, default_value_t)]
    pub relief_heights: Heights,

    /// Self-shadowing of parallax [default: soft on land, hard in the scenes without]
    #[arg(long, value_enum)]
    pub relief_shadow: Option<PomShadow>,

    /// Silhouette of displaced surfaces; none: that of each object in the scene spom, none
    /// elsewhere
    #[arg(long, value_enum, default_value_t)]
    pub silhouette: Silhouette,

    /// Writes the depth of the displaced surface, so that objects intersect it correctly
    #[arg(long)]
    pub relief_depth: bool,

    /// Height that lies on the plane, 0 to 1
    #[arg(long, value_name = "H", allow_negative_numbers = true, default_value_t = 0.5,
          value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub relief_pivot: f64,

    /// Factor of all height ranges, 0 to 16
    #[arg(long, value_name = "A", allow_negative_numbers = true, default_value_t = 1.0,
          value_parser = |text: &str| parse_within(text, 0.0, 16.0))]
    pub relief_amplitude: f64,

    /// Material repeats on the objects of a parallax scene, relative to the scene's own, 0.25 to 8;
    /// F,F: along u and v. Heights in metres stay
    #[arg(long, value_name = "F[,F]", allow_negative_numbers = true, default_value = "1",
          value_parser = parse_tiling)]
    pub relief_tiling: Tiles,

    /// Height range on screen below which parallax fades out, pixels, 0 to 16; 0: never
    #[arg(long, value_name = "PX", allow_negative_numbers = true, default_value_t = 1.0,
          value_parser = |text: &str| parse_within(text, 0.0, 16.0))]
    pub relief_fade: f64,

    /// Parameters of the silhouette `horizon`: strength 0 to 4, height bias 0 to 1, safe threshold
    /// 0 to 0.95, falloff power 0.5 to 8
    #[arg(long, value_name = "S,B,T,F", default_value = "1,0,0.3,2", value_parser = parse_horizon)]
    pub horizon: Horizon,
}

impl PomArgs {
    /// The settings in a scene: those of the options, of `method` if that is not given.
    #[must_use]
    pub fn pom_settings(&self, method: PomMethod, scene: Scene) -> PomSettings {
        // A hard shadow of single texels ends in a line where the land's materials grow small.
        let shadow = if scene.is_local() { PomShadow::Hard } else { PomShadow::Soft };
        PomSettings {
            method: self.relief.unwrap_or(method),
            steps_min: self.relief_steps.0,
            steps_max: self.relief_steps.1,
            refine: self.relief_refine,
            refinements: self.relief_refinements,
            loop_form: self.relief_loop,
            heights: self.relief_heights,
            shadow: self.relief_shadow.unwrap_or(shadow),
            silhouette: self.silhouette,
            depth: self.relief_depth,
            pivot: self.relief_pivot as f32,
            amplitude: self.relief_amplitude as f32,
            tiling: self.relief_tiling.0,
            fade_px: self.relief_fade as f32,
            horizon: self.horizon,
        }
    }
}

fn parse_steps(text: &str) -> Result<(u32, u32), String> {
    text.split_once(',')
        .and_then(|(min, max)| Some((min.trim().parse::<u32>().ok()?, max.trim().parse::<u32>().ok()?)))
        .filter(|(min, max)| (1..=*max).contains(min) && *max <= PomSettings::MAX_STEPS)
        .ok_or_else(|| {
            format!("expected MIN,MAX with 1 <= MIN <= MAX <= {}, such as 8,32", PomSettings::MAX_STEPS)
        })
}

/// Repeats along u and v.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tiles(pub [f32; 2]);

fn parse_tiling(text: &str) -> Result<Tiles, String> {
    let (u, v) = text.split_once(',').unwrap_or((text, text));
    let within = |word: &str| {
        let (least, most) = (PomSettings::MIN_TILING.into(), PomSettings::MAX_TILING.into());
        parse_within(word.trim(), least, most).map(|value| value as f32)
    };
    Ok(Tiles([within(u)?, within(v)?]))
}

fn parse_horizon(text: &str) -> Result<Horizon, String> {
    let ranges = [
        ("strength", 0.0, 4.0),
        ("height bias", 0.0, 1.0),
        ("safe threshold", 0.0, 0.95),
        ("falloff power", 0.5, 8.0),
    ];
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    if words.len() != ranges.len() {
        return Err("expected four numbers: strength, height bias, safe threshold, falloff power".to_owned());
    }
    let mut values = [0.0f32; 4];
    for ((value, word), (name, low, high)) in values.iter_mut().zip(words).zip(ranges) {
        *value = parse_within(word, low, high).map_err(|error| format!("{name}: {error}"))? as f32;
    }
    let [strength, height_bias, safe_threshold, falloff] = values;
    Ok(Horizon { strength, height_bias, safe_threshold, falloff })
}
