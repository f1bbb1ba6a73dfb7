//! Options of plants and of what hides them.

use super::args::parse_within;
use crate::plants::{Cull, PlantKnobs};
use crate::scene::Scene;
use clap::Args;

const MOST_GRASS: i64 = PlantKnobs::MAX_DENSITY as i64;
const MOST_TREES: i64 = PlantKnobs::MAX_TREES as i64;
const FARTHEST_M: f64 = PlantKnobs::MAX_RANGE_M as f64;

/// The options; each is a field of [`PlantKnobs`]. What is not given is what the scene says.
#[derive(Clone, Debug, PartialEq, Args)]
#[command(next_help_heading = "Plants")]
pub struct PlantArgs {
    /// Clumps of grass on 2 x 2 m where it is densest, 0 to 32 [default: 32 in the scene grass, 8
    /// in culling, else 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(0..=MOST_GRASS))]
    pub grass: Option<u32>,

    /// How far grass stands, metres, 0 to 1900 [default: 260; 240 in culling]
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 0.0, FARTHEST_M))]
    pub grass_range: Option<f64>,

    /// How far all of it stands, metres, 1 to 1900; beyond, fewer clumps are wider [default: 42; 80
    /// in culling]
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 1.0, FARTHEST_M))]
    pub grass_thin_from: Option<f64>,

    /// Most that a far clump is widened, 1 to 16 [default: 6; 4 in culling]
    #[arg(long, value_name = "F", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 1.0, 16.0))]
    pub grass_widest: Option<f64>,

    /// Trees on 8 x 8 m where they are densest, 0 to 4 [default: 1 in the scenes grass and culling,
    /// else 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(0..=MOST_TREES))]
    pub trees: Option<u32>,

    /// How far trees stand, metres, 0 to 1900 [default: 1500]
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 0.0, FARTHEST_M))]
    pub tree_range: Option<f64>,

    /// How it is decided which plants are drawn
    #[arg(long, value_enum, default_value_t)]
    pub cull: Cull,

    /// Frames for which a block of plants stays after it was last seen, 0 to 60; the exact tests
    /// need none
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(0..=60))]
    pub cull_stay: u32,

    /// Step of the marches of --cull noise and march, metres, 0.25 to 16
    #[arg(long, value_name = "M", default_value_t = 2.0, allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 0.25, 16.0))]
    pub cull_step: f64,

    /// Wind, 0 to 1 [default: 0.4]
    #[arg(long, value_name = "W", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub wind: Option<f64>,

    /// How far grass leans away from an eye above it, 0 to 1 [default: 0.6]
    #[arg(long, value_name = "L", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub lean: Option<f64>,

    /// Stretches all heights of the land as it arrives, 0.25 to 4 [default: 1.8 in the scene
    /// culling, else 1]
    #[arg(long, value_name = "F", allow_negative_numbers = true, value_parser = |text: &str| parse_within(text, 0.25, 4.0))]
    pub vertical_scale: Option<f64>,
}

impl PlantArgs {
    /// The knobs in a scene.
    #[must_use]
    pub fn knobs(&self, scene: Scene) -> PlantKnobs {
        let own = scene.plants();
        let or = |given: Option<f64>, own: f32| given.map_or(own, |given| given as f32);
        PlantKnobs {
            density: self.grass.unwrap_or(own.density),
            range_m: or(self.grass_range, own.range_m),
            thin_from_m: or(self.grass_thin_from, own.thin_from_m),
            widest: or(self.grass_widest, own.widest),
            trees: self.trees.unwrap_or(own.trees),
            tree_range_m: or(self.tree_range, own.tree_range_m),
            cull: self.cull,
            stay: self.cull_stay,
            step_m: self.cull_step as f32,
            wind: or(self.wind, own.wind),
            lean: or(self.lean, own.lean),
        }
    }
}
