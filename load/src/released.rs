//! Chunks that one session has released, as far as a view that is not settled may need them: such a
//! view lacks them rightly.

use std::collections::VecDeque;
use terrain::ChunkKey;

/// Releases that are remembered at most, as many as chunks are held. When the list is full the
/// oldest is forgotten, and the views of its time and older ones are not checked.
const MAX_RELEASED: usize = crate::held::MAX_HELD;

/// See the module.
#[derive(Debug, Default)]
pub struct ReleasedChunks {
    /// Newest last: the newest view of the time, and the key.
    released: VecDeque<(u32, ChunkKey)>,
    /// The newest view of whose time a release was forgotten.
    forgotten: Option<u32>,
}

impl ReleasedChunks {
    /// Adds a chunk that is released when a view is the newest. The server reads of the release
    /// before it reads later views, and sends the chunk again if one of them needs it.
    pub fn add(&mut self, newest_view: u32, key: ChunkKey) {
        if self.released.len() == MAX_RELEASED {
            self.forgotten = self.released.pop_front().map(|(view, _)| view);
        }
        self.released.push_back((newest_view, key));
    }

    /// Whether a view may lack some of the chunks that it needs.
    #[must_use]
    pub fn may_lack(&self, view: u32, needed: &[ChunkKey]) -> bool {
        let since = self.released.iter().filter(|(newest, _)| *newest >= view);
        self.forgotten >= Some(view) || since.map(|(_, key)| key).any(|key| needed.contains(key))
    }

    /// Forgets what no view after a settled one may lack.
    pub fn settled(&mut self, view: u32) {
        self.released.retain(|(newest, _)| *newest > view);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 9).unwrap()
    }

    #[test]
    fn a_view_may_lack_what_was_released_after_it_and_nothing_else() {
        let mut released = ReleasedChunks::default();
        assert!(!released.may_lack(0, &[key(1)]), "nothing was released");
        released.add(7, key(1));
        assert!(released.may_lack(7, &[key(2), key(1)]) && released.may_lack(6, &[key(1)]));
        assert!(!released.may_lack(7, &[key(2)]), "another chunk");
        assert!(!released.may_lack(8, &[key(1)]), "a later view, for which the server sends it again");
        released.settled(7);
        assert!(!released.may_lack(7, &[key(1)]));
    }

    #[test]
    fn of_forgotten_releases_the_views_are_not_checked() {
        let mut released = ReleasedChunks::default();
        (0..MAX_RELEASED).for_each(|_| released.add(3, key(1)));
        assert!(!released.may_lack(3, &[key(2)]));
        released.add(4, key(1));
        assert!(released.may_lack(3, &[key(2)]) && !released.may_lack(4, &[key(2)]));
        assert_eq!(released.released.len(), MAX_RELEASED);
    }
}
