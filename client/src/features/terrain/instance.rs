//! Per-chunk words of the shaders. Those of the seams are packed by [`ChunkWords::seam_words`].

use crate::cache::Resident;
use crate::camera::Eye;
use crate::lod::Drawn;
use shaders::layout::{ChunkWords, PATTERN_PERIOD_M, TerrainInstance};
use terrain::constants::UNITS_PER_METRE;

/// The words of a drawn chunk, for terrain instances and for occluder chunks.
#[must_use]
pub fn chunk_words(drawn: &Drawn, chunk: &Resident, parent: &Resident) -> ChunkWords {
    let [edges, corners, inside] = ChunkWords::seam_words(&drawn.seams);
    // The quarter of the parent that the chunk covers, in bits 8 and 9.
    let (east, south) = drawn.key.quarter();
    let place = u32::from(drawn.key.level()) | ((east as u32) << 8) | ((south as u32) << 9);
    ChunkWords { slot: chunk.slot, parent_slot: parent.slot, edges, corners, inside, place }
}

/// The instance of a quarter of a drawn chunk, 0 or 1 east and 0 or 1 south: bits 10 and 11 of
/// [`ChunkWords::place`]. Not the quarter of the parent that the chunk covers.
#[must_use]
pub fn terrain_instance(
    eye: &Eye,
    drawn: &Drawn,
    quarter: (i32, i32),
    chunk: &Resident,
    parent: &Resident,
) -> TerrainInstance {
    let key = drawn.key;
    let (x, z) = key.origin();
    let words = chunk_words(drawn, chunk, parent);
    // Integers first, so that the distance to a near chunk is exact at any distance from the
    // origin.
    let relative = |low: i32, eye: i32| metres((i64::from(low) - i64::from(eye)) as f64) as f32;
    let period = PATTERN_PERIOD_M * UNITS_PER_METRE;
    TerrainInstance {
        origin_m: [relative(x, eye.units[0]), relative(0, eye.units[1]), relative(z, eye.units[2])],
        spacing_m: metres(f64::from(key.spacing())) as f32,
        pattern_m: [x, z].map(|low| metres(f64::from(low & (period - 1))) as f32),
        error_m: metres(f64::from(chunk.error)) as f32,
        parent_error_m: metres(f64::from(parent.error)) as f32,
        words: ChunkWords {
            place: words.place | ((quarter.0 as u32) << 10) | ((quarter.1 as u32) << 11),
            ..words
        },
    }
}

/// Units of 2^-8 m as metres.
#[must_use]
pub fn metres(units: f64) -> f64 {
    units / f64::from(UNITS_PER_METRE)
}
