//! `tombolo-lab culling`: what is left out although it is seen, what is kept although it is hidden,
//! and what either costs. `cargo xtask measure culling` holds the figures against their bars; here
//! only a control that fails to fail is an error.

pub mod chunks;
pub mod frames;
pub mod leaves;
pub mod lots;
pub mod names;
pub mod oracle;
pub mod poses;
pub mod same;
pub mod scene;
pub mod sight;

use crate::{Outputs, note};
use anyhow::{Result, ensure};
use client::plants::PlantKnobs;
use frames::Frames;
use lots::Lots;
use names::Shown;
use same::Same;
use serde::Serialize;
use sight::Findings;
use terrain::Land;

/// Options of `culling`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Poses that are judged by sight in f64, 1 to 100000
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub poses: u32,
    /// Poses that are drawn without culling to see which plants show, 0 to 100000
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(0..=100_000))]
    pub drawn: u32,
    /// Poses at which the GPU's choice is compared with the twin's, 0 to 1000
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub compared: u32,
}

/// Fewer and nearer plants, for comparing the GPU with the twin: a software driver chooses them
/// too.
const COMPARED: PlantKnobs =
    PlantKnobs { density: 4, range_m: 160.0, tree_range_m: 800.0, ..PlantKnobs::STANDARD };

/// Fewer plants than the standard, for pictures on a software driver.
const DRAWN: PlantKnobs =
    PlantKnobs { density: 2, range_m: 200.0, tree_range_m: 1000.0, ..PlantKnobs::STANDARD };

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    /// Poses asked for.
    poses: u32,
    sight: Findings,
    /// Which plants show in pictures; none if none was asked for.
    shown: Option<Shown>,
    /// Cost of every way in frames of the valley scene.
    frames: Frames,
    lots: Lots,
    /// The GPU against the twin; none if it was not asked for.
    same: Option<Same>,
}

/// Measures everything, prints it, and checks that every control fails.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let land = Land::new(1);
    note("sight over the drawn triangles");
    let trials = poses::seeded(&land, options.poses, PlantKnobs::STANDARD);
    let sight = sight::judge(&land, &trials);
    println!("{}", serde_json::to_string_pretty(&sight)?);
    note(&format!("{} poses, drawn without culling", options.drawn));
    let drawn = poses::seeded(&land, options.drawn, DRAWN);
    let shown = (options.drawn > 0).then(|| names::look(&land, &drawn)).transpose()?;
    println!("{}", serde_json::to_string_pretty(&shown)?);
    note("frames of the valley scene");
    let frames = frames::measure(&land, client::scene::Scene::Culling.plants())?;
    println!("{}", serde_json::to_string_pretty(&frames)?);
    let lots = lots::lots(7);
    println!("{}", serde_json::to_string_pretty(&lots)?);
    note("the GPU against the twin");
    let compared = poses::seeded(&land, options.compared, COMPARED);
    let same = (options.compared > 0).then(|| same::compare(&land, &compared)).transpose()?;
    println!("{}", serde_json::to_string_pretty(&same)?);
    let report = Report { poses: options.poses, sight, shown, frames, lots, same };
    outputs.write_json(&report)?;
    report.controls()
}

impl Report {
    /// What must be wrong is.
    fn controls(&self) -> Result<()> {
        let sight = &self.sight;
        for (name, score) in [
            ("T2", &sight.noise),
            ("T3 as first published", &sight.march),
            ("five points", &sight.five_points),
        ] {
            ensure!(score.false_culls > 0, "{name} lost nothing that is seen: the oracle could not tell");
        }
        for (name, lost) in self
            .shown
            .iter()
            .flat_map(|shown| [("T2", shown.lost_noise), ("T3 as first published", shown.lost_march)])
        {
            ensure!(lost > 0, "{name} lost no plant that shows in a picture: the pictures could not tell");
        }
        ensure!(
            self.lots.poor_stream_p < 0.001 && self.lots.poor_pair_p < 0.001,
            "poor streams pass: the test could not tell"
        );
        ensure!(
            self.same.as_ref().is_none_or(|same| same.differing_control > 0),
            "a twin that does not ask the land keeps the same clumps: the comparison could not tell"
        );
        Ok(())
    }
}
