//! The reference window of refined delivery: the parents that frames may refer to.
//!
//! A refined frame can be decoded only with the chunk's parent. As with the window of an LZ
//! compressor, both ends of a session keep the latest [`MAX_REFERENCES`] chunks that can be
//! parents, in the order of their frames, independent of the client's cache. The connection
//! preserves that order, so both windows are equal without further messages. The window ends with
//! the session.
//!
//! The server does not learn that the client has rejected a frame. So a rejected frame takes its
//! place in the client's window too, without heights: else the client would evict later than the
//! server, and after the chunk has been sent again in another order.

use crate::limits::MAX_REFERENCES;
use std::collections::{HashMap, VecDeque};
use std::ops::RangeInclusive;
use terrain::ChunkKey;

/// Levels whose vertices their children share bit for bit. Coarser levels carry fewer octaves.
pub const LEVELS: RangeInclusive<u8> = 1..=2;

/// The latest chunks that can be parents. The server stores their keys only, the client their
/// heights.
#[derive(Debug)]
pub struct ReferenceWindow<T> {
    /// At most [`MAX_REFERENCES`]; a new one evicts the oldest.
    /// None is the place of a chunk whose frame was rejected.
    by_key: HashMap<ChunkKey, Option<T>>,
    /// The same keys, the oldest first.
    order: VecDeque<ChunkKey>,
}

impl<T> Default for ReferenceWindow<T> {
    fn default() -> Self {
        Self { by_key: HashMap::default(), order: VecDeque::new() }
    }
}

impl<T> ReferenceWindow<T> {
    /// Inserts a chunk after its frame, if the chunk can be a parent; `value` is none if the frame
    /// was rejected. A chunk that is in the window already keeps its place, and its value if it has
    /// one.
    pub fn insert(&mut self, key: ChunkKey, value: impl FnOnce() -> Option<T>) {
        if !LEVELS.contains(&key.level()) {
            return;
        }
        if let Some(present) = self.by_key.get_mut(&key) {
            if present.is_none() {
                *present = value();
            }
            return;
        }
        if self.order.len() == MAX_REFERENCES
            && let Some(oldest) = self.order.pop_front()
        {
            self.by_key.remove(&oldest);
        }
        self.order.push_back(key);
        self.by_key.insert(key, value());
    }

    /// The value of a chunk's parent; none if the parent is not in the window or its frame was
    /// rejected.
    #[must_use]
    pub fn parent_of(&self, child: ChunkKey) -> Option<&T> {
        self.by_key.get(&child.parent()?)?.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(level: u8, x: i32) -> ChunkKey {
        ChunkKey::new(level, x, 0).unwrap()
    }

    #[test]
    fn the_oldest_is_evicted_first_and_a_repeat_changes_nothing() {
        let mut window = ReferenceWindow::default();
        for x in 0..MAX_REFERENCES as i32 {
            window.insert(key(1, x), || Some(x));
        }
        window.insert(key(1, 0), || Some(-1));
        assert_eq!(window.parent_of(key(0, 1)), Some(&0));
        window.insert(key(1, MAX_REFERENCES as i32), || Some(7));
        assert_eq!(window.parent_of(key(0, 1)), None);
        assert_eq!(window.parent_of(key(0, 2)), Some(&1));
        assert_eq!(window.parent_of(key(0, 2 * MAX_REFERENCES as i32)), Some(&7));
        assert_eq!((window.by_key.len(), window.order.len()), (MAX_REFERENCES, MAX_REFERENCES));
    }

    #[test]
    fn a_rejected_frame_takes_a_place_and_a_later_one_fills_it() {
        let mut window = ReferenceWindow::default();
        window.insert(key(1, 0), || None);
        assert_eq!(window.parent_of(key(0, 1)), None);
        for x in 1..MAX_REFERENCES as i32 {
            window.insert(key(1, x), || Some(x));
        }
        window.insert(key(1, 0), || Some(9));
        window.insert(key(1, 0), || None);
        assert_eq!(window.parent_of(key(0, 1)), Some(&9));
        // It is still the oldest.
        window.insert(key(1, MAX_REFERENCES as i32), || None);
        assert_eq!((window.parent_of(key(0, 1)), window.parent_of(key(0, 2))), (None, Some(&1)));
        assert_eq!((window.by_key.len(), window.order.len()), (MAX_REFERENCES, MAX_REFERENCES));
    }

    #[test]
    fn only_levels_with_shared_vertices_enter_the_window() {
        let mut window = ReferenceWindow::default();
        for level in 0..=4 {
            window.insert(key(level, 0), || Some(level));
        }
        let found: Vec<_> = (0..4).map(|level| window.parent_of(key(level, 1)).copied()).collect();
        assert_eq!(found, [Some(1), Some(2), None, None]);
        assert_eq!(window.order.len(), 2);
    }
}
