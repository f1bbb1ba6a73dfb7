//! The chunks that one client holds. They outlive its sessions, as those of a viewer do: after a
//! reconnect, to any server of the same world, only missing chunks should come.

use rustc_hash::FxHashMap;
use std::collections::VecDeque;
use terrain::{ChunkKey, WorldDigest};

/// Chunks that a client holds at most, about three views of 2 km. When the list is full the oldest
/// that the current view does not need is released, and the server may send it again.
pub const MAX_HELD: usize = 1024;

/// Keys of held chunks, oldest first, with the bytes of their frames.
#[derive(Debug, Default)]
pub struct HeldChunks {
    order: VecDeque<ChunkKey>,
    frames: FxHashMap<ChunkKey, usize>,
    world: Option<WorldDigest>,
}

impl HeldChunks {
    /// Forgets the chunks of any other world.
    pub fn enter(&mut self, world: WorldDigest) {
        if self.world != Some(world) {
            *self = Self { world: Some(world), ..Self::default() };
        }
    }

    /// Adds a chunk that came in a frame of `bytes` bytes. True if it was held already.
    pub fn insert(&mut self, key: ChunkKey, bytes: usize) -> bool {
        let is_held = self.frames.insert(key, bytes).is_some();
        if !is_held {
            self.order.push_back(key);
        }
        is_held
    }

    /// Whether a chunk is held.
    #[must_use]
    pub fn contains(&self, key: ChunkKey) -> bool {
        self.frames.contains_key(&key)
    }

    /// Number of chunks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// The keys, oldest first.
    #[must_use]
    pub fn keys(&self) -> Vec<ChunkKey> {
        self.order.iter().copied().collect()
    }

    /// Bytes of the frames of all of them.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.frames.values().sum()
    }

    /// Removes the oldest chunk that is to spare, or the oldest of all, if more than [`MAX_HELD`]
    /// are held.
    pub fn release(&mut self, is_spare: impl Fn(&ChunkKey) -> bool) -> Option<ChunkKey> {
        if self.order.len() <= MAX_HELD {
            return None;
        }
        // The oldest are often the coarse chunks of the view; 64 are enough to pass over them.
        let index = self.order.iter().take(64).position(is_spare).unwrap_or(0);
        let key = self.order.remove(index)?;
        self.frames.remove(&key);
        Some(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 9).unwrap()
    }

    #[test]
    fn chunks_of_one_world_are_kept_and_those_of_another_forgotten() {
        let mut held = HeldChunks::default();
        held.enter(WorldDigest([1; 32]));
        assert!(!held.insert(key(1), 100) && held.insert(key(1), 100) && !held.insert(key(2), 50));
        held.enter(WorldDigest([1; 32]));
        assert_eq!((held.len(), held.bytes(), held.keys()), (2, 150, vec![key(1), key(2)]));
        held.enter(WorldDigest([2; 32]));
        assert!(held.is_empty() && !held.contains(key(1)));
    }

    #[test]
    fn the_oldest_spare_chunk_is_released_when_too_many_are_held() {
        let mut held = HeldChunks::default();
        (0..MAX_HELD as i32).for_each(|x| _ = held.insert(key(x), 1));
        assert_eq!(held.release(|_| true), None);
        held.insert(key(-1), 1);
        assert_eq!(held.release(|spare| *spare != key(0)), Some(key(1)));
        assert_eq!((held.len(), held.bytes()), (MAX_HELD, MAX_HELD));
        held.insert(key(-2), 1);
        assert_eq!(held.release(|_| false), Some(key(0)), "none to spare: the oldest");
    }
}
