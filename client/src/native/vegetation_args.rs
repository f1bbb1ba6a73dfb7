//! Options of vegetation.

use crate::features::vegetation::{Cull, PlantShadows, VegetationSettings};
use crate::native::parse::parse_within;
use clap::Args;

const MOST_GRASS: i64 = VegetationSettings::MAX_DENSITY as i64;
const MOST_TREES: i64 = VegetationSettings::MAX_TREES as i64;
const FARTHEST_M: f64 = VegetationSettings::MAX_RANGE_M as f64;
const FARTHEST_TREE_M: f64 = VegetationSettings::MAX_TREE_RANGE_M as f64;

/// The options; each is a field of [`VegetationSettings`]. The scene provides the defaults.
#[derive(Clone, Debug, PartialEq, Args)]
#[command(next_help_heading = "Vegetation")]
pub struct VegetationArgs {
    /// Clumps of grass on 2 x 2 m at the highest density, 0 to 32 [default: 24 in the scene island,
    /// 32 there with --quality high and in grass, 8 in culling; 8 at most with --quality low]
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(0..=MOST_GRASS))]
    pub grass: Option<u32>,

    /// Range of grass, metres, 0 to 1900 [default: 260; 240 in culling; 80 at most with --quality
    /// low, 400 in the scene island with high]
    #[arg(long, value_name = "M", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, FARTHEST_M))]
    pub grass_range: Option<f64>,

    /// Range of full density, metres, 1 to 1900; beyond, fewer and wider clumps [default: 42; 80 in
    /// culling]
    #[arg(long, value_name = "M", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 1.0, FARTHEST_M))]
    pub grass_thin_from: Option<f64>,

    /// Largest widening factor of far clumps, 1 to 16 [default: 6; 4 in culling]
    #[arg(long, value_name = "F", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 1.0, 16.0))]
    pub grass_widest: Option<f64>,

    /// Trees on 8 x 8 m at the highest density, 0 to 4 [default: 2 in the scene island, 1 in grass
    /// and culling; with --quality low 1, in the island with high 3]
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(0..=MOST_TREES))]
    pub trees: Option<u32>,

    /// Range of trees, metres, 0 to 8000 [default: 8000 in the scene island, 1500 in grass and
    /// culling; with --quality low 1500]
    #[arg(long, value_name = "M", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, FARTHEST_TREE_M))]
    pub tree_range: Option<f64>,

    /// Visibility test of plants [default: hierarchical; in the scene island with --quality low
    /// frustum]
    #[arg(long, value_enum)]
    pub cull: Option<Cull>,

    /// Frames for which a block of plants stays visible after its last visible frame, 0 to 60;
    /// exact tests need none
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(0..=60))]
    pub cull_stay: u32,

    /// Ray step of --cull noise and march, metres, 0.25 to 16
    #[arg(long, value_name = "M", default_value_t = 2.0, allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.25, 16.0))]
    pub cull_step: f64,

    /// Wind, 0 to 1 [default: 0.4]
    #[arg(long, value_name = "W", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub wind: Option<f64>,

    /// How far grass leans away from an eye above it, 0 to 1 [default: 0.6]
    #[arg(long, value_name = "L", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub lean: Option<f64>,

    /// Shadows of trees on the ground, on grass and on each other; none with --shadows off
    #[arg(long, value_enum, default_value_t)]
    pub plant_shadows: PlantShadows,

    /// Vertical scale of the land, 0.25 to 4 [default: 1.8 in the scene culling, else 1]
    #[arg(long, value_name = "F", allow_negative_numbers = true, help_heading = "Options",
          value_parser = |text: &str| parse_within(text, 0.25, 4.0))]
    pub vertical_scale: Option<f64>,
}

impl VegetationArgs {
    /// The settings: those of the options, `defaults` for the others.
    #[must_use]
    pub fn vegetation_settings(&self, defaults: VegetationSettings) -> VegetationSettings {
        let or = |given: Option<f64>, defaults: f32| given.map_or(defaults, |given| given as f32);
        // A range that is given is culled as without a preset.
        let culled = if self.tree_range.is_some() { VegetationSettings::STANDARD } else { defaults };
        VegetationSettings {
            density: self.grass.unwrap_or(defaults.density),
            range_m: or(self.grass_range, defaults.range_m),
            thin_from_m: or(self.grass_thin_from, defaults.thin_from_m),
            widest: or(self.grass_widest, defaults.widest),
            trees: self.trees.unwrap_or(defaults.trees),
            tree_range_m: or(self.tree_range, defaults.tree_range_m),
            single_trees_m: culled.single_trees_m,
            impostors_from_m: culled.impostors_from_m,
            cull: self.cull.unwrap_or(culled.cull),
            stay: self.cull_stay,
            step_m: self.cull_step as f32,
            wind: or(self.wind, defaults.wind),
            lean: or(self.lean, defaults.lean),
            shadows: self.plant_shadows,
        }
    }
}
