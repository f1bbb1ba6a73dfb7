//! Repetition of materials: what hides it, against the same recipe without its period.
//!
//! The shader code that ships is asked for a field of whole tiles, a sample a texel. A texture that
//! repeats correlates with itself one tile farther; what hides that blends samples, which costs
//! contrast and time.

use super::Curve;
use super::octaves::ratios;
use crate::chart::{Choice, Panel, front, linear, log, stated};
use crate::table::Table;
use anyhow::{Context, Result};
use client::looks::Tiling;
use client::render::materials::{MATERIAL_SIZE, Materials, OwnMaterials};
use client::render::tiling_probe::{FIELD, Look, ProbeTiling};
use client::render::{Gpu, gpu};
use shaders::layout::MATERIALS;
use std::time::Instant;
use terrain::hash::mix;

/// Rounds of the interleaved timing; the median is kept.
const ROUNDS: usize = 25;

/// The knob's settings with the samples that they take.
const KNOB: [(Tiling, f64); 3] = [(Tiling::Off, 1.0), (Tiling::TwoScale, 2.0), (Tiling::Hex, 3.0)];

/// What they are called in diagrams.
const NAMES: [&str; 3] = ["off", "two scales", "hexagons"];

/// The sets that are measured, one of small equal parts and one of large different ones: name,
/// table, titles of diagrams.
const MEASURED: [(&str, &str, &str, &str); 2] = [
    ("meadow", "tiling_meadow", "Meadow: repetition", "Meadow: contrast"),
    ("cliff", "tiling_cliff", "Cliff: repetition", "Cliff: contrast"),
];

/// What one setting shows of a material.
struct Seen {
    /// Correlation with itself one tile farther, the greatest of three directions.
    repetition: f64,
    /// Standard deviation of luminance.
    deviation: f64,
    /// Luminances in ascending order.
    sorted: Vec<f32>,
}

/// Measures all settings of the knob.
///
/// # Errors
/// There is no GPU, or it fails.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let gpu =
        pollster::block_on(Gpu::open(gpu::instance(None), None)).context("tiling is measured on a GPU")?;
    let materials = Materials::new(&gpu.device, &gpu.queue, &OwnMaterials::default(), true);
    let probe = ProbeTiling::new(&gpu, &materials);
    // Anywhere in the 32 x 32 places where a field may start.
    let place = |turn: u32| 256.0 * (mix(world_seed as u32 ^ turn) % 32) as f32;
    let anchor_m = [place(1), place(2)];
    let (mut tables, mut truths) = (Vec::new(), Vec::new());
    for (name, table, ..) in MEASURED {
        let material = MATERIALS.iter().position(|known| *known == name).context("no such material")? as u32;
        let look = |look| -> Result<Seen> {
            probe.run(&gpu, &materials, material, look, anchor_m)?;
            Ok(Seen::of(&probe.read(&gpu)?))
        };
        let truth = look(Look::Recipe)?;
        let times = times(|tiling: Tiling| {
            probe.run(&gpu, &materials, material, Look::Textures(tiling as u32), anchor_m)
        })?;
        let mut rows = Table::new(
            table,
            format!(
                "{name}, {} x {} texels of {:.0} x {:.0} tiles; knob 0 off, 1 two scales, 2 hexagons; against the recipe without period, whose own \
                 correlation at that distance is {:.4}; time against off, median of {ROUNDS} interleaved rounds on {}.",
                FIELD.0,
                FIELD.1,
                f64::from(FIELD.0 / MATERIAL_SIZE),
                f64::from(FIELD.1 / MATERIAL_SIZE),
                truth.repetition,
                gpu.name()
            ),
            &[
                "knob",
                "samples",
                "time ratio",
                "repetition",
                "contrast kept",
                "contrast lost",
                "histogram, deviations",
            ],
        );
        for (at, (tiling, samples)) in KNOB.into_iter().enumerate() {
            let seen = look(Look::Textures(tiling as u32))?;
            let contrast = seen.deviation / truth.deviation;
            rows.push([
                at as f64,
                samples,
                times[at],
                seen.repetition,
                contrast,
                (1.0 - contrast).abs(),
                seen.apart(&truth) / truth.deviation,
            ]);
        }
        tables.push(rows);
        truths.push(truth.repetition);
    }
    let panels = MEASURED.iter().zip(&tables).zip(truths).flat_map(|((material, table), truth)| {
        let trade = |against: &str| {
            let choices = table.curve("time ratio", against).into_iter().zip(KNOB).zip(NAMES);
            let choice = |((at, (tiling, _)), name): ((_, (Tiling, f64)), &str)| Choice {
                name: name.to_owned(),
                at,
                is_shipped: tiling == Tiling::default(),
            };
            front(&choices.map(choice).collect::<Vec<_>>())
        };
        let mut repetition = trade("repetition");
        let times = table.curve("time ratio", "repetition").into_iter().map(|point| (point.0, truth));
        repetition.push(stated("the recipe without period", times));
        let x = log("time, ratio to off");
        [
            Panel { title: material.2, x, y: linear("correlation at one tile"), series: repetition },
            Panel { title: material.3, x, y: linear("contrast lost, share"), series: trade("contrast lost") },
        ]
    });
    let panels = panels.collect();
    Ok(Curve {
        name: "tiling",
        title: "Repetition of materials: cost and what is left (truth: the recipe without period)",
        tables,
        panels,
    })
}

/// Times of all settings over that of the first; they take turns in every round.
fn times(mut run: impl FnMut(Tiling) -> Result<(), client::render::GpuError>) -> Result<Vec<f64>> {
    let mut times = vec![Vec::new(); KNOB.len()];
    for _ in 0..ROUNDS {
        for ((tiling, _), times) in KNOB.into_iter().zip(&mut times) {
            let begun = Instant::now();
            run(tiling)?;
            times.push(begun.elapsed());
        }
    }
    Ok(ratios(&times))
}

impl Seen {
    fn of(luminances: &[f32]) -> Self {
        let count = luminances.len() as f64;
        let mean = luminances.iter().map(|value| f64::from(*value)).sum::<f64>() / count;
        let square = |value: &f32| (f64::from(*value) - mean).powi(2);
        let variance = luminances.iter().map(square).sum::<f64>() / count;
        let tile = MATERIAL_SIZE as usize;
        let repetition = [(tile, 0), (0, tile), (tile, tile)]
            .map(|(x, y)| covariance(luminances, mean, x, y) / variance.max(1e-18))
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max);
        let mut sorted = luminances.to_vec();
        sorted.sort_by(f32::total_cmp);
        Self { repetition, deviation: variance.sqrt(), sorted }
    }

    /// Mean distance of the two histograms: what has to be moved how far to make one from the
    /// other.
    fn apart(&self, other: &Self) -> f64 {
        let differences = self.sorted.iter().zip(&other.sorted).map(|(a, b)| f64::from((a - b).abs()));
        differences.sum::<f64>() / self.sorted.len() as f64
    }
}

/// Mean product of what lies `x` and `y` texels apart.
fn covariance(luminances: &[f32], mean: f64, x: usize, y: usize) -> f64 {
    let (width, height) = (FIELD.0 as usize, FIELD.1 as usize);
    let mut sum = 0.0;
    for row in 0..height - y {
        let here = &luminances[row * width..][..width - x];
        let there = &luminances[(row + y) * width + x..][..width - x];
        sum +=
            here.iter().zip(there).map(|(a, b)| (f64::from(*a) - mean) * (f64::from(*b) - mean)).sum::<f64>();
    }
    sum / ((width - x) * (height - y)) as f64
}
