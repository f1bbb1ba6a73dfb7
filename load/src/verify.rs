//! What a chunk must satisfy beyond the checks of the protocol's decoder (digest, key, ranges,
//! extremes).
//!
//! Pure functions of a chunk. Which chunks may arrive is decided in [`crate::expected`].

use protocol::Delivery;
use protocol::chunk_codec::quantised;
use terrain::constants::{CELLS, GENERATOR_VERSION, VERTEX_COUNT, VERTICES};
use terrain::pyramid::{PYRAMID_LEVELS, side};
use terrain::{Chunk, ChunkKey, Land, WorldDigest};
use thiserror::Error;

/// Invalid data from the server.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Mismatch {
    /// The key was not requested, and no view that was sent needs it.
    #[error("chunk {0} was neither requested nor needed by a view")]
    Unexpected(ChunkKey),
    /// A view was reported complete without all its chunks.
    #[error("view {view} is settled with {settled} chunks of {needed}, of which {missing} never came")]
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
    /// A texel of a pyramid is no bound.
    #[error("chunk {key}: {which} pyramid, level {level}, texel {texel} does not bound what is under it")]
    Pyramid {
        /// The chunk.
        key: ChunkKey,
        /// `max` or `min`.
        which: &'static str,
        /// Level of the texel; 0 bounds vertices, the others bound texels.
        level: usize,
        /// Index of the texel in its level.
        texel: usize,
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
    #[error("the server announces world {announced} for seed {seed}, generation here gives {ours}")]
    World {
        /// The announced digest.
        announced: WorldDigest,
        /// The announced seed.
        seed: u64,
        /// The digest of that seed here.
        ours: WorldDigest,
    },
    /// The announced world is not the one that the run began with.
    #[error("the server serves another world than at the start of the run: {now}, before {first}")]
    OtherWorld {
        /// The digest that was announced first.
        first: WorldDigest,
        /// The digest that is announced now.
        now: WorldDigest,
    },
    /// The server has another generator version, so nothing can be compared.
    #[error(
        "the server generates by formula {theirs}, this tool by {GENERATOR_VERSION}: update the older one"
    )]
    Generator {
        /// The announced version.
        theirs: u32,
    },
}

/// Checks both pyramids: every base texel bounds the four corners of its cell, every other the four
/// texels below it.
///
/// # Errors
/// The first texel that is no bound.
pub fn pyramids(chunk: &Chunk) -> Result<(), Mismatch> {
    let (max, min) = (&chunk.max_pyramid, &chunk.min_pyramid);
    let report = |which, failed: Option<(usize, usize)>| {
        failed.map_or(Ok(()), |(level, texel)| Err(Mismatch::Pyramid { key: chunk.key, which, level, texel }))
    };
    report("max", first_failure(&chunk.heights, |level| max.level(level), |bound, value| bound >= value))?;
    report("min", first_failure(&chunk.heights, |level| min.level(level), |bound, value| bound <= value))
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

/// The level and index of the first texel that does not bound what is under it.
///
/// Every chunk of every client is checked, so a row is first checked as a whole, without branches
/// that would prevent vectorisation; only a failing row is searched.
fn first_failure<'a>(
    heights: &[i32; VERTEX_COUNT],
    texels: impl Fn(usize) -> &'a [i32],
    bounds: impl Fn(i32, i32) -> bool,
) -> Option<(usize, usize)> {
    let base = texels(0).chunks_exact(CELLS).enumerate().find_map(|(row, bounding)| {
        let near = &heights[row * VERTICES..][..VERTICES];
        let far = &heights[(row + 1) * VERTICES..][..VERTICES];
        failing_column(bounding, |column, bound| {
            bounds(bound, near[column])
                & bounds(bound, near[column + 1])
                & bounds(bound, far[column])
                & bounds(bound, far[column + 1])
        })
        .map(|column| (0, row * CELLS + column))
    });
    base.or_else(|| {
        (1..PYRAMID_LEVELS).find_map(|level| {
            let (width, below) = (side(level), texels(level - 1));
            texels(level).chunks_exact(width).enumerate().find_map(|(row, bounding)| {
                let near = &below[4 * row * width..][..2 * width];
                let far = &below[(4 * row + 2) * width..][..2 * width];
                failing_column(bounding, |column, bound| {
                    bounds(bound, near[2 * column])
                        & bounds(bound, near[2 * column + 1])
                        & bounds(bound, far[2 * column])
                        & bounds(bound, far[2 * column + 1])
                })
                .map(|column| (level, row * width + column))
            })
        })
    })
}

fn failing_column(bounding: &[i32], holds: impl Fn(usize, i32) -> bool) -> Option<usize> {
    let all = bounding.iter().enumerate().fold(true, |all, (column, bound)| all & holds(column, *bound));
    if all { None } else { bounding.iter().enumerate().position(|(column, bound)| !holds(column, *bound)) }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            assert_eq!(pyramids(&correct), Ok(()));
            assert_eq!(regeneration(&land(), &correct, Delivery::Exact), Ok(()));
        }
    }

    #[test]
    fn a_wrong_height_is_found_by_local_generation() {
        let correct = chunk(0, 3, -7);
        for vertex in [0, 64, VERTICES * 10 + 7, VERTEX_COUNT - 1] {
            let wrong = with_wrong_height(&correct, vertex);
            assert_eq!(pyramids(&wrong), Ok(()), "its own pyramids fit; only generation shows it");
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

    #[test]
    fn every_vertex_outside_of_its_base_texels_is_found() {
        let correct = chunk(0, 3, -7);
        for vertex in 0..VERTEX_COUNT {
            // The pyramids are still those of the original heights.
            for (height, which) in [(correct.max() + 1, "max"), (correct.min() - 1, "min")] {
                let mut wrong = correct.clone();
                wrong.heights[vertex] = height;
                let found = pyramids(&wrong);
                assert!(
                    matches!(&found, Err(Mismatch::Pyramid { which: w, level: 0, .. }) if *w == which),
                    "vertex {vertex}: {found:?}"
                );
            }
        }
    }

    #[test]
    fn pyramids_of_other_heights_are_found() {
        let (correct, other) = (chunk(0, 3, -7), chunk(0, 60, 60));
        let wrong = Chunk { max_pyramid: other.max_pyramid.clone(), ..correct.clone() };
        assert!(matches!(pyramids(&wrong), Err(Mismatch::Pyramid { which: "max", level: 0, texel: 0, .. })));
        // A sea floor below the land is a valid, loose lower bound; a hill above it is none.
        let wrong = Chunk { min_pyramid: correct.min_pyramid.clone(), ..other };
        assert!(matches!(pyramids(&wrong), Err(Mismatch::Pyramid { which: "min", .. })));
    }

    #[test]
    fn every_texel_that_is_no_bound_of_its_children_is_found() {
        let correct = chunk(0, 3, -7);
        let mut levels: Vec<_> =
            (0..PYRAMID_LEVELS).map(|level| correct.max_pyramid.level(level).to_vec()).collect();
        let check = |levels: &[Vec<i32>]| {
            first_failure(&correct.heights, |level| &levels[level][..], |bound, value| bound >= value)
        };
        assert_eq!(check(&levels), None);
        for level in 0..PYRAMID_LEVELS {
            for texel in 0..levels[level].len() {
                levels[level][texel] -= 1;
                assert_eq!(check(&levels), Some((level, texel)));
                levels[level][texel] += 1;
            }
        }
    }
}
