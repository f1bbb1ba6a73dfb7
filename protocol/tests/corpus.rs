//! Every decoder against a committed corpus, whole and mutated.
//!
//! The corpus is the frozen frames under `fixtures/`. The short run mutates each for a fixed number
//! of rounds from a fixed seed; the long one is
//! `TOMBOLO_FUZZ_ROUNDS=100000000 cargo test --release -p tombolo-protocol --test corpus`, and
//! `TOMBOLO_FUZZ_SEED` selects other mutations. A failure prints the bytes of its frame.

use protocol::chunk_codec::{
    self, KIND_EXACT, KIND_QUANTISED, KIND_REFINED, Kernel, quantised, refined, seed_only,
};
use protocol::limits::{CHUNK_HEADER, MAX_CHUNK_FRAME};
use protocol::message::{ClientMessage, ServerMessage};
use protocol::{ChunkError, Tolerance, control};
use std::panic::{AssertUnwindSafe, catch_unwind};
use terrain::constants::VERTEX_COUNT;
use terrain::hash::mix;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// Rounds of the short run; a second or two.
const ROUNDS: u32 = 20_000;

fn number(name: &str, otherwise: u32) -> u32 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name}: `{text}`")))
}

/// The frozen frames, including those of older versions, in the order of their names.
fn corpus() -> Vec<Vec<u8>> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let folders = [folder.clone(), folder.join("version_1"), folder.join("version_2")];
    let mut paths: Vec<_> = folders
        .iter()
        .flat_map(|folder| std::fs::read_dir(folder).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "hex"))
        .collect();
    paths.sort();
    let read = |path| {
        let text = std::fs::read_to_string(path).unwrap();
        let digits: Vec<_> = text.chars().filter_map(|digit| digit.to_digit(16)).collect();
        digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect()
    };
    paths.into_iter().map(read).collect()
}

/// Pseudorandom numbers from a seed.
struct Random(u32);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9);
        mix(self.0) as usize % limit.max(1)
    }
}

/// One mutation: bits, bytes, extremes, cuts, copies, and pieces of other frames.
fn mutate(frame: &mut Vec<u8>, corpus: &[Vec<u8>], random: &mut Random) {
    for _ in 0..=random.below(4) {
        // Below the length, or 0 in an empty frame.
        let at = random.below(frame.len());
        match random.below(7) {
            0 if !frame.is_empty() => frame[at] ^= 1u8 << random.below(8),
            1 if !frame.is_empty() => frame[at] = random.below(256) as u8,
            2 => frame.truncate(at),
            3 => frame.insert(at, random.below(256) as u8),
            4 => {
                let extremes = [0u32, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX];
                let word = extremes[random.below(extremes.len())].to_le_bytes();
                let length = random.below(5).min(frame.len() - at);
                frame[at..][..length].copy_from_slice(&word[..length]);
            }
            5 => {
                let other = &corpus[random.below(corpus.len())];
                let from = random.below(other.len());
                frame.truncate(at);
                frame.extend_from_slice(&other[from..]);
            }
            _ => {
                let piece = frame[at..].to_vec();
                frame.extend_from_slice(&piece[..piece.len().min(random.below(64))]);
            }
        }
        frame.truncate(MAX_CHUNK_FRAME + 1);
    }
}

/// The kind of a frame with heights whose decoder reads what is behind the digest: with another
/// digest it rejects the digest, with this one it does not.
fn read_kind(frame: &[u8], world: &WorldDigest, parent: &Chunk) -> Option<u8> {
    let (kind, _) = chunk_codec::kind_and_key(frame).ok()?;
    let fails = |frame: &[u8]| {
        let decoded = match kind {
            KIND_EXACT => chunk_codec::decode(frame, world),
            KIND_QUANTISED => quantised::decode(frame, world, Tolerance::COARSEST),
            _ => refined::decode_over(frame, world, &parent.heights),
        };
        decoded == Err(ChunkError::Digest)
    };
    let mut other = frame.to_vec();
    *other.get_mut(CHUNK_HEADER - 1)? ^= 1;
    (!fails(frame) && fails(&other)).then_some(kind)
}

/// Passes bytes to every decoder. A returned chunk satisfies its invariants.
fn decode_all(frame: &[u8], land: &Land, world: &WorldDigest, parent: &Chunk) -> usize {
    let (mut heights, mut accepted) = (Box::new([0; VERTEX_COUNT]), 0);
    let _ = chunk_codec::heights_on(Kernel::best(), frame, &mut heights);
    for chunk in [
        chunk_codec::decode(frame, world),
        quantised::decode(frame, world, Tolerance::COARSEST),
        refined::decode_over(frame, world, &parent.heights),
        seed_only::decode(frame, land, world),
    ]
    .into_iter()
    .flatten()
    {
        let again = Chunk::from_parts(chunk.key, chunk.heights.clone(), chunk.error, chunk.grass.clone());
        assert_eq!(again, chunk);
        accepted += 1;
    }
    let (from_client, from_server) =
        (control::decode::<ClientMessage>(frame), control::decode::<ServerMessage>(frame));
    // Decoded messages are encoded as the same bytes.
    if let Ok(message) = from_client {
        assert_eq!(control::encode(&message).unwrap(), frame);
        accepted += 1;
    }
    if let Ok(message) = from_server {
        assert_eq!(control::encode(&message).unwrap(), frame);
        accepted += 1;
    }
    accepted
}

#[test]
fn no_mutated_frame_causes_a_panic_or_breaks_an_invariant() {
    let land = Land::new(42);
    let world = land.digest();
    let parent = land.chunk(ChunkKey::new(2, -3, 1).unwrap());
    let corpus = corpus();
    assert!(corpus.len() > 20, "{} frames", corpus.len());
    let whole: usize = corpus.iter().map(|frame| decode_all(frame, &land, &world, &parent)).sum();
    assert!(whole > 15, "{whole} of {} frozen frames are decoded", corpus.len());

    let seed = number("TOMBOLO_FUZZ_SEED", 1);
    let (mut random, mut accepted, mut read) = (Random(mix(seed)), 0, [0; 4]);
    let rounds = number("TOMBOLO_FUZZ_ROUNDS", ROUNDS);
    for round in 0..rounds {
        let mut frame = corpus[random.below(corpus.len())].clone();
        mutate(&mut frame, &corpus, &mut random);
        if frame.starts_with(&chunk_codec::MAGIC) && random.below(4) > 0 {
            chunk_codec::rewrite_digest(&mut frame, &world, Some(&parent.heights));
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| decode_all(&frame, &land, &world, &parent)));
        accepted += outcome.unwrap_or_else(|_| {
            let bytes: String = frame.iter().map(|byte| format!("{byte:02x}")).collect();
            panic!("round {round} of seed {seed}: {bytes}")
        });
        if let Some(kind) = read_kind(&frame, &world, &parent) {
            read[usize::from(kind)] += 1;
        }
    }
    // Some mutations pass the digest: the run covers the code behind it, of every kind.
    assert!(accepted > 0, "no mutation was accepted; the run covers the digest only");
    for kind in [KIND_EXACT, KIND_QUANTISED, KIND_REFINED] {
        let count = read[usize::from(kind)];
        assert!(count >= rounds / 200, "{count} mutations of kind {kind} were read of {rounds}");
    }
    println!("{read:?} mutations were read behind the digest");
}
