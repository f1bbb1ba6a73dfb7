//! Wrong chunks of a server, as frames.

use bytes::Bytes;
use protocol::{Delivery, chunk_codec};
use terrain::{Chunk, ChunkKey, Land};

/// The fault of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChunkFault {
    /// One height is off by one unit; digest, extremes and pyramids are made to fit.
    Height,
    /// The measured error is off by one unit; the digest is made to fit.
    Error,
    /// A bit of the header is flipped.
    Bit,
    /// A correct chunk of another position, which no view over the home island needs.
    Place,
}

/// The frame of a chunk with a fault, or the correct one.
///
/// # Panics
/// The column of the key is no column of level 0.
#[must_use]
pub fn frame(fault: Option<ChunkFault>, land: &Land, key: ChunkKey, delivery: Delivery) -> Bytes {
    let mut chunk = match fault {
        Some(ChunkFault::Place) => {
            land.chunk(ChunkKey::new(0, -30_000, key.x()).expect("a column of level 0"))
        }
        _ => land.chunk(key),
    };
    match fault {
        Some(ChunkFault::Height) => {
            chunk.heights[2000] += 1;
            chunk = Chunk::from_parts(chunk.key, chunk.heights, chunk.error, chunk.grass);
        }
        Some(ChunkFault::Error) => chunk.error += 1,
        Some(ChunkFault::Bit | ChunkFault::Place) | None => {}
    }
    let frame = chunk_codec::encode_for(delivery, &chunk, &land.digest());
    if fault != Some(ChunkFault::Bit) {
        return frame;
    }
    let mut damaged = frame.to_vec();
    damaged[30] ^= 1;
    damaged.into()
}
