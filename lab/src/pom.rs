//! `tombolo-lab pom`: parallax occlusion mapping against its reference. `cargo xtask measure pom`
//! compares the figures with their bars; here only a control that passes is an error.
//!
//! Height maps that are hard to march over ([`maps`]), the reference in f64 (`reference`) and
//! the shipped marches on this machine's GPU ([`mod@bench`]), both compared ([`comparison`]); edges
//! and depths in pictures ([`renderer`], `pictures`).

mod bars;
pub mod bench;
pub mod comparison;
pub mod maps;
pub(crate) mod pictures;
pub(crate) mod reference;
pub mod renderer;
pub(crate) mod travels;

use crate::pom::bench::PomBench;
use crate::pom::comparison::{
    AMPLITUDE, ANGLES_DEG, BATCH, Condition, Score, Stage, bundle, probes, relief, score_in_batches,
};
use crate::pom::maps::Kind;
use crate::pom::travels::Travel;
use crate::report::publish;
use crate::stats::{interleaved, ratios, worst};
use crate::{Outputs, note};
use anyhow::{Result, bail, ensure};
use client::features::pom::settings::{LoopForm, PomMethod, Refine};
use pictures::Pictures;
use serde::Serialize;
use shaders::layout::PomParams;

/// Rounds of the timing, and rays of each condition in it.
const ROUNDS: usize = 9;
const TIMED_SIDE: u32 = 256;
const TIMED_RAYS: u32 = 1 << 15;
const REPEATS: u32 = 2;

/// Options of `pom`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Rays of the traversal of each map and angle, 1000 to 10000000; other marches take the first
    /// 200000 of them
    #[arg(long, value_name = "N", default_value_t = 2_000_000,
          value_parser = clap::value_parser!(u32).range(1_000..=10_000_000))]
    pub rays: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    adapter: String,
    /// Whether the driver is a software rasteriser.
    is_software: bool,
    /// Rays of the traversal of each map and angle.
    rays: u32,
    /// Rays of all other marches.
    other_rays: u32,
    search: Vec<Search>,
    /// The automatic tier where it is not the traversal.
    travels: Vec<Travel>,
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

/// The search of a constant number of steps, the baseline.
fn constant(form: LoopForm) -> PomParams {
    PomParams { steps_min: 64, steps_max: 64, loop_form: form as u32, ..relief(PomMethod::Linear) }
}

/// Measures, prints and checks the controls.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let bench = PomBench::open()?;
    let stage = Stage::new(&bench, false)?;
    note("places against the reference");
    let search = searches(&bench, &stage, options.rays)?;
    let other_rays = options.rays.min(BATCH);
    note("the automatic tier at short travels");
    let travels = travels::measure(&bench, &stage, other_rays)?;
    note("loop forms");
    let loops = loops(&bench, &stage)?;
    note("pictures");
    let pictures = pictures::measure()?;
    note("cost");
    let cost = costs(&bench, &stage)?;
    let report = Report {
        adapter: bench.adapter(),
        is_software: bench.is_software(),
        rays: options.rays,
        other_rays,
        search,
        travels,
        loops,
        pictures,
        cost,
    };
    publish(&report, bars::rows, bars::notes, "/adapter", outputs)?;
    report.controls()
}

fn searches(bench: &PomBench, stage: &Stage, rays: u32) -> Result<Vec<Search>> {
    let mut rows = Vec::new();
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for angle_deg in ANGLES_DEG {
            let condition = Condition::new(stage, layer, angle_deg, rays.min(BATCH));
            let score = |how: &PomParams| condition.score(bench, stage, how);
            let traversal = relief(PomMethod::MaxMip);
            rows.push(Search {
                map: kind.name(),
                angle_deg,
                pyramid: score_in_batches(bench, stage, (layer, angle_deg), rays, &traversal)?,
                auto: score(&relief(PomMethod::Auto))?,
                linear: score(&constant(LoopForm::Exit))?,
            });
        }
    }
    Ok(rows)
}

fn loops(bench: &PomBench, stage: &Stage) -> Result<Loops> {
    let mut loops = Loops { compared: 0, differing: 0, differing_control: 0 };
    for layer in 0..Kind::ALL.len() {
        for angle_deg in ANGLES_DEG {
            let probes = probes(layer, TIMED_RAYS, angle_deg, AMPLITUDE);
            let words = |refine: Refine, form: LoopForm| -> Result<Vec<u32>> {
                let how = PomParams { refine: refine as u32, ..constant(form) };
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

/// The methods are branches of one pipeline, as in the viewer.
fn costs(bench: &PomBench, stage: &Stage) -> Result<Vec<Cost>> {
    let methods = [
        constant(LoopForm::Flag),
        relief(PomMethod::Auto),
        relief(PomMethod::MaxMip),
        constant(LoopForm::Exit),
    ];
    let mut rows = Vec::new();
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for angle_deg in ANGLES_DEG {
            let probes = bundle(layer, TIMED_SIDE, angle_deg, AMPLITUDE);
            let run = |index: usize| {
                Ok::<_, anyhow::Error>(bench.run(&stage.uploaded, &methods[index], &probes, REPEATS)?.1)
            };
            let ratios = ratios(&interleaved(ROUNDS, methods.len(), run)?);
            let [_, auto, pyramid, early_exit] = ratios[..] else { bail!("{} times", ratios.len()) };
            rows.push(Cost { map: kind.name(), angle_deg, auto, pyramid, early_exit });
        }
    }
    Ok(rows)
}

impl Report {
    /// Fails if a control passes.
    fn controls(&self) -> Result<()> {
        for map in Kind::ALL.map(Kind::name) {
            let rows = self.search.iter().filter(|row| row.map == map);
            let missed = worst(rows.map(|row| row.linear.wrong));
            ensure!(missed > 0.001, "64 steps miss nothing of {map}: the measurement detects nothing");
        }
        ensure!(
            self.loops.differing_control > 0,
            "a search with and without refinement finds the same places"
        );
        self.pictures.controls()
    }
}
