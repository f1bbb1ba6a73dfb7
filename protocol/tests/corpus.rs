//! Every decoder against a committed corpus, whole and mutated.
//!
//! The corpus is the frozen frames under `fixtures/`. The short run mutates each for a fixed number
//! of rounds from a fixed seed; the long one is
//! `TOMBOLO_FUZZ_ROUNDS=100000000 cargo test --release -p protocol --test corpus`, and
//! `TOMBOLO_FUZZ_SEED` continues where an earlier one has not been. A finding prints the bytes that
//! make it.

use protocol::chunk_codec::{self, Kernel, quantised, refined, seed_only};
use protocol::limits::{CHUNK_HEADER, MAX_CHUNK_FRAME};
use protocol::message::{ClientMessage, ServerMessage};
use protocol::{Tolerance, control};
use std::panic::{AssertUnwindSafe, catch_unwind};
use terrain::constants::VERTEX_COUNT;
use terrain::hash::mix;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// Rounds of the short run; a second or two.
const ROUNDS: u32 = 20_000;

fn number(name: &str, otherwise: u32) -> u32 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name}: `{text}`")))
}

/// The frozen frames, older versions' too, in the order of their names.
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

/// A stream of numbers from a seed.
struct Dice(u32);

impl Dice {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9);
        mix(self.0) as usize % limit.max(1)
    }
}

/// What fuzzers do: bits, bytes, extremes, cuts, copies, and pieces of other frames.
fn mutate(frame: &mut Vec<u8>, corpus: &[Vec<u8>], dice: &mut Dice) {
    for _ in 0..=dice.below(4) {
        // Below the length, or 0 in an empty frame.
        let at = dice.below(frame.len());
        match dice.below(7) {
            0 if !frame.is_empty() => frame[at] ^= 1u8 << dice.below(8),
            1 if !frame.is_empty() => frame[at] = dice.below(256) as u8,
            2 => frame.truncate(at),
            3 => frame.insert(at, dice.below(256) as u8),
            4 => {
                let extremes = [0u32, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX];
                let word = extremes[dice.below(extremes.len())].to_le_bytes();
                let length = dice.below(5).min(frame.len() - at);
                frame[at..][..length].copy_from_slice(&word[..length]);
            }
            5 => {
                let other = &corpus[dice.below(corpus.len())];
                let from = dice.below(other.len());
                frame.truncate(at);
                frame.extend_from_slice(&other[from..]);
            }
            _ => {
                let piece = frame[at..].to_vec();
                frame.extend_from_slice(&piece[..piece.len().min(dice.below(64))]);
            }
        }
        frame.truncate(MAX_CHUNK_FRAME + 1);
    }
}

/// Signs a chunk frame with heights anew, as a hostile server does; without it the digest stops
/// nearly everything.
fn sign(frame: &mut [u8], world: &WorldDigest) {
    if frame.len() < CHUNK_HEADER {
        return;
    }
    let payload = (frame.len() - CHUNK_HEADER) as u32;
    frame[40..44].copy_from_slice(&payload.to_le_bytes());
    let mut hasher = blake3::Hasher::new();
    hasher.update(&world.0).update(&frame[..44]).update(&frame[CHUNK_HEADER..]);
    frame[44..CHUNK_HEADER].copy_from_slice(&hasher.finalize().as_bytes()[..16]);
}

/// Gives bytes to every decoder. A chunk that comes back keeps its promises.
fn decode_all(frame: &[u8], land: &Land, world: &WorldDigest, parent: &Chunk) -> usize {
    let (mut heights, mut accepted) = (Box::new([0; VERTEX_COUNT]), 0);
    let _ = chunk_codec::heights_on(Kernel::best(), frame, &mut heights);
    for chunk in [
        chunk_codec::decode(frame, world),
        quantised::decode(frame, world, Tolerance::COARSEST),
        refined::decode(frame, world, parent),
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
    // What is understood is said again in the same bytes.
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
fn no_mutation_of_any_frozen_frame_panics_or_breaks_a_promise() {
    let land = Land::new(42);
    let world = land.digest();
    let parent = land.chunk(ChunkKey::new(2, -3, 1).unwrap());
    let corpus = corpus();
    assert!(corpus.len() > 20, "{} frames", corpus.len());
    let whole: usize = corpus.iter().map(|frame| decode_all(frame, &land, &world, &parent)).sum();
    assert!(whole > 15, "{whole} of {} frozen frames are understood", corpus.len());

    let seed = number("TOMBOLO_FUZZ_SEED", 1);
    let (mut dice, mut accepted) = (Dice(mix(seed)), 0);
    for round in 0..number("TOMBOLO_FUZZ_ROUNDS", ROUNDS) {
        let mut frame = corpus[dice.below(corpus.len())].clone();
        mutate(&mut frame, &corpus, &mut dice);
        if frame.starts_with(&chunk_codec::MAGIC) && dice.below(4) > 0 {
            sign(&mut frame, &world);
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| decode_all(&frame, &land, &world, &parent)));
        accepted += outcome.unwrap_or_else(|_| {
            let bytes: String = frame.iter().map(|byte| format!("{byte:02x}")).collect();
            panic!("round {round} of seed {seed}: {bytes}")
        });
    }
    // Some get past the digest: the run looks behind it too.
    assert!(accepted > 0, "nothing mutated was accepted; the run looks at the surface only");
}
