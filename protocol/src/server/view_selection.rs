//! The selection of one view's chunks: pure work that a server runs outside of its sessions.
//!
//! [`super::ServerSession::take_view`] starts one, a worker thread calls [`ViewSelection::step`]
//! until it is done, and [`super::ServerSession::apply_view`] applies it. One step is bounded, so
//! that many sessions can share a thread.

use crate::limits::MAX_VIEW_CHUNKS;
use crate::view::View;
use rustc_hash::{FxHashMap, FxHashSet};
use terrain::lod::{Needed, Selector};
use terrain::{ChunkKey, Land};

/// One view with the chunks found so far.
#[derive(Debug)]
pub struct ViewSelection {
    view: View,
    phase: Phase,
    /// Age of each chunk that the previous view needs and the client does not hold: the number of
    /// views before that one in which the chunk waited already.
    earlier_ages: FxHashMap<ChunkKey, u32>,
    selected: Selected,
}

/// The result of a finished selection.
#[derive(Debug, Default)]
pub(super) struct Selected {
    /// Number of needed chunks, without prefetched ones.
    pub chunks: u32,
    /// Keys of all needed and all prefetched chunks.
    pub keys: FxHashSet<ChunkKey>,
    /// Needed chunks with priorities, most urgent last.
    pub needed: Vec<(u64, ChunkKey)>,
    /// Chunks to prefetch with priorities, most urgent last.
    pub prefetch: Vec<(u64, ChunkKey)>,
    /// Age of each needed chunk: the number of previous views in a row in which it waited.
    pub ages: FxHashMap<ChunkKey, u32>,
}

#[derive(Debug)]
enum Phase {
    Select(Selector),
    Rank { found: Vec<Needed>, ranked: usize },
    SelectPrefetch(Selector),
    RankPrefetch { found: Vec<Needed>, ranked: usize },
    Done,
}

impl ViewSelection {
    /// A selection for a checked view.
    pub(super) fn new(land: &Land, view: View, earlier_ages: FxHashMap<ChunkKey, u32>) -> Self {
        let phase = Phase::Select(Selector::new(land, &view.viewer(), MAX_VIEW_CHUNKS));
        Self { view, phase, earlier_ages, selected: Selected::default() }
    }

    /// The view.
    #[must_use]
    pub const fn view(&self) -> &View {
        &self.view
    }

    /// Whether all steps are done.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done)
    }

    /// Examines about `chunks` chunks; a few hundred take some 100 us. Sorting is one step, of at
    /// most [`MAX_VIEW_CHUNKS`] entries. Returns whether the selection is done.
    pub fn step(&mut self, land: &Land, chunks: usize) -> bool {
        let chunks = chunks.max(1);
        self.phase = match std::mem::replace(&mut self.phase, Phase::Done) {
            Phase::Select(mut selector) => {
                if selector.step(chunks) {
                    Phase::Rank { found: selector.finish(), ranked: 0 }
                } else {
                    Phase::Select(selector)
                }
            }
            Phase::Rank { found, ranked } if ranked < found.len() => {
                let end = ranked.saturating_add(chunks).min(found.len());
                found[ranked..end].iter().for_each(|needed| self.rank(needed));
                Phase::Rank { found, ranked: end }
            }
            Phase::Rank { found, .. } => {
                self.selected.chunks = found.len() as u32;
                self.selected.needed.sort_unstable();
                match self.view.prefetch_viewer() {
                    Some(viewer) => Phase::SelectPrefetch(Selector::new(land, &viewer, MAX_VIEW_CHUNKS)),
                    None => Phase::Done,
                }
            }
            Phase::SelectPrefetch(mut selector) => {
                if selector.step(chunks) {
                    Phase::RankPrefetch { found: selector.finish(), ranked: 0 }
                } else {
                    Phase::SelectPrefetch(selector)
                }
            }
            Phase::RankPrefetch { found, ranked } if ranked < found.len() => {
                let end = ranked.saturating_add(chunks).min(found.len());
                for needed in &found[ranked..end] {
                    if self.selected.keys.insert(needed.key) {
                        self.selected.prefetch.push((u64::from(needed.gain_q4), needed.key));
                    }
                }
                Phase::RankPrefetch { found, ranked: end }
            }
            Phase::RankPrefetch { .. } => {
                self.selected.prefetch.sort_unstable();
                Phase::Done
            }
            Phase::Done => Phase::Done,
        };
        self.is_done()
    }

    /// The view and its chunks. Runs the remaining steps.
    pub(super) fn finish(mut self, land: &Land) -> (View, Selected) {
        while !self.step(land, usize::MAX) {}
        (self.view, self.selected)
    }

    fn rank(&mut self, needed: &Needed) {
        let views = self.earlier_ages.get(&needed.key).map_or(0, |views| views.saturating_add(1));
        self.selected.ages.insert(needed.key, views);
        self.selected.keys.insert(needed.key);
        self.selected.needed.push((self.view.priority(needed, views), needed.key));
    }
}
