//! The chunks that the view of a session still needs: by priority, with prefetch.

use super::view_selection::{Selected, ViewSelection};
use crate::held_chunks::HeldChunks;
use crate::view::View;
use rustc_hash::{FxHashMap, FxHashSet};
use terrain::{ChunkKey, Land};

/// The views of one session: the newest waits, one is being selected, one is active.
#[derive(Debug, Default)]
pub(super) struct ViewQueue {
    active: Option<ActiveView>,
    /// The newest view that is not selected yet. A newer one replaces it.
    queued: Option<View>,
    /// Id of the view whose selection was taken and is neither applied nor failed.
    selecting: Option<u32>,
}

/// The latest selected view and its remaining chunks.
#[derive(Debug)]
struct ActiveView {
    view: View,
    /// Chunks of the whole selection.
    chunks: u32,
    /// Not yet requested, most urgent last. May contain chunks that the client holds or that are in
    /// flight for a request of the client.
    pending: Vec<(u64, ChunkKey)>,
    /// Prefetch: not needed yet but soon, most urgent last; requested when the view is settled.
    prefetch: Vec<(u64, ChunkKey)>,
    /// Number of earlier views at whose end each chunk of this view was needed and not held. Empty
    /// while a selection runs, and after one that failed.
    ages: FxHashMap<ChunkKey, u32>,
    settled: bool,
}

impl ViewQueue {
    /// Queues a view. Returns whether it replaced one that was not selected yet.
    pub(super) fn queue(&mut self, view: View) -> bool {
        self.queued.replace(view).is_some()
    }

    /// Whether a view waits for its selection and no selection is running.
    pub(super) const fn can_take(&self) -> bool {
        self.queued.is_some() && self.selecting.is_none()
    }

    /// Starts the selection of the queued view; none if no view waits or a selection is running.
    /// The chunks of the active view that the client does not hold by now have waited in one more
    /// view.
    pub(super) fn take(&mut self, land: &Land, held: &HeldChunks) -> Option<ViewSelection> {
        if !self.can_take() {
            return None;
        }
        let view = self.queued.take()?;
        self.selecting = Some(view.id);
        // A settled view waits for nothing. One that is not has an age for each of its chunks at
        // most: some 0.5 ms for the largest view, a small part of the selection that follows.
        let old = self.active.as_mut().filter(|old| !old.settled);
        let mut ages = old.map(|old| std::mem::take(&mut old.ages)).unwrap_or_default();
        ages.retain(|key, _| !held.contains(*key));
        Some(ViewSelection::new(land, view, ages))
    }

    /// Makes the view of a selection the active one. Returns its chunks, prefetch included.
    pub(super) fn apply(&mut self, selection: ViewSelection, land: &Land) -> FxHashSet<ChunkKey> {
        self.selecting = None;
        let (view, selected) = selection.finish(land);
        let Selected { chunks, keys, needed, prefetch, ages } = selected;
        self.active = Some(ActiveView { view, chunks, pending: needed, prefetch, ages, settled: false });
        keys
    }

    /// Gives up the selection in progress. Returns the id of its view.
    pub(super) fn fail(&mut self) -> Option<u32> {
        self.selecting.take()
    }

    /// The active view.
    pub(super) fn active(&self) -> Option<&View> {
        self.active.as_ref().map(|active| &active.view)
    }

    /// Whether there is a chunk to request that is not known yet. Drops known ones before it.
    /// `is_known` gets the priority of a chunk that the view needs, and none of a prefetch.
    pub(super) fn has_next(&mut self, mut is_known: impl FnMut(ChunkKey, Option<u64>) -> bool) -> bool {
        let Some(active) = &mut self.active else { return false };
        while active.pending.pop_if(|(priority, key)| is_known(*key, Some(*priority))).is_some() {}
        if !active.pending.is_empty() || !active.settled {
            return !active.pending.is_empty();
        }
        while active.prefetch.pop_if(|(_, key)| is_known(*key, None)).is_some() {}
        !active.prefetch.is_empty()
    }

    /// The chunk that [`ViewQueue::has_next`] found: a needed one, or a prefetch once the view is
    /// settled.
    pub(super) fn next(&mut self) -> Option<(u64, ChunkKey)> {
        let active = self.active.as_mut()?;
        let prefetch = || active.prefetch.pop_if(|_| active.settled).map(|(_, key)| (0, key));
        active.pending.pop().or_else(prefetch)
    }

    /// Puts a chunk back before all others.
    pub(super) fn requeue(&mut self, priority: u64, key: ChunkKey) {
        if let Some(active) = &mut self.active {
            active.pending.push((priority, key));
        }
    }

    /// Settles the active view if the client holds all its pending chunks. Returns the view's id
    /// and its number of chunks, once.
    pub(super) fn settle(&mut self, held: &HeldChunks) -> Option<(u32, u32)> {
        let active = self.active.as_mut().filter(|active| !active.settled)?;
        while let Some((_, key)) = active.pending.last() {
            if !held.contains(*key) {
                return None;
            }
            active.pending.pop();
        }
        active.settled = true;
        Some((active.view.id, active.chunks))
    }
}
