//! The chunk frame for who has the parent: only vertices that the parent lacks.
//!
//! Up to level 2 a chunk's vertices in even columns and rows are those of its parent, bit for bit. The others are predicted
//! from both sides, which noise cannot hide from as well as from the plane predictor, which looks one way. First the vertices
//! between two known ones in a row, then in a column, by four-point interpolation (Deslauriers and Dubuc, "Symmetric iterative
//! interpolation processes", 1989: weights -1, 9, 9, -1 over 16); then the middles, by the patch through their eight neighbours
//! (Coons, 1967: half of the sides less a quarter of the corners).

use super::entropy::Effort;
use super::kernel::{self, Heights, Kernel, zigzag};
use super::parts::{self, Room};
use super::{Frame, KIND_REFINED, open, seal};
use crate::error::ChunkError;
use bytes::Bytes;
use terrain::constants::{CELLS, HEIGHT_LIMIT, VERTEX_COUNT, VERTICES};
use terrain::{Chunk, ChunkKey, WorldDigest};

/// Vertices along a side that the parent has.
pub(super) const KNOWN: usize = CELLS / 2 + 1;

/// Vertices that the parent lacks.
const LACKING: usize = VERTEX_COUNT - KNOWN * KNOWN;

/// Encodes a chunk of a world for a receiver that has its parent; none if `parent` is not its parent or does not have the
/// chunk's vertices in even columns and rows.
#[must_use]
pub fn encode(chunk: &Chunk, parent: &Chunk, world: &WorldDigest, effort: Effort) -> Option<Bytes> {
    let known = Known::of(chunk.key, parent)?;
    known.is_of(&chunk.heights).then(|| seal(KIND_REFINED, chunk, world, 0, effort, Some(&known)))
}

/// Decodes one whole refined frame of a world with the help of the chunk's parent.
///
/// # Errors
/// As [`super::decode`]; [`ChunkError::Parent`] if `parent` is the chunk of another key, [`ChunkError::Digest`] if it is not the one that the
/// frame was made from.
pub fn decode(frame: &[u8], world: &WorldDigest, parent: &Chunk) -> Result<Chunk, ChunkError> {
    let frame = Frame::read(frame, KIND_REFINED)?;
    let known = Known::of(frame.key, parent).ok_or(ChunkError::Parent(frame.key))?;
    open(&frame, world, None, Some(&known))
}

/// The vertices of a chunk that its parent has, row by row.
pub(super) struct Known(Box<[i32; KNOWN * KNOWN]>);

impl Known {
    /// The quadrant of a parent that a chunk covers; none if it is not the parent.
    fn of(key: ChunkKey, parent: &Chunk) -> Option<Self> {
        let quadrant = parent.key.children()?.iter().position(|child| *child == key)?;
        let (x, z) = (quadrant % 2 * (KNOWN - 1), quadrant / 2 * (KNOWN - 1));
        let mut known = Box::new([0; KNOWN * KNOWN]);
        for (row, to) in known.as_chunks_mut::<KNOWN>().0.iter_mut().enumerate() {
            to.copy_from_slice(&parent.heights[(z + row) * VERTICES + x..][..KNOWN]);
        }
        Some(Self(known))
    }

    fn is_of(&self, heights: &Heights) -> bool {
        self.0.iter().enumerate().all(|(index, known)| {
            let (x, z) = (index % KNOWN, index / KNOWN);
            heights[2 * z * VERTICES + 2 * x] == *known
        })
    }

    /// The known heights as the digest covers them.
    pub(super) fn bytes(&self) -> impl Iterator<Item = [u8; 4]> {
        self.0.iter().map(|height| height.to_le_bytes())
    }

    /// Appends the parts of what the parent lacks. Returns the width of the residuals.
    pub(super) fn push(&self, kernel: Kernel, heights: &Heights, effort: Effort, out: &mut Vec<u8>) -> u32 {
        let mut residuals = Vec::with_capacity(LACKING);
        for index in lacking() {
            residuals.push(zigzag(heights[index].wrapping_sub(predict(heights, index))));
        }
        let width = parts::width(residuals.iter().fold(0, |all, residual| all | residual));
        parts::push(kernel, &residuals, width, effort, out);
        width
    }

    /// Takes the parts of what the parent lacks off a payload and completes the heights.
    pub(super) fn take(
        &self,
        kernel: Kernel,
        room: &mut Room,
        width: u32,
        payload: &mut &[u8],
        heights: &mut Heights,
    ) -> Result<(), ChunkError> {
        let mut residuals = [0; LACKING];
        kernel::join(kernel, room.take(kernel, width, LACKING, payload)?.get(), &mut residuals);
        for (index, known) in self.0.iter().enumerate() {
            heights[2 * (index / KNOWN) * VERTICES + 2 * (index % KNOWN)] = *known;
        }
        for (index, residual) in lacking().zip(residuals) {
            heights[index] = predict(heights, index).wrapping_add(residual);
        }
        if heights.iter().fold(false, |any, height| any | (height.unsigned_abs() >= HEIGHT_LIMIT as u32)) {
            return Err(ChunkError::Content("a height is out of range"));
        }
        Ok(())
    }
}

/// Indices of the vertices that the parent lacks in the order of their residuals: between two known ones of a row, of a column,
/// middles; each row by row.
fn lacking() -> impl Iterator<Item = usize> {
    [(1, 0), (0, 1), (1, 1)].into_iter().flat_map(|(x, z)| {
        (z..VERTICES).step_by(2).flat_map(move |z| (x..VERTICES).step_by(2).map(move |x| z * VERTICES + x))
    })
}

/// What a vertex that the parent lacks should be by its neighbours, all of them decoded before it.
fn predict(heights: &Heights, index: usize) -> i32 {
    let (x, z) = (index % VERTICES, index / VERTICES);
    let sum = |by: usize| heights[index - by].wrapping_add(heights[index + by]);
    let between = |place: usize, step: usize| {
        // The outermost have one neighbour a side.
        let far = if place > 1 && place < CELLS - 1 { sum(3 * step) } else { sum(step) };
        (sum(step).wrapping_mul(9).wrapping_sub(far).wrapping_add(8)) >> 4
    };
    match (x % 2, z % 2) {
        (1, 0) => between(x, 1),
        (0, _) => between(z, VERTICES),
        _ => {
            let sides = sum(1).wrapping_add(sum(VERTICES));
            let corners = sum(VERTICES - 1).wrapping_add(sum(VERTICES + 1));
            sides.wrapping_mul(2).wrapping_sub(corners).wrapping_add(2) >> 2
        }
    }
}
