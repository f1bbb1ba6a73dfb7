//! The chunks that a server may send in a session: those of its views, and requested ones.
//!
//! The land is not known, so no error on screen can be computed here: a chunk is expected if its
//! level and its distance fit a view. That bounds what a hostile server can make the viewer decode
//! and keep, whatever heights it sends.

use protocol::held_chunks::HeldChunks;
use protocol::view::View;
use std::collections::VecDeque;
use terrain::constants::HEIGHT_LIMIT;
use terrain::lod::Viewer;
use terrain::{Chunk, ChunkKey};

/// Most views that the server may still be serving: those of 100 s at ten views a second. When the
/// list is full the oldest view is dropped, and a chunk that only it needs is not expected.
pub const MAX_VIEWS: usize = 1024;

/// See the module. Memory: some 100 KiB for views, 164 KiB for held chunks, for any server.
#[derive(Debug, Default)]
pub struct ExpectedChunks {
    /// Newest last.
    views: VecDeque<SentView>,
    /// Chunks that were reported to the server as held, or came from it. Cleared when full, as in
    /// the server.
    held: HeldChunks,
}

#[derive(Clone, Copy, Debug)]
struct SentView {
    id: u32,
    viewer: Viewer,
    /// The viewer that the server may prefetch for.
    prefetch: Option<Viewer>,
    /// Whether the server has settled or refused it, which it does once.
    is_answered: bool,
}

impl SentView {
    fn may_need(&self, key: ChunkKey) -> bool {
        let fits = |viewer: &Viewer| key.level() <= viewer.top_level() && viewer.sees(key);
        fits(&self.viewer) || self.prefetch.as_ref().is_some_and(fits)
    }
}

impl ExpectedChunks {
    /// Adds a view that was sent.
    pub fn add_view(&mut self, view: &View) {
        if self.views.len() == MAX_VIEWS {
            self.views.pop_front();
        }
        let (viewer, prefetch) = (view.viewer(), view.prefetch_viewer());
        self.views.push_back(SentView { id: view.id, viewer, prefetch, is_answered: false });
    }

    /// A view is settled: no chunk of an older view is still to come. False if no such view waits
    /// for an answer.
    pub fn settle(&mut self, view: u32) -> bool {
        let is_open = self.refuse(view);
        while is_open && self.views.front().is_some_and(|sent| sent.id != view) {
            self.views.pop_front();
        }
        is_open
    }

    /// A view is refused. False if no such view waits for an answer.
    pub fn refuse(&mut self, view: u32) -> bool {
        let sent = self.views.iter_mut().find(|sent| sent.id == view);
        sent.is_some_and(|sent| !std::mem::replace(&mut sent.is_answered, true))
    }

    /// Whether this is the latest view.
    #[must_use]
    pub fn is_latest(&self, view: u32) -> bool {
        self.views.back().is_some_and(|sent| sent.id == view)
    }

    /// Whether a view may need a chunk.
    #[must_use]
    pub fn is_in_view(&self, key: ChunkKey) -> bool {
        // Newest first: it nearly always matches.
        self.views.iter().rev().any(|view| view.may_need(key))
    }

    /// Whether the latest view may need a chunk.
    #[must_use]
    pub fn is_in_latest_view(&self, key: ChunkKey) -> bool {
        self.views.back().is_some_and(|view| view.may_need(key))
    }

    /// Adds a chunk that is held from now on. False if it was held already.
    pub fn hold(&mut self, key: ChunkKey) -> bool {
        self.held.insert(key)
    }

    /// The chunks were evicted: they may come again.
    pub fn release(&mut self, keys: &[ChunkKey]) {
        for key in keys {
            self.held.remove(*key);
        }
    }
}

/// Checks what no decoder can derive from the heights: the stated error. Heights, extremes and
/// slope are the decoder's.
///
/// # Errors
/// The rule that the chunk breaks.
pub fn check_ranges(chunk: &Chunk) -> Result<(), &'static str> {
    // Two surfaces within the height limit are never farther apart.
    const MAX_ERROR: u32 = 2 * HEIGHT_LIMIT.unsigned_abs();
    if chunk.error > MAX_ERROR {
        return Err("the error is larger than the range of heights");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::limits::{HELD_TILE, MAX_HELD_TILES};
    use terrain::{Land, lod};

    fn view(id: u32, east_m: i32, distance_m: u32) -> View {
        View { eye: [east_m * 256, 100 * 256, 0], tolerance_q4: 16, ..test_support::view(id, distance_m) }
    }

    #[test]
    fn every_chunk_that_a_server_selects_is_expected_also_those_ahead() {
        let land = Land::new(1);
        let moving = View { velocity: [200 * 256, 0, 0], ..view(1, 0, 2000) };
        let mut expected = ExpectedChunks::default();
        expected.add_view(&moving);
        let viewers = [moving.viewer(), moving.prefetch_viewer().unwrap()];
        let selected = viewers.iter().flat_map(|viewer| lod::select(&land, viewer, usize::MAX));
        let mut count = 0;
        for needed in selected {
            assert!(expected.is_in_view(needed.key), "{}", needed.key);
            count += 1;
        }
        assert!(count > 100);
    }

    #[test]
    fn a_chunk_too_far_or_too_coarse_is_not_expected() {
        let mut expected = ExpectedChunks::default();
        let near = ChunkKey::new(0, 0, 0).unwrap();
        assert!(!expected.is_in_view(near), "no view was sent");
        expected.add_view(&view(1, 0, 2000));
        assert!(expected.is_in_view(near));
        for (level, x) in [(0, 30_000), (0, -17), (16, 0), (5, 0)] {
            let key = ChunkKey::new(level, x, 0).unwrap();
            assert!(!expected.is_in_view(key), "{key}");
        }
    }

    #[test]
    fn an_older_view_counts_until_a_newer_one_is_settled() {
        let mut expected = ExpectedChunks::default();
        let of_old = ChunkKey::new(0, 0, 0).unwrap();
        expected.add_view(&view(1, 0, 300));
        expected.add_view(&view(2, 50_000, 300));
        assert!(expected.is_in_view(of_old) && !expected.is_in_latest_view(of_old));
        assert!(!expected.settle(9), "no such view");
        assert!(expected.settle(2) && !expected.settle(1));
        assert!(!expected.is_in_view(of_old) && expected.is_latest(2));
    }

    #[test]
    fn a_view_is_answered_once() {
        let mut expected = ExpectedChunks::default();
        for id in [1, 2, 3] {
            expected.add_view(&view(id, 0, 300));
        }
        assert!(expected.refuse(1) && !expected.refuse(1) && !expected.settle(1));
        assert!(expected.settle(2) && !expected.settle(2) && !expected.refuse(2));
        assert!(expected.refuse(3) && !expected.settle(3));
        assert!(!expected.refuse(4), "no such view");
    }

    #[test]
    fn memory_is_bounded_for_any_number_of_views_and_chunks() {
        let mut expected = ExpectedChunks::default();
        for id in 0..5000 {
            expected.add_view(&view(id, 0, 2000));
        }
        assert_eq!(expected.views.len(), MAX_VIEWS);
        let key = |tile: i32| ChunkKey::new(0, tile % 1024 * HELD_TILE, tile / 1024 * HELD_TILE).unwrap();
        let (first, last) = (key(0), key(MAX_HELD_TILES as i32));
        assert!((0..MAX_HELD_TILES as i32).all(|tile| expected.hold(key(tile))));
        assert!(!expected.hold(first), "held already");
        assert!(expected.hold(last) && expected.hold(first), "cleared when full");
        assert!(!expected.hold(last), "held already");
        expected.release(&[last]);
        assert!(expected.hold(last));
    }

    #[test]
    fn an_error_beyond_the_range_of_heights_is_a_fault() {
        let chunk = Land::new(1).chunk(ChunkKey::new(1, 0, 0).unwrap());
        assert_eq!(check_ranges(&chunk), Ok(()));
        for error in [2 * HEIGHT_LIMIT as u32 + 1, u32::MAX] {
            assert!(check_ranges(&Chunk { error, ..chunk.clone() }).is_err(), "{error}");
        }
    }
}
