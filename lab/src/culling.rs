//! `tombolo-lab culling`: what is left out although it is seen, what is kept although it is hidden, and what either costs. `cargo xtask measure culling` holds the figures against
//! their bars; here only a control that fails to fail is an error.

pub mod leaves;
pub mod oracle;
pub mod poses;
pub mod scene;
pub mod sight;

use crate::{Outputs, note};
use anyhow::{Result, ensure};
use client::plants::PlantKnobs;
use serde::Serialize;
use sight::Findings;
use terrain::Land;

/// Options of `culling`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Poses that are judged by sight in f64, 1 to 100000
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub poses: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    /// Poses asked for.
    poses: u32,
    sight: Findings,
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
    let report = Report { poses: options.poses, sight };
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
        Ok(())
    }
}
