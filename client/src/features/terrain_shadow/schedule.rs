//! Schedule of shadow traces. Knows neither clock nor GPU.
//!
//! A shadow is current if it was traced for the drawn chunks and the current sun. Visible chunks
//! come before others, chunks without a shadow before those with an old one, older before newer,
//! then nearest first. So no visible chunk starves while the camera moves.

use crate::features::terrain_shadow::page_table::{Page, PageTable};
use crate::features::terrain_shadow::sun::sun_params;
use glam::Vec3;
use shaders::layout::{ShadowTarget, SunParams};

/// A drawn chunk, and whether it is visible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// The chunk.
    pub page: Page,
    /// Whether it may be visible.
    pub is_visible: bool,
}

/// Limits of one batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Chunks at most.
    pub chunks: usize,
    /// Of these, at most this many invisible chunks, so that a turning camera finds their shadows
    /// done.
    pub hidden: usize,
}

/// One batch of work for the GPU. Counts as done once it was returned.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowBatch<'a> {
    /// Sun and extent.
    pub sun: SunParams,
    /// The page table, if it changed since the last batch.
    pub table: Option<&'a PageTable>,
    /// Chunks to trace.
    pub targets: Vec<ShadowTarget>,
}

/// The state of all shadows.
#[derive(Clone, Debug)]
pub struct Schedule {
    /// By slot: the epoch of its shadow, 0 for none.
    traced: Vec<u64>,
    /// Counts changes of the drawn chunks and of the sun.
    epoch: u64,
    /// Drawn chunks, sorted.
    pages: Vec<Page>,
    sun: Vec3,
    table: PageTable,
    /// Whether the GPU lacks the current table.
    table_changed: bool,
}

impl Schedule {
    /// A schedule for a pool of so many slots.
    #[must_use]
    pub fn new(slots: u32) -> Self {
        Self {
            traced: vec![0; slots as usize],
            epoch: 1,
            pages: Vec::new(),
            sun: Vec3::Y,
            table: PageTable::default(),
            table_changed: true,
        }
    }

    /// Marks a slot's shadow as unknown: it holds another chunk.
    pub fn forget(&mut self, slot: u32) {
        if let Some(traced) = self.traced.get_mut(slot as usize) {
            *traced = 0;
        }
    }

    /// Updates the drawn chunks (nearest first) and the sun. Only compares if nothing changed.
    pub fn update(&mut self, candidates: &[Candidate], sun: Vec3) {
        let mut pages: Vec<Page> = candidates.iter().map(|candidate| candidate.page).collect();
        pages.sort_unstable();
        if pages != self.pages {
            self.table = PageTable::of(&pages, self.traced.len() as u32);
            self.pages = pages;
            self.table_changed = true;
            self.epoch += 1;
        }
        // By bits, so that NaN equals itself.
        if sun.to_array().map(f32::to_bits) != self.sun.to_array().map(f32::to_bits) {
            self.sun = sun;
            self.epoch += 1;
        }
    }

    /// Number of visible chunks whose shadow is missing or old.
    #[must_use]
    pub fn pending(&self, candidates: &[Candidate]) -> usize {
        candidates
            .iter()
            .filter(|candidate| candidate.is_visible && !self.is_current(candidate.page.slot))
            .count()
    }

    /// The next batch; none if all shadows are current.
    pub fn next(&mut self, candidates: &[Candidate], quota: Quota) -> Option<ShadowBatch<'_>> {
        let mut waiting: Vec<(bool, u64, usize)> = candidates
            .iter()
            .enumerate()
            .filter(|(_, candidate)| !self.is_current(candidate.page.slot))
            .map(|(nearness, candidate)| {
                (!candidate.is_visible, self.traced_in(candidate.page.slot), nearness)
            })
            .collect();
        waiting.sort_unstable();
        let visible_count = waiting.iter().filter(|(is_hidden, ..)| !is_hidden).count();
        waiting.truncate(quota.chunks.min(visible_count + quota.hidden));
        if waiting.is_empty() {
            return None;
        }
        let mut targets = Vec::with_capacity(waiting.len());
        for (_, _, nearness) in waiting {
            let page = &candidates[nearness].page;
            targets.push(self.table.target(page));
            if let Some(traced) = self.traced.get_mut(page.slot as usize) {
                *traced = self.epoch;
            }
        }
        let table = std::mem::take(&mut self.table_changed).then_some(&self.table);
        Some(ShadowBatch { sun: sun_params(self.sun, &self.table), table, targets })
    }

    fn traced_in(&self, slot: u32) -> u64 {
        // A slot beyond the pool never has a shadow.
        self.traced.get(slot as usize).copied().unwrap_or(self.epoch)
    }

    fn is_current(&self, slot: u32) -> bool {
        self.traced_in(slot) == self.epoch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::ChunkKey;

    /// Chunks 0 to n - 1 in slots of the same number, the first `seen` of them in sight.
    fn drawn(n: i32, seen: i32) -> Vec<Candidate> {
        let page = |x: i32| Page { key: ChunkKey::new(0, x, 0).unwrap(), slot: x as u32, max_height: 100 };
        (0..n).map(|x| Candidate { page: page(x), is_visible: x < seen }).collect()
    }

    fn slots(casting: Option<ShadowBatch<'_>>) -> Vec<u32> {
        casting.map_or(Vec::new(), |casting| casting.targets.iter().map(|target| target.slot).collect())
    }

    fn upto(chunks: usize) -> Quota {
        Quota { chunks, hidden: chunks }
    }

    const SUN: Vec3 = Vec3::new(0.6, 0.8, 0.0);

    #[test]
    fn everything_is_done_once_nearest_first_and_then_nothing() {
        let (mut schedule, drawn) = (Schedule::new(10), drawn(5, 3));
        schedule.update(&drawn, SUN);
        assert_eq!(schedule.pending(&drawn), 3);
        let first = schedule.next(&drawn, upto(2)).unwrap();
        assert!(first.table.is_some(), "the GPU needs the table");
        assert_eq!(slots(Some(first)), [0, 1]);
        let second = schedule.next(&drawn, upto(2)).unwrap();
        assert!(second.table.is_none(), "it has it");
        assert_eq!(slots(Some(second)), [2, 3]);
        assert_eq!(schedule.pending(&drawn), 0);
        assert_eq!(slots(schedule.next(&drawn, upto(2))), [4]);
        schedule.update(&drawn, SUN);
        assert_eq!(schedule.next(&drawn, upto(2)), None);
    }

    #[test]
    fn what_is_out_of_sight_gets_a_share_of_its_own() {
        let (mut schedule, drawn) = (Schedule::new(10), drawn(8, 3));
        schedule.update(&drawn, SUN);
        let quota = |chunks, hidden| Quota { chunks, hidden };
        assert_eq!(slots(schedule.next(&drawn, quota(2, 1))), [0, 1]);
        assert_eq!(slots(schedule.next(&drawn, quota(4, 1))), [2, 3]);
        assert_eq!(schedule.next(&drawn, quota(4, 0)), None);
        assert_eq!(slots(schedule.next(&drawn, quota(4, 2))), [4, 5]);
    }

    #[test]
    fn another_sun_or_another_drawn_chunk_makes_all_shadows_old_and_another_gaze_none() {
        let mut schedule = Schedule::new(10);
        schedule.update(&drawn(4, 4), SUN);
        schedule.next(&drawn(4, 4), upto(10));
        for (drawn, sun, old) in [(drawn(4, 2), SUN, 0), (drawn(4, 4), Vec3::Y, 4), (drawn(5, 5), Vec3::Y, 5)]
        {
            schedule.update(&drawn, sun);
            assert_eq!(schedule.pending(&drawn), old);
            schedule.next(&drawn, upto(10));
        }
    }

    #[test]
    fn a_chunk_without_a_shadow_comes_before_those_with_an_old_one() {
        let (mut schedule, drawn) = (Schedule::new(10), drawn(4, 4));
        schedule.update(&drawn, SUN);
        schedule.next(&drawn, upto(10));
        schedule.forget(2);
        schedule.forget(99);
        schedule.update(&drawn, Vec3::Y);
        assert_eq!(slots(schedule.next(&drawn, upto(10))), [2, 0, 1, 3]);
    }

    #[test]
    fn under_a_sun_that_moves_every_frame_all_get_their_turn() {
        let (mut schedule, drawn) = (Schedule::new(10), drawn(6, 6));
        let mut turns = [0; 6];
        for frame in 0..30 {
            schedule.update(&drawn, Vec3::new(0.6, 0.8, frame as f32 * 1e-3));
            for slot in slots(schedule.next(&drawn, upto(2))) {
                turns[slot as usize] += 1;
            }
        }
        assert_eq!(turns, [10; 6]);
    }
}
