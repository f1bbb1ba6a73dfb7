//! `tombolo-lab accuracy`: what every shortcut costs, against a truth in which nothing is rounded.
//!
//! For the picture: levels of detail ([`lod`]), waves ([`water`]), reflection ([`brdf`]),
//! repetition of materials ([`tiling`]) and their relief ([`pom`], [`pom_pictures`]), what hides
//! plants ([`mod@culling`]), and how many of them there are ([`grass`]).
//!
//! For the heightfield: how far the integers are from the formula in f64 ([`heightfield`], with the
//! bars that are promised), and four curves: octaves kept ([`octaves`]), height quantum
//! ([`quantum`]), distance from the origin ([`distance`]), and dropping octaves on coarse levels
//! ([`levels`]).
//!
//! For the wire: tolerances, efforts and seeds ([`codec`]).
//!
//! A missed bar, or a control that misses no bar, ends with an error.

pub mod brdf;
pub mod codec;
pub mod culling;
pub mod distance;
pub mod errors;
pub mod grass;
pub mod heightfield;
pub mod levels;
pub mod lod;
pub mod octaves;
pub mod pom;
pub mod pom_pictures;
pub mod quantum;
pub mod tiling;
pub mod water;

use crate::chart::{self, Panel};
use crate::relief::maps::Kind;
use crate::table::Table;
use crate::{Outputs, note};
use anyhow::{Result, anyhow};
use clap::ValueEnum as _;
use serde::Serialize;
use std::io::Write;

/// Options of `accuracy`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// What to measure, several separated by commas; everything where it is left out
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

/// Something with a truth.
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
    /// What hides that materials repeat
    Tiling,
    /// Parallax occlusion mapping
    Pom,
    /// Chunks on the wire
    Codec,
    /// Tests of what the land hides
    Culling,
    /// Density and thinning of grass
    Grass,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Seed of the world.
    pub world_seed: u64,
    /// The promised numbers of the heightfield, where it was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub headline: Option<heightfield::Headline>,
    /// The curves.
    pub tables: Vec<Table>,
}

/// A curve: its tables, and its diagrams under one title.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Name of the picture.
    pub name: &'static str,
    /// Title over all diagrams.
    pub title: &'static str,
    /// What was measured.
    pub tables: Vec<Table>,
    /// Diagrams of it.
    pub panels: Vec<Panel>,
}

/// Measures one curve of a world. What needs a GPU fails with a line that says what is missing.
type Measure = fn(u64) -> Result<Curve>;

impl Subject {
    /// What is measured about it besides the headline, in order.
    fn curves(self) -> &'static [(&'static str, Measure)] {
        match self {
            Self::Heightfield => &[
                ("octaves kept", |seed| Ok(octaves::measure(seed))),
                ("height quantum", |seed| Ok(quantum::measure(seed))),
                ("distance from the origin", |seed| Ok(distance::measure(seed))),
                ("levels", |seed| Ok(levels::measure(seed))),
            ],
            Self::Lod => &[("levels of detail", lod::measure)],
            Self::Water => &[("waves", water::measure)],
            Self::Brdf => &[("reflection", brdf::measure)],
            Self::Tiling => &[("repetition", tiling::measure)],
            Self::Pom => &[
                ("parallax occlusion over hills", |_| pom::measure(Kind::Fbm)),
                ("parallax occlusion over bricks", |_| pom::measure(Kind::Brick)),
                ("parallax occlusion over posts", |_| pom::measure(Kind::Posts)),
                ("parallax occlusion over ridges", |_| pom::measure(Kind::Ridges)),
                ("knobs of parallax occlusion", pom::knobs),
                ("pictures of parallax occlusion", pom_pictures::measure),
            ],
            Self::Codec => &[("codec of chunks", codec::measure)],
            Self::Culling => &[("tests of sight", culling::measure)],
            Self::Grass => &[("grass", grass::measure)],
        }
    }
}

/// Measures, prints, writes CSV and PNG where a folder was named, and judges.
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
            chart::write(&folder.join(format!("{}.png", curve.name)), curve.title, &curve.panels)?;
        }
        tables.extend(curve.tables);
    }
    let report = Report { world_seed: seed, headline, tables };
    outputs.write_json(&report)?;
    report.headline.map_or(Ok(()), |headline| headline.verdict().map_err(|problem| anyhow!(problem)))
}

/// Nobody reading the tables is no reason to fail; the exit code says what matters.
fn print(text: &dyn std::fmt::Display) {
    let _ = write!(std::io::stdout(), "{text}");
}
