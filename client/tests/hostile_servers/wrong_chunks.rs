//! Chunks that a server must not send.

use crate::server;
use bytes::Bytes;
use protocol::chunk_codec;
use protocol::limits::CHUNK_HEADER;
use terrain::{Chunk, ChunkKey};

pub type Wrong = fn(ChunkKey) -> Option<Bytes>;

/// Wrong chunks, with what the viewer says of them.
pub const WRONG_CHUNKS: [(&str, Wrong, &str); 9] = [
    ("wrong key", wrong_key, "neither requested nor needed"),
    ("wrong digest", with_wrong_digest, "digest"),
    ("out of range", with_absurd_error, "larger than the range"),
    ("decompression bomb", bomb, "decompress"),
    ("another version", |key| changed(key, 4), "version"),
    ("cut off", |key| Some(server::correct(key).slice(..40)), "truncated"),
    ("swapped extremes", swapped_extremes, "extremes"),
    ("a header of NaN", nan_header, "breaks a rule"),
    ("a payload of NaN", nan_payload, "cut off"),
];

fn changed(key: ChunkKey, at: usize) -> Option<Bytes> {
    let mut frame = server::correct(key).to_vec();
    frame[at] ^= 0x40;
    Some(frame.into())
}

pub fn far_away() -> ChunkKey {
    ChunkKey::new(0, 30_000, 30_000).unwrap()
}

pub fn with_wrong_digest(key: ChunkKey) -> Option<Bytes> {
    let mut frame = server::correct(key).to_vec();
    frame[CHUNK_HEADER + 9] ^= 1;
    Some(frame.into())
}

fn with_absurd_error(key: ChunkKey) -> Option<Bytes> {
    Some(server::frame_of(&Chunk { error: u32::MAX, ..server::land().chunk(key) }))
}

/// Run-length blocks that decompress to 115 MiB, RFC 8878 section 3.1.1.2.
fn bomb(key: ChunkKey) -> Option<Bytes> {
    let frame = server::correct(key);
    let runs = [[0x02, 0x00, 0x10, 0xaa].repeat(899), vec![0x03, 0x00, 0x10, 0xaa]].concat();
    let part = [&[0x28, 0xb5, 0x2f, 0xfd, 0xa0, 0xff, 0xff, 0xff, 0xff], &runs[..]].concat();
    let grass = &frame[CHUNK_HEADER..CHUNK_HEADER + 5];
    let payload = [grass, &[0], &(part.len() as u16).to_le_bytes(), &part].concat();
    Some(server::with_payload(&frame, &payload))
}

pub fn wrong_key(_: ChunkKey) -> Option<Bytes> {
    Some(server::correct(far_away()))
}

/// Lowest and highest height in each other's place, with a digest that fits.
fn swapped_extremes(key: ChunkKey) -> Option<Bytes> {
    let mut frame = server::correct(key).to_vec();
    let (lowest, highest) = (20..24, 24..28);
    let [low, high] = [lowest.clone(), highest.clone()].map(|field| frame[field].to_vec());
    assert_ne!(low, high, "{key} has relief");
    frame[lowest].copy_from_slice(&high);
    frame[highest].copy_from_slice(&low);
    Some(resealed(frame))
}

/// Patterns of NaN in place of the payload, or of all numbers of the header, with a digest that
/// fits.
fn nan_payload(key: ChunkKey) -> Option<Bytes> {
    let mut frame = server::correct(key).to_vec();
    for (byte, pattern) in frame[CHUNK_HEADER..].iter_mut().zip(NAN.into_iter().cycle()) {
        *byte = pattern;
    }
    Some(resealed(frame))
}

fn nan_header(key: ChunkKey) -> Option<Bytes> {
    let mut frame = server::correct(key).to_vec();
    for number in frame[16..36].chunks_exact_mut(4) {
        number.copy_from_slice(&NAN);
    }
    Some(resealed(frame))
}

/// The quiet NaN of a 32-bit float.
const NAN: [u8; 4] = 0x7fc0_0000_u32.to_le_bytes();

fn resealed(mut frame: Vec<u8>) -> Bytes {
    chunk_codec::rewrite_digest(&mut frame, &server::land().digest(), None);
    frame.into()
}

/// The chunk of a key with other heights.
pub fn with_heights(key: ChunkKey, height: impl Fn(i32) -> i32) -> Option<Bytes> {
    let Chunk { mut heights, error, grass, .. } = server::land().chunk(key);
    heights.iter_mut().for_each(|value| *value = height(*value));
    Some(server::frame_of(&Chunk::from_parts(key, heights, error, grass)))
}
