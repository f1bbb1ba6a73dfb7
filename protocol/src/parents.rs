//! The parents that both ends of a session remember in refined delivery.
//!
//! A refined frame is of use only to who has the parent, and only the client knows what it has
//! kept. Asking would cost a round trip and guessing would fail now and then, so neither is done:
//! as with the window of a compressor, both ends remember the latest [`MAX_PARENTS`] chunks that
//! can be parents, in the order of their frames, whatever the client does with them afterwards. The
//! connection keeps the order, so both remember the same. Nothing of it outlives the session.

use crate::limits::MAX_PARENTS;
use rustc_hash::FxHashMap;
use std::collections::VecDeque;
use std::ops::RangeInclusive;
use terrain::ChunkKey;

/// Levels whose vertices their children share bit for bit. Above them a level draws a smoother
/// land.
pub const LEVELS: RangeInclusive<u8> = 1..=2;

/// See the module. The server remembers that a chunk went out, the client its heights.
#[derive(Debug)]
pub struct Parents<T> {
    /// At most [`MAX_PARENTS`]; the oldest is forgotten for a new one.
    by_key: FxHashMap<ChunkKey, T>,
    /// The same keys, the oldest first.
    order: VecDeque<ChunkKey>,
}

impl<T> Default for Parents<T> {
    fn default() -> Self {
        Self { by_key: FxHashMap::default(), order: VecDeque::new() }
    }
}

impl<T> Parents<T> {
    /// Takes note of a chunk's frame, if the chunk can be a parent. One that is remembered already
    /// stays as it is and where it is.
    pub fn remember(&mut self, key: ChunkKey, what: impl FnOnce() -> T) {
        if !LEVELS.contains(&key.level()) || self.by_key.contains_key(&key) {
            return;
        }
        if self.order.len() == MAX_PARENTS
            && let Some(oldest) = self.order.pop_front()
        {
            self.by_key.remove(&oldest);
        }
        self.order.push_back(key);
        self.by_key.insert(key, what());
    }

    /// What is remembered of a chunk's parent; none if that is forgotten, was never sent, or cannot
    /// be refined.
    #[must_use]
    pub fn of(&self, child: ChunkKey) -> Option<&T> {
        self.by_key.get(&child.parent()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(level: u8, x: i32) -> ChunkKey {
        ChunkKey::new(level, x, 0).unwrap()
    }

    #[test]
    fn the_oldest_is_forgotten_first_and_seeing_one_again_changes_nothing() {
        let mut parents = Parents::default();
        for x in 0..MAX_PARENTS as i32 {
            parents.remember(key(1, x), || x);
        }
        parents.remember(key(1, 0), || -1);
        assert_eq!(parents.of(key(0, 1)), Some(&0));
        parents.remember(key(1, MAX_PARENTS as i32), || 7);
        assert_eq!(parents.of(key(0, 1)), None);
        assert_eq!(parents.of(key(0, 2)), Some(&1));
        assert_eq!(parents.of(key(0, 2 * MAX_PARENTS as i32)), Some(&7));
        assert_eq!((parents.by_key.len(), parents.order.len()), (MAX_PARENTS, MAX_PARENTS));
    }

    #[test]
    fn only_levels_whose_vertices_are_shared_are_remembered() {
        let mut parents = Parents::default();
        for level in 0..=4 {
            parents.remember(key(level, 0), || level);
        }
        let found: Vec<_> = (0..4).map(|level| parents.of(key(level, 1)).copied()).collect();
        assert_eq!(found, [Some(1), Some(2), None, None]);
        assert_eq!(parents.order.len(), 2);
    }
}
