//! `tombolo-lab visual`: what a person would notice in pictures of the land.
//!
//! Light across borders of chunks (`borders`), the change of shading with the tolerance
//! (`tolerance`), light in shadow (`shadow`). Each figure is measured with the normals of the land
//! and, as its control, with those of the drawn triangles. `cargo xtask measure visual` compares
//! the figures with their bars; here only a control that passes is an error.

mod bars;
mod borders;
mod shadow;
mod tolerance;
mod views;

use crate::report::publish;
use crate::{Outputs, note};
use anyhow::{Result, ensure};
use serde::Serialize;
use terrain::Land;

/// The world that is measured.
const WORLD_SEED: u64 = 1;

/// Options of `visual`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Poses of each figure, 4 to 10000
    #[arg(long, value_name = "N", default_value_t = 60,
          value_parser = clap::value_parser!(u32).range(4..=10_000))]
    pub poses: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    adapter: String,
    poses: u32,
    borders: borders::Borders,
    tolerance: tolerance::Tolerance,
    shadow: shadow::Shadow,
}

/// Measures, prints and checks the controls.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let land = Land::new(WORLD_SEED);
    let mut views = views::Views::open(land, options.poses)?;
    note("light across borders");
    let borders = borders::measure(&mut views)?;
    note("shading and tolerance");
    let tolerance = tolerance::measure(&mut views)?;
    note("light in shadow");
    let shadow = shadow::measure(&mut views)?;
    let report = Report { adapter: views.adapter(), poses: options.poses, borders, tolerance, shadow };
    publish(&report, bars::rows, bars::notes, "/adapter", outputs)?;
    ensure!(
        report.borders.mesh.ratio > report.borders.land.ratio,
        "borders of chunks do not show in the light of drawn triangles"
    );
    ensure!(report.tolerance.mesh > report.tolerance.land, "light of drawn triangles ignores the tolerance");
    Ok(())
}
