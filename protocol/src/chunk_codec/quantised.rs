//! Heights rounded to a tolerance, and their frame.
//!
//! Rounding is a pure function of a height, so vertices that chunks share stay equal. The error of
//! the chunk grows by the largest displacement of its vertices; the header states the tolerance.

use super::entropy::Effort;
use super::{Frame, KIND_QUANTISED, decode_frame, encode_frame};
use crate::delivery::Tolerance;
use crate::error::ChunkError;
use bytes::Bytes;
use terrain::constants::HEIGHT_LIMIT;
use terrain::{Chunk, GrassSeed, WorldDigest};

/// The chunk as its quantised frame delivers it; none if a rounded height would exceed the range of
/// heights.
#[must_use]
pub fn quantise(chunk: &Chunk, tolerance: Tolerance) -> Option<Chunk> {
    let (shift, half) = (tolerance.shift(), i32::from(tolerance.units()));
    let mut heights = chunk.heights.clone();
    let mut moved = 0;
    for height in heights.iter_mut() {
        let rounded = height.wrapping_add(half) >> shift << shift;
        moved = moved.max(rounded.abs_diff(*height));
        *height = rounded;
    }
    let in_range = heights.iter().all(|height| height.unsigned_abs() < HEIGHT_LIMIT as u32);
    let grass = GrassSeed { density: chunk.grass.density.clone(), ..chunk.grass };
    // A point of a triangle moves no farther than the farthest of its corners.
    in_range.then(|| Chunk::from_parts(chunk.key, heights, chunk.error.saturating_add(moved), grass))
}

/// Encodes a chunk of a world with heights within a tolerance of its own; none where [`quantise`]
/// gives none.
#[must_use]
pub fn encode(chunk: &Chunk, world: &WorldDigest, tolerance: Tolerance, effort: Effort) -> Option<Bytes> {
    let chunk = quantise(chunk, tolerance)?;
    Some(encode_frame(KIND_QUANTISED, &chunk, world, tolerance.units(), effort, None))
}

/// The tolerance that a quantised frame states; none if it is no such frame.
#[must_use]
pub fn tolerance(frame: &[u8]) -> Option<Tolerance> {
    Frame::read(frame, KIND_QUANTISED).ok().and_then(|frame| Tolerance::new(frame.tolerance))
}

/// Decodes one whole quantised frame of a world whose tolerance is at most the one given.
///
/// # Errors
/// As [`super::decode`]; [`ChunkError::Tolerance`] for a coarser one.
pub fn decode(frame: &[u8], world: &WorldDigest, tolerance: Tolerance) -> Result<Chunk, ChunkError> {
    decode_frame(&Frame::read(frame, KIND_QUANTISED)?, world, Some(tolerance), None)
}
