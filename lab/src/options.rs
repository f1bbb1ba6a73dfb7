//! The command line.

use crate::outputs::Outputs;
use crate::{accuracy, codec, culling, digest, land, lod, pom, stability, timings, visual};
use clap::{Parser, Subcommand};

/// Measures the terrain: digests of all backends, accuracy curves, stability sweeps, GPU timings.
///
/// Exits with 0 only if every bar is met.
#[derive(Clone, Debug, Parser)]
#[command(name = "tombolo-lab", version)]
pub struct Args {
    /// Measurement.
    #[command(subcommand)]
    pub command: Command,
    /// Where results go.
    #[command(flatten)]
    pub outputs: Outputs,
}

/// One measurement.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Compare the integers of every backend of this machine: CPU kernels, GPU drivers, a browser
    Digest(digest::Options),
    /// Measure error against cost of every approximation
    Accuracy(accuracy::Options),
    /// Measure pictures: light across borders of chunks, shading and tolerance, light in shadow
    Visual(visual::Options),
    /// Measure the drawn levels of detail: screen error, triangles, gaps, popping, draw calls,
    /// memory, time
    Lod(lod::Options),
    /// Measure parallax occlusion mapping: every march against the reference
    Pom(pom::Options),
    /// Measure culling: every test against visibility in f64
    Culling(culling::Options),
    /// Sweep the borders of the world and of every cell
    Stability(stability::Options),
    /// Measure the shape of the land: coasts, slopes, pits, cliffs, beaches, lattices, the start
    Land(land::Options),
    /// Time chunk generation on GPU and CPU
    Timings(timings::Options),
    /// Measure chunks on the wire against other codecs, in bytes and in time
    Codec(codec::Options),
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn outputs_come_before_or_after_the_command() {
        for line in ["--json a.json digest --out b", "digest --json a.json --out b"] {
            let args = Args::try_parse_from(std::iter::once("tombolo-lab").chain(line.split(' '))).unwrap();
            assert_eq!(args.outputs.json.as_deref(), Some(Path::new("a.json")));
            assert_eq!(args.outputs.out.as_deref(), Some(Path::new("b")));
        }
    }
}
