//! The refined chunk frame, for receivers with the parent: only the vertices that the parent lacks.
//!
//! Up to level 2 a chunk's vertices in even columns and rows are those of its parent, bit for bit.
//! The others are predicted from both sides, with smaller residuals than those of the one-sided
//! plane predictor. First the vertices between two known ones in a row, then in a column, by
//! four-point interpolation (Deslauriers and Dubuc, "Symmetric iterative interpolation processes",
//! 1989: weights -1, 9, 9, -1 over 16); then the middles, by the patch through their eight
//! neighbours (Coons, 1967: half of the sides less a quarter of the corners).

use super::entropy::Effort;
use super::kernel::{self, Heights, Kernel, zigzag};
use super::parts::{self, Scratch};
use super::{Frame, KIND_REFINED, decode_frame, encode_frame};
use crate::error::ChunkError;
use crate::reference_window;
use bytes::Bytes;
use terrain::constants::{CELLS, HEIGHT_LIMIT, VERTEX_COUNT, VERTICES};
use terrain::{Chunk, ChunkKey, WorldDigest};

/// Vertices along a side that the parent has.
pub(super) const KNOWN: usize = CELLS / 2 + 1;

/// Vertices between two known ones, along a side.
const HALF: usize = CELLS / 2;

/// Vertices that the parent lacks.
const LACKING: usize = VERTEX_COUNT - KNOWN * KNOWN;

/// Encodes a chunk of a world for a receiver that has its parent; none if `parent` is not its
/// parent or does not have the chunk's vertices in even columns and rows.
#[must_use]
pub fn encode(chunk: &Chunk, parent: &Chunk, world: &WorldDigest, effort: Effort) -> Option<Bytes> {
    let known = Known::of(chunk.key, &parent.heights).filter(|_| chunk.key.parent() == Some(parent.key))?;
    (known == Known::in_chunk(&chunk.heights))
        .then(|| encode_frame(KIND_REFINED, chunk, world, 0, effort, Some(&known)))
}

/// As [`encode`] without the parent, for chunks of a land: if the parent's level is one of
/// [`reference_window::LEVELS`], the chunk's vertices in even columns and rows are the parent's.
/// None otherwise.
#[must_use]
pub fn encode_alone(chunk: &Chunk, world: &WorldDigest, effort: Effort) -> Option<Bytes> {
    let parent = chunk.key.parent()?;
    let known =
        reference_window::LEVELS.contains(&parent.level()).then(|| Known::in_chunk(&chunk.heights))?;
    Some(encode_frame(KIND_REFINED, chunk, world, 0, effort, Some(&known)))
}

/// Decodes one whole refined frame of a world with the chunk's parent.
///
/// # Errors
/// As [`super::decode`]; [`ChunkError::Parent`] if `parent` is the chunk of another key,
/// [`ChunkError::Digest`] if it is not the one that the frame was made from.
pub fn decode(frame: &[u8], world: &WorldDigest, parent: &Chunk) -> Result<Chunk, ChunkError> {
    let Frame { key, .. } = Frame::read(frame, KIND_REFINED)?;
    if key.parent() != Some(parent.key) {
        return Err(ChunkError::Parent(key));
    }
    decode_over(frame, world, &parent.heights)
}

/// As [`decode`], with the heights of the parent only.
///
/// # Errors
/// As [`decode`]; the digest rejects heights of another chunk.
pub fn decode_over(frame: &[u8], world: &WorldDigest, parent: &Heights) -> Result<Chunk, ChunkError> {
    let frame = Frame::read(frame, KIND_REFINED)?;
    let known = Known::of(frame.key, parent).ok_or(ChunkError::Parent(frame.key))?;
    decode_frame(&frame, world, None, Some(&known))
}

/// The vertices of a chunk that its parent has, row by row.
#[derive(PartialEq, Eq)]
pub(super) struct Known(Box<[i32; KNOWN * KNOWN]>);

impl Known {
    /// The quadrant of a parent that a chunk covers; none if the chunk has no parent.
    pub(super) fn of(key: ChunkKey, parent: &Heights) -> Option<Self> {
        let quadrant = key.parent()?.children()?.iter().position(|child| *child == key)?;
        let (x, z) = (quadrant % 2 * (KNOWN - 1), quadrant / 2 * (KNOWN - 1));
        let mut known = Box::new([0; KNOWN * KNOWN]);
        for (row, to) in known.as_chunks_mut::<KNOWN>().0.iter_mut().enumerate() {
            to.copy_from_slice(&parent[(z + row) * VERTICES + x..][..KNOWN]);
        }
        Some(Self(known))
    }

    /// The same as the chunk itself has them.
    fn in_chunk(heights: &Heights) -> Self {
        let mut known = Box::new([0; KNOWN * KNOWN]);
        let rows = heights.as_chunks::<VERTICES>().0.iter().step_by(2);
        for (to, row) in known.as_chunks_mut::<KNOWN>().0.iter_mut().zip(rows) {
            for (to, height) in to.iter_mut().zip(row.iter().step_by(2)) {
                *to = *height;
            }
        }
        Self(known)
    }

    /// The known heights as the digest covers them.
    pub(super) fn bytes(&self) -> [[u8; 4]; KNOWN * KNOWN] {
        self.0.map(i32::to_le_bytes)
    }

    /// Appends the parts of what the parent lacks. Returns the width of the residuals.
    pub(super) fn push(&self, kernel: Kernel, heights: &Heights, effort: Effort, out: &mut Vec<u8>) -> u32 {
        let lacking = Lacking::in_chunk(heights);
        let mut residuals = Vec::with_capacity(LACKING);
        for group in [Group::Rows, Group::Columns, Group::Middles] {
            for row in 0..group.rows() {
                let (actual, predicted) = (group.row(&lacking, row), group.predict(self, &lacking, row));
                let pairs = actual.iter().zip(&predicted);
                residuals.extend(pairs.map(|(height, predicted)| zigzag(height.wrapping_sub(*predicted))));
            }
        }
        let width = parts::width(residuals.iter().fold(0, |all, residual| all | residual));
        parts::push(kernel, &residuals, width, effort, out);
        width
    }

    /// Takes the parts of what the parent lacks off a payload and completes the heights.
    pub(super) fn take(
        &self,
        kernel: Kernel,
        scratch: &mut Scratch,
        width: u32,
        payload: &mut &[u8],
        heights: &mut Heights,
    ) -> Result<(), ChunkError> {
        let mut residuals = [0; LACKING];
        kernel::join(kernel, scratch.take(kernel, width, LACKING, payload)?.get(), &mut residuals);
        let mut lacking = Lacking::default();
        let mut residuals = &residuals[..];
        for group in [Group::Rows, Group::Columns, Group::Middles] {
            for row in 0..group.rows() {
                let predicted = group.predict(self, &lacking, row);
                let heights = group.row_mut(&mut lacking, row);
                let (of_row, rest) = residuals.split_at(heights.len());
                for ((height, predicted), residual) in heights.iter_mut().zip(&predicted).zip(of_row) {
                    *height = predicted.wrapping_add(*residual);
                }
                residuals = rest;
            }
        }
        self.interleave(&lacking, heights);
        if heights.iter().fold(false, |any, height| any | (height.unsigned_abs() >= HEIGHT_LIMIT as u32)) {
            return Err(ChunkError::Content("a height is out of range"));
        }
        Ok(())
    }

    /// A row of known vertices.
    fn row(&self, row: usize) -> &[i32; KNOWN] {
        &self.0.as_chunks().0[row]
    }

    /// Puts known and lacking vertices where they belong.
    fn interleave(&self, lacking: &Lacking, heights: &mut Heights) {
        for (z, to) in heights.as_chunks_mut::<VERTICES>().0.iter_mut().enumerate() {
            let half = z / 2;
            let (even, odd) = match z % 2 {
                0 => (self.row(half), &lacking.rows[half]),
                _ => (&lacking.columns[half], &lacking.middles[half]),
            };
            for ((pair, even), odd) in to.as_chunks_mut::<2>().0.iter_mut().zip(even).zip(odd) {
                *pair = [*even, *odd];
            }
            to[CELLS] = even[KNOWN - 1];
        }
    }
}

/// The vertices that the parent lacks, in one array per kind of position.
struct Lacking {
    /// Between two known vertices of a row.
    rows: [[i32; HALF]; KNOWN],
    /// Between two known vertices of a column.
    columns: [[i32; KNOWN]; HALF],
    /// Between four known vertices.
    middles: [[i32; HALF]; HALF],
}

impl Default for Lacking {
    fn default() -> Self {
        Self { rows: [[0; HALF]; KNOWN], columns: [[0; KNOWN]; HALF], middles: [[0; HALF]; HALF] }
    }
}

impl Lacking {
    fn in_chunk(heights: &Heights) -> Self {
        let mut lacking = Self::default();
        for (z, row) in heights.as_chunks::<VERTICES>().0.iter().enumerate() {
            let half = z / 2;
            let odd = match z % 2 {
                0 => &mut lacking.rows[half],
                _ => {
                    let even = row.iter().step_by(2);
                    lacking.columns[half].iter_mut().zip(even).for_each(|(to, height)| *to = *height);
                    &mut lacking.middles[half]
                }
            };
            odd.iter_mut().zip(row[1..].iter().step_by(2)).for_each(|(to, height)| *to = *height);
        }
        lacking
    }
}

/// Which of [`Lacking`]'s vertices, in the order in which they are coded: those of a group are
/// predicted from the groups before it alone.
#[derive(Clone, Copy)]
enum Group {
    Rows,
    Columns,
    Middles,
}

impl Group {
    const fn rows(self) -> usize {
        match self {
            Self::Rows => KNOWN,
            Self::Columns | Self::Middles => HALF,
        }
    }

    fn row(self, lacking: &Lacking, row: usize) -> &[i32] {
        match self {
            Self::Rows => &lacking.rows[row],
            Self::Columns => &lacking.columns[row],
            Self::Middles => &lacking.middles[row],
        }
    }

    fn row_mut(self, lacking: &mut Lacking, row: usize) -> &mut [i32] {
        match self {
            Self::Rows => &mut lacking.rows[row],
            Self::Columns => &mut lacking.columns[row],
            Self::Middles => &mut lacking.middles[row],
        }
    }

    /// Predictions of the vertices of a row from their neighbours. Rows and middles have one less
    /// than is returned; the last means nothing there.
    fn predict(self, known: &Known, lacking: &Lacking, row: usize) -> [i32; KNOWN] {
        let mut predicted = [0; KNOWN];
        match self {
            Self::Rows => {
                let known = known.row(row);
                let sum = |place: usize| known[place].wrapping_add(known[place + 1]);
                for (place, predicted) in predicted[..HALF].iter_mut().enumerate() {
                    // The outermost have one neighbour a side.
                    let is_inner = (1..HALF - 1).contains(&place);
                    let far =
                        if is_inner { known[place - 1].wrapping_add(known[place + 2]) } else { sum(place) };
                    *predicted = between(sum(place), far);
                }
            }
            Self::Columns => {
                let (above, below) = (known.row(row), known.row(row + 1));
                let is_inner = (1..HALF - 1).contains(&row);
                let (far_above, far_below) =
                    if is_inner { (known.row(row - 1), known.row(row + 2)) } else { (above, below) };
                for (place, predicted) in predicted.iter_mut().enumerate() {
                    let near = above[place].wrapping_add(below[place]);
                    *predicted = between(near, far_above[place].wrapping_add(far_below[place]));
                }
            }
            Self::Middles => {
                let (above, below) = (known.row(row), known.row(row + 1));
                let (sides, over, under) =
                    (&lacking.columns[row], &lacking.rows[row], &lacking.rows[row + 1]);
                for (place, predicted) in predicted[..HALF].iter_mut().enumerate() {
                    let pair = |row: &[i32; KNOWN]| row[place].wrapping_add(row[place + 1]);
                    let sides = pair(sides).wrapping_add(over[place].wrapping_add(under[place]));
                    let corners = pair(above).wrapping_add(pair(below));
                    *predicted = sides.wrapping_mul(2).wrapping_sub(corners).wrapping_add(2) >> 2;
                }
            }
        }
        predicted
    }
}

/// Four points of a line by the sums of the near two and the far two.
const fn between(near: i32, far: i32) -> i32 {
    near.wrapping_mul(9).wrapping_sub(far).wrapping_add(8) >> 4
}
