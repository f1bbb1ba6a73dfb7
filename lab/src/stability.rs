//! `tombolo-lab stability`: the land at borders of the world and of lattice cells.
//!
//! Sweeps every line where an implementation could break and compares every step with a proved
//! bound ([`bounds`], [`samples`], [`edges`], [`thresholds`], [`continuity`]), checks that seams
//! are zero at every level and that no height depends on its chunk or grid ([`seams`]), and that
//! chunks state no smaller error than they have and levels not much larger ones ([`errors`]). Then
//! it shows what float noise does at the same distances ([`floats`]).
//!
//! Every sweep also runs on a control that must fail; a control that passes is an error.

mod bars;
mod baselines;
mod bounds;
mod check;
mod continuity;
mod edges;
mod errors;
mod floats;
mod report;
mod samples;
mod seams;
mod thresholds;

use crate::Outputs;
use crate::floats::{FloatLand, metres_f32};
use crate::reference_f64::ReferenceF64;
use anyhow::{Context, Result, anyhow};
use check::Check;
use continuity::Heights;
use report::Report;
use serde_json::json;
use std::io::Write;
use terrain::constants::{FINE_OCTAVES, OCTAVE_SHIFT, UNITS_PER_METRE};
use terrain::{Land, Position};

/// Options of `stability`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Worlds to sweep, seeds 0 to N - 1, 1 to 1000, and always those of the seeds 2^63 and
    /// 2^64 - 1
    #[arg(long, value_name = "N", default_value_t = 8,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub worlds: u32,
    /// Chunks per level whose stated errors are checked, 1 to 1000000
    #[arg(long, value_name = "N", default_value_t = 10_000,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub chunks: u32,
}

/// Sweeps, prints the tables, and judges.
///
/// # Errors
/// A property is violated, a control is not, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let report = measure(options.worlds, options.chunks);
    // A closed standard output is no failure; the exit code has the verdict.
    let _ = write!(std::io::stdout(), "{report}");
    let mut json = serde_json::to_value(&report)?;
    json["bars"] = json!(bars::rows(&report));
    json["notes"] = json!(bars::notes(&report));
    outputs.write_json(&json)?;
    if let Some(folder) = &outputs.out {
        let path = folder.join("stability.txt");
        std::fs::write(&path, report.to_string())
            .with_context(|| format!("--out: cannot write `{}`", path.display()))?;
    }
    report.verdict().map_err(|problem| anyhow!(problem))
}

/// Measures everything over so many worlds, and stated errors of so many chunks per level.
pub fn measure(worlds: u32, chunks: u32) -> Report {
    let seeds: Vec<u64> = (0..u64::from(worlds)).chain([1 << 63, u64::MAX]).collect();
    let mut checks = continuity::sweep(&seeds, integers);
    let seams = (0..u64::from(worlds.min(2))).map(|seed| seams::check(&Land::new(seed)));
    checks.extend(seams.reduce(check::merged).unwrap_or_default());
    let (of_errors, errors) = errors::check(chunks);
    checks.extend(of_errors);
    checks.push(errors::tightness(&errors));
    let mut controls = controls();
    controls.push(errors::loose_control(&errors));
    Report { worlds, checks, controls, errors, floats: floats::measure(0) }
}

/// The same sweeps over the controls.
fn controls() -> Vec<Check> {
    // f32 is fine at vertices, whose coordinates it holds exactly up to 2^24 vertices; between them
    // it is not.
    const METRE: f64 = UNITS_PER_METRE as f64;
    let of_f32 = continuity::sweep(&[0], |seed| {
        let land = FloatLand::new(seed);
        Box::new(move |x, z, _| f64::from(land.height_m(metres_f32(x), metres_f32(z))) * METRE)
    });
    let of = |reference: ReferenceF64| {
        continuity::sweep(&[0], |_| Box::new(move |x, z, octaves| reference.height_m(x, z, octaves) * METRE))
    };
    let of_coarse = of(ReferenceF64::new(0).with_coarse_weights(10));
    let of_direct = of(ReferenceF64::new(0).without_spline());
    let of_torn = continuity::sweep(&[0], |seed| {
        let whole = integers(seed);
        // One lattice line of the last octave, torn by 4 cm.
        let line = (1 << 11) - OCTAVE_SHIFT[FINE_OCTAVES - 1].0;
        Box::new(move |x, z, octaves| whole(x, z, octaves) + if x >= line { 10.0 } else { 0.0 })
    });
    let named = |checks: &[Check], index: usize, what: &str| {
        let check = checks[index].clone();
        Check { name: format!("{what}: {}", check.name), ..check }
    };
    vec![
        named(&of_f32, 0, "our formula in f32"),
        named(&of_f32, 3, "our formula in f32"),
        named(&of_coarse, 2, "weights of 10 bits"),
        named(&of_direct, 2, "never a spline"),
        named(&of_torn, 0, "torn by 4 cm along a line"),
        named(&of_torn, 5, "torn by 4 cm along a line"),
        seams::control(),
        errors::control(),
    ]
}

/// The land as a height function of the sweeps.
fn integers(seed: u64) -> Heights {
    let land = Land::new(seed);
    Box::new(move |x, z, octaves| {
        let position = Position::new(x, z).expect("steps stay in the world");
        f64::from(land.height_keeping(position, octaves))
    })
}
