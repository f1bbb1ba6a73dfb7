//! `tombolo-lab pom`: parallax occlusion mapping against its truth. `cargo xtask measure pom` holds
//! the figures against their bars; here only a control that fails to fail is an error.

pub mod pictures;

use crate::accuracy::octaves::ratios;
use crate::relief::bench::ReliefBench;
use crate::relief::maps::Kind;
use crate::relief::trial::{AMPLITUDE, ANGLES_DEG, Condition, Score, Stage, bundle, probes, relief};
use crate::{Outputs, note};
use anyhow::{Result, ensure};
use client::relief::knobs::{LoopForm, Refine, ReliefTier};
use pictures::Pictures;
use serde::Serialize;
use shaders::layout::Relief;

/// Rounds of the timing, and rays of each condition in it.
const ROUNDS: usize = 9;
const TIMED_SIDE: u32 = 256;
const TIMED_RAYS: u32 = 1 << 15;
const REPEATS: u32 = 2;

/// Options of `pom`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Rays of each map and angle, 1000 to 10000000
    #[arg(long, value_name = "N", default_value_t = 200_000, value_parser = clap::value_parser!(u32).range(1_000..=10_000_000))]
    pub rays: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    adapter: String,
    /// Whether the driver has no GPU: its times say nothing about one.
    is_software: bool,
    /// Rays of each map and angle.
    rays: u32,
    search: Vec<Search>,
    loops: Loops,
    pictures: Pictures,
    cost: Vec<Cost>,
}

/// One map under one angle.
#[derive(Clone, Debug, Serialize)]
struct Search {
    map: &'static str,
    angle_deg: f32,
    pyramid: Score,
    auto: Score,
    /// 64 steps and a secant: the control.
    linear: Score,
}

/// Words of places that differ between the loop forms.
#[derive(Clone, Copy, Debug, Serialize)]
struct Loops {
    compared: usize,
    differing: usize,
    /// Between two ways of refinement: the control.
    differing_control: usize,
}

/// Time over that of 64 steps without an early exit and a secant.
#[derive(Clone, Copy, Debug, Serialize)]
struct Cost {
    map: &'static str,
    angle_deg: f32,
    auto: f64,
    pyramid: f64,
    /// 64 steps with an early exit.
    early_exit: f64,
}

/// The constant search that others are compared with.
fn constant(form: LoopForm) -> Relief {
    Relief { steps_min: 64, steps_max: 64, loop_form: form as u32, ..relief(ReliefTier::Linear) }
}

/// Measures everything, prints it, and checks that every control fails.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let bench = ReliefBench::open()?;
    let stage = Stage::new(&bench, false);
    note("places against the truth");
    let search = searches(&bench, &stage, options.rays)?;
    note("loop forms");
    let loops = loops(&bench, &stage)?;
    println!(
        "loops: {} of {} words differ; control {}",
        loops.differing, loops.compared, loops.differing_control
    );
    note("pictures");
    let pictures = pictures::measure()?;
    note("cost");
    let cost = costs(&bench, &stage)?;
    let report = Report {
        adapter: bench.adapter(),
        is_software: bench.is_software(),
        rays: options.rays,
        search,
        loops,
        pictures,
        cost,
    };
    outputs.write_json(&report)?;
    report.controls()
}

fn searches(bench: &ReliefBench, stage: &Stage, rays: u32) -> Result<Vec<Search>> {
    let mut rows = Vec::new();
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for angle_deg in ANGLES_DEG {
            let condition = Condition::new(stage, layer, angle_deg, rays);
            let score = |how: &Relief| condition.score(bench, stage, how);
            let row = Search {
                map: kind.name(),
                angle_deg,
                pyramid: score(&relief(ReliefTier::Pyramid))?,
                auto: score(&relief(ReliefTier::Auto))?,
                linear: score(&constant(LoopForm::Exit))?,
            };
            let told = |name: &str, score: &Score| {
                format!(
                    "{name} {:.4} % off ({:.4} % no tangents), residual {:.1e}, {:.1} fetches",
                    100.0 * score.wrong,
                    100.0 * score.wrong_without_excuse,
                    score.residual,
                    score.fetches
                )
            };
            println!(
                "{:<6} {angle_deg:>2} degrees: {}; {}; {}",
                row.map,
                told("pyramid", &row.pyramid),
                told("auto", &row.auto),
                told("64 + secant", &row.linear)
            );
            rows.push(row);
        }
    }
    Ok(rows)
}

fn loops(bench: &ReliefBench, stage: &Stage) -> Result<Loops> {
    let mut loops = Loops { compared: 0, differing: 0, differing_control: 0 };
    for layer in 0..Kind::ALL.len() {
        for angle_deg in ANGLES_DEG {
            let probes = probes(layer, TIMED_RAYS, angle_deg, AMPLITUDE);
            let words = |refine: Refine, form: LoopForm| -> Result<Vec<u32>> {
                let how = Relief { refine: refine as u32, ..constant(form) };
                let (found, _) = bench.run(&stage.uploaded, &how, &probes, 1)?;
                Ok(found
                    .iter()
                    .flat_map(|found| [found.uv[0], found.uv[1], found.height].map(f32::to_bits))
                    .collect())
            };
            let differing =
                |one: &[u32], other: &[u32]| one.iter().zip(other).filter(|(a, b)| a != b).count();
            for refine in [Refine::None, Refine::Segment, Refine::Secant, Refine::Bisection] {
                let (exit, flag) = (words(refine, LoopForm::Exit)?, words(refine, LoopForm::Flag)?);
                loops.compared += exit.len();
                loops.differing += differing(&exit, &flag);
            }
            loops.differing_control +=
                differing(&words(Refine::None, LoopForm::Exit)?, &words(Refine::Secant, LoopForm::Flag)?);
        }
    }
    Ok(loops)
}

/// All ways take turns in every round. They are branches of one pipeline, as in the viewer.
fn costs(bench: &ReliefBench, stage: &Stage) -> Result<Vec<Cost>> {
    let ways = [
        constant(LoopForm::Flag),
        relief(ReliefTier::Auto),
        relief(ReliefTier::Pyramid),
        constant(LoopForm::Exit),
    ];
    let mut rows = Vec::new();
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for angle_deg in ANGLES_DEG {
            let probes = bundle(layer, TIMED_SIDE, angle_deg, AMPLITUDE);
            let mut times = vec![Vec::new(); ways.len()];
            for _ in 0..ROUNDS {
                for (how, times) in ways.iter().zip(&mut times) {
                    times.push(bench.run(&stage.uploaded, how, &probes, REPEATS)?.1);
                }
            }
            let ratios = ratios(&times);
            let row = Cost {
                map: kind.name(),
                angle_deg,
                auto: ratios[1],
                pyramid: ratios[2],
                early_exit: ratios[3],
            };
            println!(
                "{:<6} {angle_deg:>2} degrees, time over 64 steps without exit: auto {:.2}, pyramid {:.2}, 64 steps with exit {:.2}",
                row.map, row.auto, row.pyramid, row.early_exit
            );
            rows.push(row);
        }
    }
    Ok(rows)
}

impl Report {
    /// Every control must fail, or what it controls has seen nothing.
    fn controls(&self) -> Result<()> {
        for map in Kind::ALL.map(Kind::name) {
            let worst = self
                .search
                .iter()
                .filter(|row| row.map == map)
                .map(|row| row.linear.wrong)
                .fold(0.0, f64::max);
            ensure!(worst > 0.001, "64 steps miss nothing of {map}: the measurement cannot be trusted");
        }
        ensure!(
            self.loops.differing_control > 0,
            "a search with and without refinement finds the same places"
        );
        self.pictures.controls()
    }
}
