//! The chunks that a client has, as a server and the client itself remember them.
//!
//! A client has chunks that lie together: one bit for each chunk of a tile takes a small part of
//! the memory of a set of keys. A chunk far from all others takes a whole tile, and so tiles are
//! limited.

use crate::limits::{HELD_TILE, MAX_HELD_TILES};
use std::collections::HashMap;
use terrain::ChunkKey;

const WORDS: usize = (HELD_TILE * HELD_TILE) as usize / 64;

/// A set of chunks of at most [`MAX_HELD_TILES`] tiles. The peer chooses the keys: the randomly
/// keyed hash of std has no collisions that it could prepare.
#[derive(Debug, Default)]
pub struct HeldChunks {
    /// Tiles with at least one chunk, at most [`MAX_HELD_TILES`].
    tiles: HashMap<Tile, [u64; WORDS]>,
}

/// A square of chunks of one level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Tile {
    level: u8,
    x: i16,
    z: i16,
}

impl HeldChunks {
    /// Whether the client has a chunk.
    #[must_use]
    pub fn contains(&self, key: ChunkKey) -> bool {
        let (tile, word, bit) = place(key);
        self.tiles.get(&tile).is_some_and(|chunks| chunks[word] & bit != 0)
    }

    /// Adds a chunk. A full set is cleared before. False if the chunk was in it already.
    pub fn insert(&mut self, key: ChunkKey) -> bool {
        let (tile, word, bit) = place(key);
        if self.tiles.len() >= MAX_HELD_TILES && !self.tiles.contains_key(&tile) {
            self.tiles.clear();
        }
        let chunks = &mut self.tiles.entry(tile).or_default()[word];
        let is_new = *chunks & bit == 0;
        *chunks |= bit;
        is_new
    }

    /// Removes a chunk.
    pub fn remove(&mut self, key: ChunkKey) {
        let (tile, word, bit) = place(key);
        let Some(chunks) = self.tiles.get_mut(&tile) else { return };
        chunks[word] &= !bit;
        if *chunks == [0; WORDS] {
            self.tiles.remove(&tile);
        }
    }
}

/// The tile of a chunk, and its bit in it.
fn place(key: ChunkKey) -> (Tile, usize, u64) {
    // Chunks have coordinates of 16 bits.
    let tile = Tile {
        level: key.level(),
        x: key.x().div_euclid(HELD_TILE) as i16,
        z: key.z().div_euclid(HELD_TILE) as i16,
    };
    let index = key.z().rem_euclid(HELD_TILE) * HELD_TILE + key.x().rem_euclid(HELD_TILE);
    (tile, index as usize / 64, 1 << (index % 64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;
    use test_support::Random;

    #[test]
    fn it_is_a_set_of_keys() {
        let (mut held, mut keys, mut random) = (HeldChunks::default(), HashSet::new(), Random(5));
        // Near the origin and at the edges of the world, so that keys repeat and tiles end.
        let mut coordinate = |half: i32| {
            let near = random.below(40) as i32;
            [near - 20, near - half, half - 1 - near][random.below(3)].clamp(-half, half - 1)
        };
        for number in 0..40_000 {
            let level = (number % 3) as u8;
            let half = 1 << (15 - level);
            let key = ChunkKey::new(level, coordinate(half), coordinate(half)).unwrap();
            assert_eq!(held.contains(key), keys.contains(&key), "{key}");
            if number / 3 % 3 == 0 {
                held.remove(key);
                keys.remove(&key);
            } else {
                assert_eq!(held.insert(key), keys.insert(key), "{key}");
            }
        }
        assert!(keys.len() > 1000 && keys.iter().all(|key| held.contains(*key)));
        keys.into_iter().for_each(|key| held.remove(key));
        assert!(held.tiles.is_empty());
    }

    #[test]
    fn a_full_set_is_cleared_before_the_next_tile() {
        let tile = |number: i32| ChunkKey::new(0, (number % 1024) * HELD_TILE, number / 1024 * HELD_TILE);
        let mut held = HeldChunks::default();
        let keys: Vec<_> = (0..MAX_HELD_TILES as i32 + 1).map(|number| tile(number).unwrap()).collect();
        let (last, first) = keys.split_last().unwrap();
        assert!(first.iter().all(|key| held.insert(*key)));
        let beside = ChunkKey::new(0, 1, 1).unwrap();
        assert!(held.insert(beside));
        assert!(first.iter().all(|key| held.contains(*key)) && held.contains(beside), "no further tile");
        assert!(held.insert(*last));
        assert!(held.contains(*last) && held.tiles.len() == 1);
    }
}
