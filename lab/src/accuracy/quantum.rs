//! Height quantum: what coarser heights would save on the wire, and what they would cost.

use super::Curve;
use super::errors::{compare, exact, integers};
use crate::chart::{Panel, linear, log, measured, stated};
use crate::sample;
use crate::table::Table;
use crate::truth::Truth;
use protocol::chunk_codec;
use terrain::constants::{UNIT_BITS, UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{Chunk, ChunkKey, Land, Octaves, WorldDigest};

const POINTS: u32 = 40_000;

/// Chunks whose coded size is averaged.
const CHUNKS: u32 = 48;

/// Measures quanta from 2^-8 m to 1 m.
#[must_use]
pub fn measure(world_seed: u64) -> Curve {
    let (land, truth) = (Land::new(world_seed), exact(Truth::new(world_seed)));
    let points: Vec<_> = sample::land_vertices(world_seed, POINTS, 22).collect();
    let chunks: Vec<Chunk> = sample::land_vertices(world_seed, CHUNKS, 23)
        .map(|(x, z)| land.chunk(ChunkKey::containing(0, x, z)))
        .collect();
    let mut table = Table::new(
        "quantum",
        format!(
            "integers rounded to a quantum against f64 at {POINTS} vertices of islands; bytes of {CHUNKS} level-0 chunks in the protocol's exact coding, over their vertices."
        ),
        &["quantum, m", "max, m", "p99, m", "max, degrees", "p99, degrees", "bytes per vertex"],
    );
    let whole = integers(land, Octaves::ALL);
    for dropped in 0..=UNIT_BITS {
        let quantum_m = f64::from(1u32 << dropped) / f64::from(UNITS_PER_METRE);
        let rounded = |x, z| (whole(x, z) / quantum_m).round() * quantum_m;
        let (height, slope) = compare(&rounded, &truth, &points);
        let bytes: usize = chunks.iter().map(|chunk| coded(chunk, dropped)).sum();
        let per_vertex = bytes as f64 / (chunks.len() * VERTEX_COUNT) as f64;
        table.push([quantum_m, height.max, height.p99, slope.max, slope.p99, per_vertex]);
    }
    let span = [1.0 / 256.0, 1.0];
    let panels = vec![
        Panel {
            title: "Height error against quantum",
            x: log("quantum, m"),
            y: log("height error, m"),
            series: vec![
                measured("largest found", table.curve("quantum, m", "max, m")),
                measured("99th percentile", table.curve("quantum, m", "p99, m")),
                stated("half a quantum", span.map(|q| (q, q / 2.0))),
                stated("bar, 1/128 m", span.map(|q| (q, 1.0 / 128.0))),
            ],
        },
        Panel {
            title: "Slope error against quantum",
            x: log("quantum, m"),
            y: log("slope error, degrees"),
            series: vec![
                measured("largest found", table.curve("quantum, m", "max, degrees")),
                measured("99th percentile", table.curve("quantum, m", "p99, degrees")),
                stated("bar, 0.2 degrees", span.map(|q| (q, 0.2))),
            ],
        },
        Panel {
            title: "Coded size against quantum",
            x: log("quantum, m"),
            y: linear("bytes per vertex"),
            series: vec![measured(
                "plane residuals, byte planes, zstd",
                table.curve("quantum, m", "bytes per vertex"),
            )],
        },
        Panel {
            title: "What an error saves",
            x: linear("bytes per vertex"),
            y: log("height error, m"),
            series: vec![
                measured("largest found", table.curve("bytes per vertex", "max, m")),
                measured("99th percentile", table.curve("bytes per vertex", "p99, m")),
            ],
        },
    ];
    Curve {
        name: "quantum",
        title: "Height quantum: accuracy and coded size (truth: f64)",
        tables: vec![table],
        panels,
    }
}

/// Bytes of a chunk whose heights lose so many bits, in the exact coding.
fn coded(chunk: &Chunk, dropped: u32) -> usize {
    let half = (1 << dropped) >> 1;
    let heights = Box::new(chunk.heights.map(|height| (height + half) >> dropped));
    let coarse = Chunk::from_parts(chunk.key, heights, chunk.error, chunk.grass.clone());
    // Whose world it is does not change the size.
    chunk_codec::encode(&coarse, &WorldDigest([0; 32])).len()
}
