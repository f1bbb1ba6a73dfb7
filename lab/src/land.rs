//! `tombolo-lab land`: the shape of the land.
//!
//! Coast lengths ([`coast`]), slopes and their directions ([`surface`]), closed pits ([`pits`]),
//! cliffs and beaches ([`shore`]), the lattice of the islands ([`centres`]), and what lies near the
//! start ([`features`]). Only heights are read, so that every version of the formula is measured
//! alike; the controls ([`controls`]) pass through the same code ([`field`]).

mod bars;
mod centres;
mod coast;
mod controls;
mod features;
mod field;
mod labels;
mod pictures;
mod pits;
mod shape;
mod shore;
mod surface;
mod wood;

use crate::report::publish;
use crate::{Outputs, note};
use ::bars::Bar;
use anyhow::{Result, bail};
use centres::{CentreSet, Peak};
use controls::Controls;
use field::{SPACING_M, Window, place};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Map, Value, json};
use shape::{EVERY_M, Figures, Shape};
use std::time::Instant;
use terrain::Land;

/// Vertices along a side of a window that are measured (65.5 km), and around them (8.2 km): an
/// island whose centroid is measured may reach so far.
const INNER: usize = 4096;
const BORDER: usize = 512;

/// Vertices along a side of the window of the controls that change the land, about the start.
const CHANGED: usize = 512;

/// Threads at most: a window takes 300 MB.
const THREADS: usize = 4;

/// Streams of the places of windows and of squares of centres.
const WINDOWS: u32 = 0x1a4d;
const SQUARES: u32 = 0x1a4e;

/// Worlds that are drawn.
const DRAWN: u64 = 4;

/// Options of `land`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Worlds whose shape is measured, seeds 0 to N - 1, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 8,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub seeds: u32,
    /// Windows of 65.5 km in each of them, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 3,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub windows: u32,
    /// Worlds whose start is measured, seeds 0 to N - 1, 1 to 1000000
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub home_seeds: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    generator_version: u32,
    seeds: u32,
    /// Windows, and the side of each that is measured, km.
    windows: u32,
    window_km: f64,
    /// Metres of coast between points that are looked at for cliffs and beaches.
    every_m: f64,
    land: Figures,
    centres: Centres,
    homes: Map<String, Value>,
    controls: Controls,
    /// Time of the whole measurement.
    seconds: f64,
}

/// Centres of islands in a square of each world.
#[derive(Clone, Debug, Serialize)]
struct Centres {
    islands: usize,
    /// Those of at least 1 km².
    large_islands: usize,
    peak: Option<Peak>,
}

/// A world whose start lacks features.
#[derive(Clone, Debug, Serialize)]
struct Without {
    seed: u32,
    lacks: Vec<&'static str>,
}

/// Measures, draws, prints, judges.
///
/// # Errors
/// A bar is missed, a control keeps one, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let threads = std::thread::available_parallelism().map_or(1, |count| count.get().min(THREADS));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let (report, shape) = pool.install(|| measure(options));
    publish(&report, bars::rows, bars::notes, "/adapter", outputs)?;
    if let Some(folder) = &outputs.out {
        let worlds = (0..u64::from(options.seeds).min(DRAWN)).map(Land::new);
        let worlds: Vec<_> = worlds
            .map(|land| {
                let start = start(&land);
                (land, start)
            })
            .collect();
        pictures::relief(folder, &worlds)?;
        pictures::charts(folder, &shape.surface)?;
    }
    verdict(&bars::rows(&serde_json::to_value(report)?))
}

fn verdict(rows: &[Bar]) -> Result<()> {
    let missed: Vec<&Bar> = rows.iter().filter(|row| row.is_missed()).collect();
    if let Some(first) = missed.iter().find(|row| row.name.contains("(control)")).or(missed.first()) {
        let [figure, limit, _] = first.cells();
        bail!("{} bars missed, among them {}: {figure}, the bar is {limit}", missed.len(), first.name);
    }
    Ok(())
}

/// Where a visitor of the world starts, units.
fn start(land: &Land) -> (i32, i32) {
    let start = land.start();
    (start.x, start.z)
}

fn measure(options: &Options) -> (Report, Shape) {
    let began = Instant::now();
    note("coasts, slopes, pits, shores");
    let windows: Vec<(Land, Window)> = (0..options.seeds * options.windows)
        .map(|index| {
            let land = Land::new(u64::from(index / options.windows));
            (land, Window::around(place(WINDOWS, index), INNER, BORDER))
        })
        .collect();
    let shapes = windows.par_iter().map(|(land, window)| Shape::of(land, window));
    // In the order of the windows: sums of floats must not depend on threads.
    let shapes: Vec<Shape> = shapes.collect();
    let shape = shapes.into_iter().fold(Shape::default(), Shape::and);
    note("centres of islands");
    let island_centres =
        |seed: u32| centres::island_centres(&Land::new(u64::from(seed)), place(SQUARES, seed));
    let sets: Vec<[CentreSet; 2]> = (0..options.seeds).into_par_iter().map(island_centres).collect();
    let [all, large] = [0, 1].map(|size| sets.iter().map(|sizes| sizes[size].clone()).collect::<Vec<_>>());
    let [islands, large_islands] = [&all, &large].map(|sets| sets.iter().map(|set| set.centres.len()).sum());
    let peaks = [all, large].par_iter().filter_map(|sets| centres::peak(sets)).collect::<Vec<_>>();
    let centres = Centres { islands, large_islands, peak: centres::strongest(peaks.into_iter()) };
    note("starts");
    let homes = homes(options.home_seeds);
    note("controls");
    let land = Land::new(0);
    let controls = controls::measure(land, &Window::around(start(&land), CHANGED, 1));
    let report = Report {
        generator_version: terrain::constants::GENERATOR_VERSION,
        seeds: options.seeds,
        windows: windows.len() as u32,
        window_km: INNER as f64 * SPACING_M * 1e-3,
        every_m: EVERY_M,
        land: shape.figures(),
        centres,
        homes,
        controls,
        seconds: began.elapsed().as_secs_f64(),
    };
    (report, shape)
}

/// How many starts have each feature and all, and the worlds without all, with what they lack.
fn homes(seeds: u32) -> Map<String, Value> {
    let found: Vec<[bool; 6]> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            let land = Land::new(u64::from(seed));
            features::near(&land, start(&land))
        })
        .collect();
    let is_whole = |found: &&[bool; 6]| **found == [true; 6];
    let mut homes = Map::new();
    homes.insert("seeds".into(), json!(seeds));
    homes.insert("all".into(), json!(found.iter().filter(is_whole).count()));
    let first_without = found.iter().position(|found| !is_whole(&found));
    homes.insert("first_without".into(), first_without.map_or(json!("none"), |seed| json!(seed)));
    let lacks = |found: &[bool; 6]| {
        features::NAMES
            .into_iter()
            .zip(*found)
            .filter(|(_, is_there)| !is_there)
            .map(|(name, _)| name)
            .collect()
    };
    let without: Vec<Without> = (0..)
        .zip(&found)
        .filter(|(_, found)| !is_whole(found))
        .map(|(seed, found)| Without { seed, lacks: lacks(found) })
        .collect();
    homes.insert("without".into(), json!(without));
    for (index, name) in features::NAMES.into_iter().enumerate() {
        homes.insert(name.into(), json!(found.iter().filter(|found| found[index]).count()));
    }
    homes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_bar_is_an_error_and_a_control_is_named_first() {
        let met = Bar::at_most("good", Some(1.0), "", 1.0);
        verdict(std::slice::from_ref(&met)).unwrap();
        let rows = [
            met,
            Bar::at_most("bad", Some(2.0), "", 1.0),
            Bar::at_most("weak (control)", Some(2.0), "", 1.0),
        ];
        let error = verdict(&rows).unwrap_err().to_string();
        assert!(error.starts_with("2 bars missed, among them weak (control): 2"), "{error}");
    }

    #[test]
    fn controls_miss_their_bars_in_a_small_window() {
        let land = Land::new(0);
        let controls = controls::measure(land, &Window::around(start(&land), CHANGED, 1));
        let rows = bars::rows(&json!({ "controls": controls }));
        for row in rows.iter().filter(|row| row.name.contains("(control)")) {
            assert!(!row.is_missed(), "{row:?}");
        }
    }
}
