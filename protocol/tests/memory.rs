//! Heap use of the decoders: never more than the stated limit, for any input.
//!
//! A test binary of its own, because it replaces the allocator.

use protocol::chunk_codec::{self, Effort, quantised, refined};
use protocol::limits::MAX_DECODE_MEMORY;
use protocol::message::{ClientMessage, ServerMessage};
use protocol::{ChunkError, Tolerance, control};
use terrain::{ChunkKey, Land, WorldDigest};
use test_support::counting_allocator::{CountingAllocator, peak_of};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Most bytes that were live at once during some work, beyond those before it.
fn peak<T>(work: impl FnOnce() -> T) -> usize {
    peak_of(work).0
}

/// Every decoder on one input. Whether one of them read what is behind a digest.
fn decode_all(frame: &[u8], world: &WorldDigest, parent: &terrain::Chunk) -> bool {
    let cap = MAX_DECODE_MEMORY;
    let spent = [
        peak(|| chunk_codec::decode(frame, world)),
        peak(|| quantised::decode(frame, world, Tolerance::COARSEST)),
        peak(|| refined::decode(frame, world, parent)),
        peak(|| chunk_codec::error(frame)),
        peak(|| control::decode::<ClientMessage>(frame)),
        peak(|| control::decode::<ServerMessage>(frame)),
    ];
    assert!(spent.iter().all(|bytes| *bytes <= cap), "{spent:?} of {cap} for {} bytes", frame.len());
    [
        chunk_codec::decode(frame, world),
        quantised::decode(frame, world, Tolerance::COARSEST),
        refined::decode(frame, world, parent),
    ]
    .into_iter()
    .any(|chunk| matches!(chunk, Ok(_) | Err(ChunkError::Part | ChunkError::Compression)))
}

/// [`decode_all`] on an input, and on the same with the digest that a hostile server would write.
/// Whether each read what is behind the digest.
fn decode_resealed(mut frame: Vec<u8>, world: &WorldDigest, parent: &terrain::Chunk) -> [bool; 2] {
    let raw = decode_all(&frame, world, parent);
    chunk_codec::rewrite_digest(&mut frame, world, Some(&parent.heights));
    [raw, decode_all(&frame, world, parent)]
}

#[test]
fn decoders_stay_within_the_memory_limit() {
    let land = Land::new(1);
    let world = land.digest();
    let chunk = land.chunk(ChunkKey::new(0, 3, -7).unwrap());
    let parent = land.chunk(chunk.key.parent().unwrap());
    let frames = [
        chunk_codec::encode(&chunk, &world),
        quantised::encode(&chunk, &world, Tolerance::FINEST, Effort::Fast).unwrap(),
        refined::encode(&chunk, &parent, &world, Effort::Compact).unwrap(),
    ];
    // The scratch memory of the thread is allocated here, once.
    frames.iter().for_each(|frame| {
        let _ = (chunk_codec::decode(frame, &world), quantised::decode(frame, &world, Tolerance::COARSEST));
        let _ = refined::decode(frame, &world, &parent);
    });
    assert!(peak(|| chunk_codec::decode(&frames[0], &world)) > 16_900, "the count sees a chunk's heights");
    assert!(peak(|| vec![0u8; MAX_DECODE_MEMORY + 1]) > MAX_DECODE_MEMORY, "the count sees too much");
    for frame in &frames {
        let mut read = [0; 2];
        let mut count = |lie: Vec<u8>| {
            let is_valid = lie == frame[..];
            let behind = decode_resealed(lie, &world, &parent);
            read = [0, 1].map(|index| read[index] + usize::from(behind[index] && !is_valid));
        };
        for length in 0..=frame.len() {
            count(frame[..length].to_vec());
        }
        for at in (0..256).chain((256..frame.len()).step_by(61)) {
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut lie = frame.to_vec();
                lie[at] = value;
                count(lie);
            }
        }
        // The control: without a valid digest no lie is read.
        assert!(read[0] == 0 && read[1] > frame.len(), "{read:?} lies were read");
    }
    for message in ["hello", "request", "welcome", "holding"] {
        let path = format!("{}/fixtures/{message}.hex", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).unwrap();
        let digits: Vec<_> = text.chars().filter_map(|digit| digit.to_digit(16)).collect();
        let good: Vec<u8> = digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect();
        for length in 0..=good.len() {
            decode_all(&good[..length], &world, &parent);
        }
        // Every aligned-or-not length field at its extremes: eight bytes at a time.
        for at in 6..good.len().saturating_sub(8) {
            for value in [0, 1, 512, 513, u64::from(u32::MAX), u64::MAX / 2, u64::MAX] {
                let mut lie = good.clone();
                lie[at..at + 8].copy_from_slice(&value.to_le_bytes());
                decode_all(&lie, &world, &parent);
            }
        }
    }
}
