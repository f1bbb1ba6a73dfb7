//! Height quantum: size on the wire against error.

use super::errors::{FIGURES, HEIGHTS, SLOPES, compare, exact, figures, integers};
use crate::curve::{Curve, Sheet};
use crate::reference_f64::ReferenceF64;
use crate::sample;
use crate::stats::Figures;
use chart::{Panel, linear, log};
use protocol::chunk_codec;
use terrain::constants::{UNIT_BITS, UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{Chunk, ChunkKey, Land, Octaves, WorldDigest};

const POINTS: u32 = 40_000;

/// Chunks whose encoded size is averaged.
const CHUNKS: u32 = 48;

struct Row {
    quantum_m: f64,
    height: Figures,
    slope: Figures,
    bytes_per_vertex: f64,
}

/// Measures quanta from 2^-8 m to 1 m.
pub fn measure(world_seed: u64) -> Curve {
    let (land, reference) = (Land::new(world_seed), exact(ReferenceF64::new(world_seed)));
    let points: Vec<_> = sample::land_vertices(world_seed, POINTS, 22).collect();
    let chunks: Vec<Chunk> = sample::land_vertices(world_seed, CHUNKS, 23)
        .map(|(x, z)| land.chunk(ChunkKey::containing(0, x, z)))
        .collect();
    let whole = integers(land, Octaves::ALL);
    let rows = (0..=UNIT_BITS).map(|dropped| {
        let quantum_m = f64::from(1u32 << dropped) / f64::from(UNITS_PER_METRE);
        let rounded = |x, z| (whole(x, z) / quantum_m).round() * quantum_m;
        let (height, slope) = compare(&rounded, &reference, &points);
        let bytes: usize = chunks.iter().map(|chunk| encoded_bytes(chunk, dropped)).sum();
        let bytes_per_vertex = bytes as f64 / (chunks.len() * VERTEX_COUNT) as f64;
        Row { quantum_m, height, slope, bytes_per_vertex }
    });
    let caption = format!(
        "integers rounded to a quantum against f64 at {POINTS} vertices of islands; bytes of {CHUNKS} \
         level-0 chunks in the protocol's exact coding, over their vertices."
    );
    let mut sheet = Sheet::new("quantum", caption, rows.collect());
    sheet.column("quantum, m", |row| row.quantum_m);
    sheet.columns(FIGURES, |row| figures(&row.height, &row.slope));
    sheet.column("bytes per vertex", |row| row.bytes_per_vertex);

    let span = [1.0 / 256.0, 1.0];
    let (x, size, height) = (log("quantum, m"), linear("bytes per vertex"), log("height error, m"));
    let slope = Panel::new("Slope error against quantum", x, log("slope error, degrees"));
    let panels = vec![
        sheet
            .lines(Panel::new("Height error against quantum", x, height), "quantum, m", HEIGHTS)
            .bound("half a quantum", span.map(|q| (q, q / 2.0)))
            .bound("bar, 1/128 m", span.map(|q| (q, 1.0 / 128.0))),
        sheet.lines(slope, "quantum, m", SLOPES).bound("bar, 0.2 degrees", span.map(|q| (q, 0.2))),
        Panel::new("Encoded size against quantum", x, size)
            .line("plane residuals, byte planes, zstd", sheet.points("quantum, m", "bytes per vertex")),
        sheet.lines(Panel::new("Error against size", size, height), "bytes per vertex", HEIGHTS),
    ];
    let title = "Height quantum: accuracy and encoded size (reference: f64)";
    Curve { name: "quantum", title, tables: vec![sheet.into()], panels }
}

/// Bytes of a chunk whose heights lose so many bits, in the exact coding.
fn encoded_bytes(chunk: &Chunk, dropped: u32) -> usize {
    let half = (1 << dropped) >> 1;
    let heights = Box::new(chunk.heights.map(|height| (height + half) >> dropped));
    let coarse = Chunk::from_parts(chunk.key, heights, chunk.error, chunk.grass.clone());
    // The digest of the world does not change the size.
    chunk_codec::encode(&coarse, &WorldDigest([0; 32])).len()
}
