//! `tombolo-lab culling`: false culls, false keeps and cost of every occlusion test of vegetation.
//! `cargo xtask measure culling` compares the figures with their bars; here only a control that
//! passes is an error.

mod bars;
pub mod cases;
pub(crate) mod chunks;
pub mod clump_vertices;
pub(crate) mod clumps;
mod frame_ratios;
pub(crate) mod frames;
mod gpu_cpu_equality;
mod gpu_time;
pub(crate) mod id_buffer;
pub(crate) mod occlusion;
pub mod reference;
pub mod scene;

use crate::report::publish;
use crate::{Outputs, note};
use anyhow::{Result, ensure};
use client::features::vegetation::VegetationSettings;
use frame_ratios::FrameRatios;
use frames::Frames;
use gpu_cpu_equality::GpuCpuEquality;
use gpu_time::GpuTime;
use id_buffer::VisiblePlants;
use occlusion::Findings;
use serde::Serialize;
use terrain::Land;

/// Options of `culling`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Poses compared with visibility in f64, 1 to 100000
    #[arg(long, value_name = "N", default_value_t = 300,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub poses: u32,
    /// Poses whose visible plants are found in ID buffers drawn without culling, 0 to 100000
    #[arg(long, value_name = "N", default_value_t = 300,
          value_parser = clap::value_parser!(u32).range(0..=100_000))]
    pub drawn: u32,
    /// Poses at which the GPU's visible clumps are compared with those of the CPU twin, 0 to 1000
    #[arg(long, value_name = "N", default_value_t = 24,
          value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub compared: u32,
    /// Poses whose frames are timed with and without occlusion tests, 0 to 10000
    #[arg(long, value_name = "N", default_value_t = 300,
          value_parser = clap::value_parser!(u32).range(0..=10_000))]
    pub framed: u32,
    /// Rounds of timed frames of the valley scene, 0 to 100; 0 leaves out the million clumps, too
    #[arg(long, value_name = "N", default_value_t = frames::ROUNDS,
          value_parser = clap::value_parser!(u32).range(0..=100))]
    pub rounds: u32,
}

/// First of the poses that no test was tuned on.
const HELD_OUT: u32 = 1_000_000;

/// Fewer and nearer plants than the standard: the comparison must also finish on a software driver.
const COMPARED: VegetationSettings =
    VegetationSettings { density: 4, range_m: 160.0, tree_range_m: 800.0, ..VegetationSettings::STANDARD };

/// Fewer plants than the standard, for ID buffers on a software driver.
const DRAWN: VegetationSettings =
    VegetationSettings { density: 2, range_m: 200.0, tree_range_m: 1000.0, ..VegetationSettings::STANDARD };

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    /// Poses requested.
    poses: u32,
    #[serde(rename = "sight")]
    occlusion: Findings,
    /// The same at as many other poses, which no test was tuned on.
    held_out: Findings,
    /// Plants visible in ID buffers, if any were requested.
    #[serde(rename = "shown")]
    visible: Option<VisiblePlants>,
    /// Rounds of timed frames.
    rounds: u32,
    /// Cost of every culling method in frames of the valley scene, if any rounds were requested.
    frames: Option<Frames>,
    /// The same of T4 over many poses, if any were requested.
    frame_ratios: Option<FrameRatios>,
    /// Time of a million clumps, if any rounds were requested.
    gpu_time: Option<GpuTime>,
    /// The GPU against the twin, if requested.
    #[serde(rename = "same")]
    equality: Option<GpuCpuEquality>,
}

/// Measures everything, prints it, and checks that every control fails.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let land = Land::new(1);
    note("visibility over the drawn triangles");
    let poses = cases::seeded(&land, options.poses, VegetationSettings::STANDARD);
    let occlusion = occlusion::score(&land, &poses);
    note("the same at poses that no test was tuned on");
    let others = cases::seeded_from(&land, HELD_OUT, options.poses, VegetationSettings::STANDARD);
    let held_out = occlusion::score(&land, &others);
    note(&format!("{} poses, drawn without culling", options.drawn));
    let drawn = cases::seeded(&land, options.drawn, DRAWN);
    let visible = (options.drawn > 0).then(|| id_buffer::measure(&land, &drawn)).transpose()?;
    note("frames of the valley scene");
    let plants = client::scene::Scene::Culling.plants();
    let is_timed = options.rounds > 0;
    let frames = is_timed.then(|| frames::measure(&land, plants, options.rounds)).transpose()?;
    note(&format!("frames of {} poses", options.framed));
    let framed = cases::seeded(&land, options.framed, plants);
    let frame_ratios = (options.framed > 0).then(|| frame_ratios::measure(&land, &framed)).transpose()?;
    note("a million clumps at 1920 x 1080");
    let gpu_time = is_timed.then(|| gpu_time::measure(&land)).transpose()?;
    note("the GPU against the twin");
    let compared = cases::seeded(&land, options.compared, COMPARED);
    let equality = (options.compared > 0).then(|| gpu_cpu_equality::compare(&land, &compared)).transpose()?;
    let report = Report {
        poses: options.poses,
        occlusion,
        held_out,
        visible,
        rounds: options.rounds,
        frames,
        frame_ratios,
        gpu_time,
        equality,
    };
    publish(&report, bars::rows, bars::notes, "/same/adapter", outputs)?;
    report.controls()
}

impl Report {
    /// Fails if a control passes.
    fn controls(&self) -> Result<()> {
        for (test, name) in
            [("noise", "T2"), ("march", "T3 as first published"), ("five_points", "five points")]
        {
            let has_lost = self.occlusion.scores.get(test).is_some_and(|score| score.false_culls > 0);
            ensure!(has_lost, "{name} has no false cull: the reference detects nothing");
        }
        let visible = self.visible.iter();
        for (name, lost) in visible
            .flat_map(|visible| [("T2", visible.lost_noise), ("T3 as first published", visible.lost_march)])
        {
            ensure!(lost > 0, "{name} lost no plant of an ID buffer: the ID buffers detect nothing");
        }
        ensure!(
            self.equality.as_ref().is_none_or(|equality| equality.differing_control > 0),
            "a twin without occlusion tests keeps the same clumps: the comparison detects nothing"
        );
        Ok(())
    }
}
