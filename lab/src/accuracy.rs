//! `tombolo-lab accuracy`: error against cost of every approximation, with a reference in f64.
//!
//! Rendering: levels of detail ([`lod`]), waves ([`water`]), reflection ([`brdf`]), repetition of
//! materials ([`tiling`]), their filter ([`anisotropy`]), parallax occlusion mapping ([`pom`],
//! [`pom_pictures`]), occlusion culling ([`mod@culling`]), density of grass ([`grass`]), distances
//! of trees ([`trees`]).
//!
//! Heightfield: integers against the formula in f64 ([`heightfield`], with its bars), octaves kept
//! ([`octaves`]), height quantum ([`quantum`]).
//!
//! Wire: tolerances, efforts and seeds ([`codec`]).
//!
//! A missed bar, or a control that meets its bars, is an error.

mod anisotropy;
mod brdf;
mod codec;
mod culling;
mod errors;
mod grass;
mod heightfield;
mod lod;
mod octaves;
mod pom;
mod pom_pictures;
mod quantum;
mod tiling;
mod trees;
mod water;

use crate::curve::{self, Curve};
use crate::pom::maps::Kind;
use crate::table::Table;
use crate::{Outputs, note};
use anyhow::{Result, anyhow};
use chart::Chart;
use clap::ValueEnum as _;
use serde::Serialize;
use std::io::Write;

/// Options of `accuracy`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Curves to measure, separated by commas; everything if omitted
    #[arg(long, value_enum, value_name = "SUBJECTS", value_delimiter = ',')]
    pub only: Vec<Subject>,
    /// Random points of the headline, 1000 to 100000000; the curves take a fixed number
    #[arg(long, value_name = "N", default_value_t = 1_000_000,
          value_parser = clap::value_parser!(u32).range(1_000..=100_000_000))]
    pub points: u32,
    /// Seed of the world
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub world_seed: u64,
}

/// A subject of measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Subject {
    /// The heights of the land
    Heightfield,
    /// Levels of detail of the drawn land
    Lod,
    /// Parallax of waves
    Water,
    /// Reflection of rough surfaces
    Brdf,
    /// Hiding the repetition of materials
    Tiling,
    /// Filter of materials
    Anisotropy,
    /// Parallax occlusion mapping
    Pom,
    /// Chunks on the wire
    Codec,
    /// Occlusion tests of vegetation
    Culling,
    /// Density and thinning of grass
    Grass,
    /// Impostors and per-tree culling of trees
    Trees,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Seed of the world.
    pub world_seed: u64,
    /// Figures of the heightfield with bars, if measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub headline: Option<heightfield::Headline>,
    /// The curves.
    pub tables: Vec<Table>,
}

/// Measures one curve of a world. Without a required GPU the error says what to install.
type Measure = fn(u64) -> Result<Curve>;

impl Subject {
    /// Its curves, in order.
    fn curves(self) -> &'static [(&'static str, Measure)] {
        match self {
            Self::Heightfield => &[
                ("octaves kept", |seed| Ok(octaves::measure(seed))),
                ("height quantum", |seed| Ok(quantum::measure(seed))),
            ],
            Self::Lod => &[("levels of detail", lod::measure)],
            Self::Water => &[("waves", water::measure)],
            Self::Brdf => &[("reflection", brdf::measure)],
            Self::Tiling => &[("repetition", tiling::measure)],
            Self::Anisotropy => &[("filter of materials", anisotropy::measure)],
            Self::Pom => &[
                ("parallax occlusion over hills", |_| pom::measure(Kind::Fbm)),
                ("parallax occlusion over bricks", |_| pom::measure(Kind::Brick)),
                ("parallax occlusion over posts", |_| pom::measure(Kind::Posts)),
                ("parallax occlusion over ridges", |_| pom::measure(Kind::Ridges)),
                ("knobs of parallax occlusion", pom::knobs),
                ("pictures of parallax occlusion", pom_pictures::measure),
            ],
            Self::Codec => &[("codec of chunks", codec::measure)],
            Self::Culling => &[("occlusion tests", culling::measure)],
            Self::Grass => &[("grass", grass::measure)],
            Self::Trees => &[("trees", trees::measure)],
        }
    }
}

/// Measures, prints, writes CSV and PNG if a folder is given, and checks the bars.
///
/// # Errors
/// A bar is missed, a control misses none, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let seed = options.world_seed;
    let subjects = if options.only.is_empty() { Subject::value_variants() } else { &options.only };
    let headline =
        subjects.contains(&Subject::Heightfield).then(|| heightfield::measure(seed, options.points));
    headline.iter().for_each(|headline| print(headline));
    let mut tables = Vec::new();
    for (what, measure) in subjects.iter().flat_map(|subject| subject.curves()) {
        note(what);
        let curve = measure(seed)?;
        for table in &curve.tables {
            print(&format_args!("\n{table}"));
            outputs.out.as_deref().map_or(Ok(()), |folder| table.write_csv(folder))?;
        }
        if let Some(folder) = &outputs.out {
            curve::draw(
                &folder.join(format!("{}.png", curve.name)),
                &Chart::grid(curve.title, curve.panels),
            )?;
        }
        tables.extend(curve.tables);
    }
    let report = Report { world_seed: seed, headline, tables };
    outputs.write_json(&report)?;
    report.headline.map_or(Ok(()), |headline| headline.verdict().map_err(|problem| anyhow!(problem)))
}

/// A closed standard output is no failure; the exit code has the verdict.
fn print(text: &dyn std::fmt::Display) {
    let _ = write!(std::io::stdout(), "{text}");
}
