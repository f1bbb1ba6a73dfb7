//! Repetition of materials: the settings of the tiling knob against the same recipe without period.
//!
//! The shipped shader renders a field of whole tiles, one sample a texel. A repeating texture
//! correlates with itself at a distance of one tile; hiding the repetition blends samples, which
//! costs contrast and time.

use crate::curve::{Curve, Sheet};
use crate::gpu_probes::tiling::{FIELD, Look, ProbeTiling};
use crate::stats::{interleaved, mean, ratios};
use crate::table::Table;
use anyhow::{Context, Result};
use chart::{Panel, linear, log};
use client::features::materials::{CustomMaterials, MATERIAL_SIZE, Materials};
use client::gpu::Gpu;
use client::settings::Tiling;
use shaders::layout::MATERIALS;
use std::time::Instant;
use terrain::hash::mix;

/// Rounds of the interleaved timing; the median counts.
const ROUNDS: usize = 25;

/// The settings of the knob: name in diagrams and samples of each.
const KNOB: [(Tiling, &str, f64); 3] =
    [(Tiling::Off, "off", 1.0), (Tiling::TwoScale, "two scales", 2.0), (Tiling::Hex, "hexagons", 3.0)];

/// The measured materials, one of small equal parts and one of large different ones: name, table,
/// titles of diagrams.
const MEASURED: [(&str, &str, &str, &str); 2] = [
    ("meadow", "tiling_meadow", "Meadow: repetition", "Meadow: contrast"),
    ("cliff", "tiling_cliff", "Cliff: repetition", "Cliff: contrast"),
];

/// A setting with its time over that without hiding.
struct Row {
    knob: usize,
    time_ratio: f64,
    field: FieldStats,
}

/// Statistics of a rendered field.
struct FieldStats {
    /// Autocorrelation at one tile, the largest of three directions.
    repetition: f64,
    /// Standard deviation of luminance.
    deviation: f64,
    /// Luminances in ascending order.
    sorted: Vec<f32>,
}

pub fn measure(world_seed: u64) -> Result<Curve> {
    let gpu = Gpu::open_blocking().context("tiling is measured on a GPU")?;
    let materials = Materials::new(&gpu.device, &gpu.queue, &CustomMaterials::default(), 1);
    let probe = ProbeTiling::new(&gpu, &materials);
    // One of the 32 x 32 places where a field may start.
    let place = |turn: u32| 256.0 * (mix(world_seed as u32 ^ turn) % 32) as f32;
    let anchor_m = [place(1), place(2)];
    let (mut tables, mut panels): (Vec<Table>, _) = (Vec::new(), Vec::new());
    for (name, table, repetition_title, contrast_title) in MEASURED {
        let material = MATERIALS.iter().position(|known| *known == name).context("no such material")? as u32;
        let render = |look| -> Result<FieldStats> {
            probe.run(&gpu, &materials, material, look, anchor_m)?;
            Ok(FieldStats::of(&probe.read(&gpu)?))
        };
        let texture = |knob: usize| Look::Textures(KNOB[knob].0 as u32);
        let reference = render(Look::Recipe)?;
        let times = interleaved(ROUNDS, KNOB.len(), |knob| {
            let begun = Instant::now();
            probe.run(&gpu, &materials, material, texture(knob), anchor_m)?;
            Ok::<_, anyhow::Error>(begun.elapsed())
        })?;
        let rows = ratios(&times).into_iter().enumerate();
        let rows = rows.map(|(knob, time_ratio)| Ok(Row { knob, time_ratio, field: render(texture(knob))? }));
        let tiles = |axis: u32| f64::from(axis / MATERIAL_SIZE);
        let caption = format!(
            "{name}, {} x {} texels of {:.0} x {:.0} tiles; knob 0 off, 1 two scales, 2 hexagons; \
             against the recipe without period, whose own correlation at that distance is {:.4}; time \
             against off, median of {ROUNDS} interleaved rounds on {}.",
            FIELD.0,
            FIELD.1,
            tiles(FIELD.0),
            tiles(FIELD.1),
            reference.repetition,
            gpu.name()
        );
        let mut sheet = Sheet::new(table, caption, rows.collect::<Result<_>>()?);
        let contrast = |row: &Row| row.field.deviation / reference.deviation;
        sheet.columns(["knob", "samples", "time ratio", "repetition"], |row| {
            [row.knob as f64, KNOB[row.knob].2, row.time_ratio, row.field.repetition]
        });
        sheet.columns(["contrast kept", "contrast lost", "histogram, deviations"], |row| {
            let apart = row.field.histogram_distance(&reference) / reference.deviation;
            [contrast(row), (1.0 - contrast(row)).abs(), apart]
        });

        let x = log("time, ratio to off");
        let front = |title, y, error| {
            let name = |row: &Row| (KNOB[row.knob].1.to_owned(), KNOB[row.knob].0 == Tiling::default());
            sheet.front(Panel::new(title, x, linear(y)), "time ratio", error, name)
        };
        let times = sheet.rows.iter().map(|row| (row.time_ratio, reference.repetition));
        panels.push(
            front(repetition_title, "correlation at one tile", "repetition")
                .bound("the recipe without period", times),
        );
        panels.push(front(contrast_title, "contrast lost, share", "contrast lost"));
        tables.push(sheet.into());
    }
    let title = "Repetition of materials: cost and what is left (reference: the recipe without period)";
    Ok(Curve { name: "tiling", title, tables, panels })
}

impl FieldStats {
    fn of(luminances: &[f32]) -> Self {
        let average = mean(luminances.iter().map(|value| f64::from(*value)));
        let variance = mean(luminances.iter().map(|value| (f64::from(*value) - average).powi(2)));
        let tile = MATERIAL_SIZE as usize;
        let shifts = [(tile, 0), (0, tile), (tile, tile)];
        let repetition = shifts.map(|(x, y)| covariance(luminances, average, x, y) / variance.max(1e-18));
        let mut sorted = luminances.to_vec();
        sorted.sort_by(f32::total_cmp);
        let repetition = repetition.into_iter().fold(f64::NEG_INFINITY, f64::max);
        Self { repetition, deviation: variance.sqrt(), sorted }
    }

    /// Earth mover's distance of the two histograms.
    fn histogram_distance(&self, other: &Self) -> f64 {
        mean(self.sorted.iter().zip(&other.sorted).map(|(a, b)| f64::from((a - b).abs())))
    }
}

/// Autocovariance at a shift of `x` and `y` texels.
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
