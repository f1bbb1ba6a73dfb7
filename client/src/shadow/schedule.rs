//! Whose shadow is found next. Knows neither clock nor GPU.
//!
//! A shadow is up to date if it was found for the chunks that are drawn and for the sun that
//! shines. Chunks in sight come before others, those without any shadow before those whose shadow
//! is old, old ones in the order of their age, equals nearest first: no chunk waits for ever while
//! the camera moves.

use crate::shadow::caster;
use crate::shadow::table::{Page, PageTable};
use glam::Vec3;
use shaders::layout::{CastTarget, Caster};

/// A chunk that is drawn, and whether it can be seen from here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// The chunk.
    pub page: Page,
    /// Whether it may be in the picture.
    pub in_sight: bool,
}

/// How much may be done at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Chunks at most.
    pub chunks: usize,
    /// Of these, chunks at most that are out of sight, so that a turning camera finds their shadows
    /// there.
    pub ahead: usize,
}

/// What the GPU is to do. Counts as done once it was handed out.
#[derive(Clone, Debug, PartialEq)]
pub struct Casting<'a> {
    /// Sun and extent.
    pub caster: Caster,
    /// The page table, where it is not the one of the last casting.
    pub table: Option<&'a PageTable>,
    /// Chunks whose shadows are to be found.
    pub targets: Vec<CastTarget>,
}

/// The state of all shadows.
#[derive(Clone, Debug)]
pub struct Schedule {
    /// By slot: the epoch that its shadow was found in, 0 for never.
    found: Vec<u64>,
    /// Counts the changes of what a shadow depends on.
    epoch: u64,
    /// What is drawn, sorted.
    pages: Vec<Page>,
    sun: Vec3,
    table: PageTable,
    /// Whether the GPU has not seen the table yet.
    is_fresh: bool,
}

impl Schedule {
    /// A schedule for a pool of so many slots.
    #[must_use]
    pub fn new(slots: u32) -> Self {
        Self {
            found: vec![0; slots as usize],
            epoch: 1,
            pages: Vec::new(),
            sun: Vec3::Y,
            table: PageTable::default(),
            is_fresh: true,
        }
    }

    /// Notes that a slot holds another chunk: its shadow is unknown.
    pub fn forget(&mut self, slot: u32) {
        if let Some(found) = self.found.get_mut(slot as usize) {
            *found = 0;
        }
    }

    /// Takes note of what is drawn (nearest first) and where the sun is. Free if nothing has
    /// changed, but for the comparison.
    pub fn update(&mut self, candidates: &[Candidate], sun: Vec3) {
        let mut pages: Vec<Page> = candidates.iter().map(|candidate| candidate.page).collect();
        pages.sort_unstable();
        if pages != self.pages {
            self.table = PageTable::of(&pages, self.found.len() as u32);
            self.pages = pages;
            self.is_fresh = true;
            self.epoch += 1;
        }
        // By bits: a sun that is no number must not differ from itself for ever.
        if sun.to_array().map(f32::to_bits) != self.sun.to_array().map(f32::to_bits) {
            self.sun = sun;
            self.epoch += 1;
        }
    }

    /// How many chunks in sight have no shadow or an old one.
    #[must_use]
    pub fn pending(&self, candidates: &[Candidate]) -> usize {
        candidates
            .iter()
            .filter(|candidate| candidate.in_sight && !self.is_current(candidate.page.slot))
            .count()
    }

    /// The next chunks to do; nothing if all is up to date.
    pub fn next(&mut self, candidates: &[Candidate], quota: Quota) -> Option<Casting<'_>> {
        let mut waiting: Vec<(bool, u64, usize)> = candidates
            .iter()
            .enumerate()
            .filter(|(_, candidate)| !self.is_current(candidate.page.slot))
            .map(|(nearness, candidate)| (!candidate.in_sight, self.found_in(candidate.page.slot), nearness))
            .collect();
        waiting.sort_unstable();
        let in_sight = waiting.iter().filter(|(is_hidden, ..)| !is_hidden).count();
        waiting.truncate(quota.chunks.min(in_sight + quota.ahead));
        if waiting.is_empty() {
            return None;
        }
        let mut targets = Vec::with_capacity(waiting.len());
        for (_, _, nearness) in waiting {
            let page = &candidates[nearness].page;
            targets.push(self.table.target(page));
            if let Some(found) = self.found.get_mut(page.slot as usize) {
                *found = self.epoch;
            }
        }
        let table = std::mem::take(&mut self.is_fresh).then_some(&self.table);
        Some(Casting { caster: caster(self.sun, &self.table), table, targets })
    }

    fn found_in(&self, slot: u32) -> u64 {
        // A slot beyond the pool has no shadow that could be found.
        self.found.get(slot as usize).copied().unwrap_or(self.epoch)
    }

    fn is_current(&self, slot: u32) -> bool {
        self.found_in(slot) == self.epoch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::ChunkKey;

    /// Chunks 0 to n - 1 in slots of the same number, the first `seen` of them in sight.
    fn drawn(n: i32, seen: i32) -> Vec<Candidate> {
        let page = |x: i32| Page { key: ChunkKey::new(0, x, 0).unwrap(), slot: x as u32, top: 100 };
        (0..n).map(|x| Candidate { page: page(x), in_sight: x < seen }).collect()
    }

    fn slots(casting: Option<Casting<'_>>) -> Vec<u32> {
        casting.map_or(Vec::new(), |casting| casting.targets.iter().map(|target| target.slot).collect())
    }

    fn upto(chunks: usize) -> Quota {
        Quota { chunks, ahead: chunks }
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
        let quota = |chunks, ahead| Quota { chunks, ahead };
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
