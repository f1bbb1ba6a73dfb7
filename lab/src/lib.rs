//! Measurements of the terrain and its renderer, behind `tombolo-lab`.
//!
//! Each compares with a reference: [`digest`] (all backends compute the same integers),
//! `accuracy` (error against cost), [`mod@lod`] (levels of detail as drawn), [`mod@pom`]
//! (parallax occlusion mapping), [`mod@culling`] (occlusion culling of vegetation), `stability`
//! (borders of the world and of cells), `land` (the shape of the land), `timings` (GPU against
//! CPU), `codec` (chunks on the wire against other codecs), `visual` (what a person would notice in
//! pictures).
//!
//! A missed bar is an error and sets the exit code.

#![forbid(unsafe_code)]

mod accuracy;
mod adapters;
mod codec;
pub mod cracks;
pub mod culling;
mod curve;
pub mod digest;
mod flip;
mod floats;
pub mod gpu_probes;
pub mod headless_renderer;
mod land;
pub mod lod;
mod options;
mod outputs;
pub mod places;
pub mod pom;
mod probe_pass;
mod reference_f64;
mod report;
mod sample;
mod stability;
pub mod stats;
mod supersampled;
mod table;
mod timings;
pub mod tree_shadow;
mod visual;
mod waves;
mod world_builder;

pub use options::Args;

use options::Command;
use outputs::Outputs;

/// Runs the measurement that the command line names.
///
/// # Errors
/// A bar is missed, a control passes, a required GPU is missing, or a result cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    args.outputs.prepare()?;
    match &args.command {
        Command::Digest(options) => digest::run(options, &args.outputs),
        Command::Accuracy(options) => accuracy::run(options, &args.outputs),
        Command::Lod(options) => lod::run(options, &args.outputs),
        Command::Pom(options) => pom::run(options, &args.outputs),
        Command::Culling(options) => culling::run(options, &args.outputs),
        Command::Land(options) => land::run(options, &args.outputs),
        Command::Stability(options) => stability::run(options, &args.outputs),
        Command::Timings(options) => timings::run(options, &args.outputs),
        Command::Visual(options) => visual::run(options, &args.outputs),
        Command::Codec(options) => codec::run(options, &args.outputs),
    }
}

/// Reports progress on a terminal.
pub(crate) fn note(what: &str) {
    if std::io::IsTerminal::is_terminal(&std::io::stderr()) {
        eprintln!("measuring {what} ...");
    }
}
