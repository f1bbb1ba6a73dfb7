//! Checks of a chunk beyond those of the protocol's decoder (digest, key, ranges, extremes).
//! Pyramids are not sent: the decoder makes them.
//!
//! Pure functions of a chunk. Which chunks may arrive is decided in [`crate::expected`].

use protocol::Delivery;
use protocol::chunk_codec::quantised;
use terrain::constants::{GENERATOR_VERSION, VERTICES};
use terrain::{Chunk, ChunkKey, Land, WorldDigest};
use thiserror::Error;

/// Invalid data from the server.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Mismatch {
    /// The key was not requested, and no view that was sent needs it.
    #[error("chunk {0} was neither requested nor needed by a view")]
    Unexpected(ChunkKey),
    /// A view was reported complete without all its chunks.
    #[error("view {view} settled at {settled} of {needed} chunks; {missing} were neither sent nor refused")]
    Incomplete {
        /// Its id.
        view: u32,
        /// Chunks that the server counts.
        settled: u32,
        /// Chunks that the view needs.
        needed: usize,
        /// Of these, neither held nor refused.
        missing: usize,
    },
    /// The chunk differs from local generation.
    #[error("chunk {key} differs from local generation: {what}")]
    Generation {
        /// The chunk.
        key: ChunkKey,
        /// The first difference.
        what: String,
    },
    /// The announced digest is not that of the announced seed.
    #[error("the server announces world {announced} for seed {seed}; local generation gives {ours}")]
    World {
        /// The announced digest.
        announced: WorldDigest,
        /// The announced seed.
        seed: u64,
        /// The digest of that seed here.
        ours: WorldDigest,
    },
    /// The announced world is not the one that the run began with.
    #[error("expected world {first}, got {now}: the server changed during the run")]
    OtherWorld {
        /// The digest that was announced first.
        first: WorldDigest,
        /// The digest that is announced now.
        now: WorldDigest,
    },
    /// The server has another generator version, so nothing can be compared.
    #[error(
        "generator version differs: server {theirs}, this tool {GENERATOR_VERSION}; update the older one"
    )]
    Generator {
        /// The announced version.
        theirs: u32,
    },
}

/// Compares a chunk with local generation, quantised the same way if it was: heights, error, slope,
/// pyramids and grass.
///
/// # Errors
/// The first difference.
pub fn regeneration(land: &Land, chunk: &Chunk, delivery: Delivery) -> Result<(), Mismatch> {
    let mut ours = land.chunk(chunk.key);
    if let Delivery::Quantised(tolerance) = delivery {
        ours = quantised::quantise(&ours, tolerance).unwrap_or(ours);
    }
    if ours == *chunk {
        return Ok(());
    }
    let what = match ours.heights.iter().zip(&chunk.heights[..]).position(|(ours, theirs)| ours != theirs) {
        Some(vertex) => {
            let (column, row) = (vertex % VERTICES, vertex / VERTICES);
            let (ours, theirs) = (ours.heights[vertex], chunk.heights[vertex]);
            format!("vertex ({column}, {row}) is {theirs} units, here {ours}")
        }
        None if ours.error != chunk.error => format!("error is {} units, here {}", chunk.error, ours.error),
        None if ours.grass != chunk.grass => "the grass record".into(),
        None => "slope or pyramids".into(),
    };
    Err(Mismatch::Generation { key: chunk.key, what })
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::constants::VERTEX_COUNT;

    fn land() -> Land {
        Land::new(1)
    }

    /// The difference to local generation.
    fn difference(chunk: &Chunk) -> String {
        match regeneration(&land(), chunk, Delivery::Exact) {
            Err(Mismatch::Generation { what, .. }) => what,
            other => panic!("{other:?}"),
        }
    }

    fn chunk(level: u8, x: i32, z: i32) -> Chunk {
        land().chunk(ChunkKey::new(level, x, z).unwrap())
    }

    /// A chunk with another height and everything that derives from it.
    fn with_wrong_height(chunk: &Chunk, vertex: usize) -> Chunk {
        let mut heights = chunk.heights.clone();
        heights[vertex] += 1;
        Chunk::from_parts(chunk.key, heights, chunk.error, chunk.grass.clone())
    }

    #[test]
    fn correct_chunks_pass_at_every_level() {
        for level in 0..=16 {
            let correct = chunk(level, 0, 0);
            assert_eq!(regeneration(&land(), &correct, Delivery::Exact), Ok(()));
        }
    }

    #[test]
    fn a_wrong_height_is_found_by_local_generation() {
        let correct = chunk(0, 3, -7);
        for vertex in [0, 64, VERTICES * 10 + 7, VERTEX_COUNT - 1] {
            let wrong = with_wrong_height(&correct, vertex);
            let Err(Mismatch::Generation { what, .. }) = regeneration(&land(), &wrong, Delivery::Exact)
            else {
                panic!("vertex {vertex} passed");
            };
            assert!(what.contains(&format!("({}, {})", vertex % VERTICES, vertex / VERTICES)), "{what}");
        }
    }

    #[test]
    fn wrong_errors_and_grass_are_found_by_local_generation() {
        let mut wrong = chunk(2, 1, 1);
        wrong.error += 1;
        assert!(difference(&wrong).contains("error"));
        let mut wrong = chunk(0, 3, -7);
        wrong.grass.seed ^= 1;
        assert!(difference(&wrong).contains("grass"));
    }
}
