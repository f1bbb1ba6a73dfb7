//! Packs: the exact frames of the 256 chunks of a tile in one object. An object of its own for each
//! chunk of 4 KB would cost more in requests than in bytes.
//!
//! | offset | type | meaning |
//! | --- | --- | --- |
//! | 0 | 4 bytes | `TMBP` |
//! | 4 | u16 | format version, 1 |
//! | 6 | u16 | level |
//! | 8 | i32 | tile x |
//! | 12 | i32 | tile z |
//! | 16 | 32 bytes | digest: blake3 over the world digest, bytes 0 to 15, and all from 48 on |
//! | 48 | 257 u32 | offsets of the frames from the start, and the end; equal ones are no frame |
//! | 1076 | | frames, row by row from the low corner, x fastest |
//!
//! Little-endian. The index stands first: not every store returns a range from the end.

use super::tile::{CHUNKS, PackTile};
use bytes::{BufMut, Bytes, BytesMut};
use protocol::limits::MAX_CHUNK_FRAME;
use std::ops::Range;
use terrain::WorldDigest;

const MAGIC: &[u8; 4] = b"TMBP";
const VERSION: u16 = 1;
const PREFIX: usize = 16;
const DIGEST_END: usize = 48;

/// Bytes before the frames.
pub const HEADER: usize = DIGEST_END + 4 * (CHUNKS + 1);

/// Longest pack.
pub const MAX_PACK: usize = HEADER + CHUNKS * MAX_CHUNK_FRAME;

/// Where the frames of a pack are.
#[derive(Debug)]
pub struct PackIndex {
    offsets: Vec<u32>,
}

/// Why bytes are no pack.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PackError {
    /// Too short, another magic, version or tile.
    #[error("no pack of this tile")]
    Header,
    /// Offsets that are out of order or frames that are too long.
    #[error("an invalid index")]
    Index,
    /// The digest is not that of the content.
    #[error("damaged, or of another world")]
    Digest,
}

/// The pack of a tile from the frames of its chunks in order; none where there is no chunk.
///
/// # Panics
/// Never with frames of the protocol's length.
#[must_use]
pub fn encode(world: &WorldDigest, tile: PackTile, frames: &[Option<Bytes>]) -> Bytes {
    let mut bytes = BytesMut::with_capacity(HEADER + frames.iter().flatten().map(Bytes::len).sum::<usize>());
    bytes.put_slice(MAGIC);
    bytes.put_u16_le(VERSION);
    bytes.put_u16_le(tile.level.into());
    bytes.put_i32_le(tile.x);
    bytes.put_i32_le(tile.z);
    bytes.put_bytes(0, DIGEST_END - PREFIX);
    let mut offset = HEADER as u32;
    for index in 0..=CHUNKS {
        bytes.put_u32_le(offset);
        let frame = frames.get(index).and_then(Option::as_ref);
        offset += frame.map_or(0, |frame| frame.len() as u32);
    }
    frames.iter().flatten().for_each(|frame| bytes.put_slice(frame));
    let digest = digest(world, &bytes);
    bytes[PREFIX..DIGEST_END].copy_from_slice(&digest);
    bytes.freeze()
}

fn digest(world: &WorldDigest, bytes: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&world.0).update(&bytes[..PREFIX]).update(&bytes[DIGEST_END..]);
    *hasher.finalize().as_bytes()
}

/// The index in the first [`HEADER`] bytes of the pack of a tile. Frames are not checked.
///
/// # Errors
/// Bytes that are no such header.
pub fn index(tile: PackTile, header: &[u8]) -> Result<PackIndex, PackError> {
    let header: &[u8; HEADER] = header.first_chunk().ok_or(PackError::Header)?;
    let number = |at: usize| i32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let expected = [&MAGIC[..], &VERSION.to_le_bytes(), &u16::from(tile.level).to_le_bytes()].concat();
    if header[..8] != expected || number(8) != tile.x || number(12) != tile.z {
        return Err(PackError::Header);
    }
    let offsets: Vec<u32> = (0..=CHUNKS).map(|entry| number(DIGEST_END + 4 * entry) as u32).collect();
    let is_frame = |pair: &[u32]| pair[0] <= pair[1] && (pair[1] - pair[0]) as usize <= MAX_CHUNK_FRAME;
    if offsets[0] as usize != HEADER || !offsets.windows(2).all(is_frame) {
        return Err(PackError::Index);
    }
    Ok(PackIndex { offsets })
}

/// Checks a whole pack.
///
/// # Errors
/// It is not one, damaged, or of another world or tile.
pub fn verify(world: &WorldDigest, tile: PackTile, bytes: &[u8]) -> Result<PackIndex, PackError> {
    let index = index(tile, bytes)?;
    if index.end() != bytes.len() as u64 || digest(world, bytes) != bytes[PREFIX..DIGEST_END] {
        return Err(PackError::Digest);
    }
    Ok(index)
}

impl PackIndex {
    /// Length of the pack.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.offsets[CHUNKS].into()
    }

    /// The bytes of a chunk's frame in the pack; none if it has none.
    #[must_use]
    pub fn frame(&self, index: usize) -> Option<Range<u64>> {
        let range = u64::from(*self.offsets.get(index)?)..u64::from(*self.offsets.get(index + 1)?);
        (!range.is_empty()).then_some(range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORLD: WorldDigest = WorldDigest([7; 32]);
    const TILE: PackTile = PackTile { level: 2, x: -3, z: 5 };

    fn pack() -> Bytes {
        let frames: Vec<_> =
            (0..CHUNKS).map(|n| (n % 3 > 0).then(|| Bytes::from(vec![n as u8; 10 + n]))).collect();
        encode(&WORLD, TILE, &frames)
    }

    #[test]
    fn every_frame_is_found_by_the_header_alone() {
        let pack = pack();
        let index = index(TILE, &pack[..HEADER]).unwrap();
        for n in 0..CHUNKS {
            let frame = index.frame(n).map(|range| &pack[range.start as usize..range.end as usize]);
            assert_eq!(frame, (n % 3 > 0).then(|| vec![n as u8; 10 + n]).as_deref());
        }
        assert_eq!(index.frame(CHUNKS), None);
        assert!(verify(&WORLD, TILE, &pack).is_ok());
    }

    #[test]
    fn any_changed_byte_another_tile_or_world_is_an_error() {
        let pack = pack();
        for at in (0..pack.len()).step_by(7).chain(0..HEADER) {
            let mut damaged = pack.to_vec();
            damaged[at] ^= 0x40;
            assert!(verify(&WORLD, TILE, &damaged).is_err(), "byte {at}");
        }
        assert_eq!(verify(&WorldDigest([8; 32]), TILE, &pack).unwrap_err(), PackError::Digest);
        assert_eq!(verify(&WORLD, PackTile { x: 0, ..TILE }, &pack).unwrap_err(), PackError::Header);
        for length in [0, 3, HEADER - 1, HEADER, pack.len() - 1] {
            assert!(verify(&WORLD, TILE, &pack[..length]).is_err(), "{length} bytes");
        }
    }
}
