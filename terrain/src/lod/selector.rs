//! The selection of a view's chunks, in steps of bounded cost.
//!
//! A server selects chunks for many viewers. One selection can take milliseconds, so it is a state
//! machine: [`Selector::step`] examines at most a given number of chunks and returns, and the
//! caller decides when to continue. [`super::select`] runs all steps at once.

use super::{Needed, Progress, Splits, Viewer, level_error, required};
use crate::constants::TOP_LEVEL;
use crate::key::ChunkKey;
use crate::land::Land;
use std::cmp::Reverse;
use std::collections::HashMap;

/// Known chunks that a measurement of errors counts as: about 1 ms.
const MEASUREMENT: usize = 4_000;

/// One running selection.
#[derive(Clone, Debug)]
pub struct Selector {
    land: Land,
    viewer: Viewer,
    /// Most chunks in the result; the coarsest are kept, and of the last level that fits in part
    /// the children of the most urgent splits.
    limit: usize,
    tops: Vec<ChunkKey>,
    splits: Splits,
    /// Errors of the chunks that were examined, units.
    errors: HashMap<ChunkKey, u32>,
    phase: Phase,
    found: Vec<Needed>,
}

#[derive(Clone, Debug)]
enum Phase {
    /// Splits chunks that are too coarse, level by level.
    Split {
        /// Chunks of the level, and how many of them are examined.
        level: Vec<ChunkKey>,
        examined: usize,
        below: Vec<ChunkKey>,
        /// Chunks of all levels so far.
        count: usize,
    },
    /// Adds the splits that balance requires, from the finest level up.
    Balance {
        level: u8,
        examined: usize,
    },
    /// Lists the children of all splits, from the coarsest level down.
    List {
        level: u8,
        listed: usize,
    },
    Done,
}

impl Selector {
    /// A selection of at most `limit` chunks. Costs as much as 25 chunks of a step.
    #[must_use]
    pub fn new(land: &Land, viewer: &Viewer, limit: usize) -> Self {
        let tops = viewer.tops();
        let phase = Phase::Split { level: tops.clone(), examined: 0, below: Vec::new(), count: tops.len() };
        Self {
            land: *land,
            viewer: *viewer,
            limit,
            tops,
            splits: Splits::default(),
            errors: HashMap::new(),
            phase,
            found: Vec::new(),
        }
    }

    /// Whether all steps are done.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done)
    }

    /// Examines at most `chunks` chunks (at least 1), and may also sort the splits of one level. A
    /// measurement of errors counts as 4,000 chunks. Returns whether the selection is done.
    pub fn step(&mut self, chunks: usize) -> bool {
        let mut left = chunks.max(1);
        while left > 0 && !self.is_done() {
            left = left.saturating_sub(self.advance(left));
        }
        self.is_done()
    }

    /// The chunks, parents before children. Runs the remaining steps.
    #[must_use]
    pub fn finish(mut self) -> Vec<Needed> {
        while !self.step(usize::MAX) {}
        self.found
    }

    /// Advances the current phase by at most `chunks` chunks. Returns the number examined, at least
    /// 1.
    fn advance(&mut self, chunks: usize) -> usize {
        match std::mem::replace(&mut self.phase, Phase::Done) {
            Phase::Split { level, examined, below, count } => {
                self.split(level, examined, below, count, chunks)
            }
            Phase::Balance { level, examined } => self.balance(level, examined, chunks),
            Phase::List { level, listed } => self.list(level, listed, chunks),
            Phase::Done => 1,
        }
    }

    fn split(
        &mut self,
        level: Vec<ChunkKey>,
        examined: usize,
        mut below: Vec<ChunkKey>,
        count: usize,
        chunks: usize,
    ) -> usize {
        let viewer = &self.viewer;
        let (mut end, mut work) = (examined, 0);
        while end < level.len() && work < chunks {
            let key = level[end];
            match self.land.known_error(key) {
                Progress::Known(error) => {
                    self.errors.insert(key, error);
                    let error = viewer.screen_error_q4(error, viewer.distance_to(key));
                    if error > viewer.tolerance() {
                        self.splits.insert(key, error);
                        below
                            .extend(key.children().into_iter().flatten().filter(|child| viewer.sees(*child)));
                    }
                    (end, work) = (end + 1, work + 1);
                }
                // One measurement is the work of a small step: chunks that have a known error cost
                // next to nothing.
                Progress::Measured => work = work.saturating_add(MEASUREMENT),
            }
        }
        self.phase = if end < level.len() {
            Phase::Split { level, examined: end, below, count }
        } else if below.is_empty() || count + below.len() >= self.limit {
            self.splits.sort(0);
            Phase::Balance { level: 0, examined: 0 }
        } else {
            Phase::Split { count: count + below.len(), level: below, examined: 0, below: Vec::new() }
        };
        work.max(1)
    }

    fn balance(&mut self, level: u8, examined: usize, chunks: usize) -> usize {
        let fine = std::mem::take(&mut self.splits.levels[usize::from(level)]);
        let end = examined.saturating_add(chunks).min(fine.len());
        for (key, urgency) in &fine[examined..end] {
            for above in required(*key, &self.viewer) {
                self.splits.insert(above, *urgency);
            }
        }
        self.phase = if end < fine.len() {
            Phase::Balance { level, examined: end }
        } else if level < self.viewer.top_level() {
            self.splits.sort(level + 1);
            Phase::Balance { level: level + 1, examined: 0 }
        } else {
            self.list_tops();
            Phase::List { level: TOP_LEVEL, listed: 0 }
        };
        self.splits.levels[usize::from(level)] = fine;
        (end - examined).max(1)
    }

    fn list_tops(&mut self) {
        let above = |key: &ChunkKey| level_error((key.level() + 1).min(TOP_LEVEL));
        self.found = self.tops.iter().map(|key| self.needed(*key, above(key), 0)).collect();
        self.found.truncate(self.limit);
    }

    fn list(&mut self, level: u8, listed: usize, chunks: usize) -> usize {
        let splits = &mut self.splits.levels[usize::from(level)];
        if listed == 0 && self.found.len() + 4 * splits.len() > self.limit {
            splits.sort_unstable_by_key(|(key, urgency)| (Reverse(*urgency), *key));
        }
        let splits = &self.splits.levels[usize::from(level)];
        let end = listed.saturating_add(chunks).min(splits.len());
        let mut found = std::mem::take(&mut self.found);
        for (key, urgency) in &splits[listed..end] {
            if found.len() >= self.limit {
                break;
            }
            // A split that only balance requires has no known error.
            let error = self.errors.get(key).copied().unwrap_or_else(|| level_error(key.level()));
            let children = key.children().into_iter().flatten().filter(|child| self.viewer.sees(*child));
            found.extend(children.map(|child| self.needed(child, error, *urgency)));
        }
        found.truncate(self.limit);
        self.phase = if end < splits.len() {
            Phase::List { level, listed: end }
        } else if level > 0 && found.len() < self.limit {
            Phase::List { level: level - 1, listed: 0 }
        } else {
            Phase::Done
        };
        self.found = found;
        (end - listed).max(1)
    }

    fn needed(&self, key: ChunkKey, error: u32, urgency: u32) -> Needed {
        let distance = self.viewer.distance_to(key);
        Needed { key, distance, gain_q4: self.viewer.screen_error_q4(error, distance).max(urgency) }
    }
}

impl Splits {
    /// Sorts the splits of a level and keeps each once, with the largest urgency.
    pub(super) fn sort(&mut self, level: u8) {
        let splits = &mut self.levels[usize::from(level)];
        splits.sort_unstable_by_key(|(key, urgency)| (*key, Reverse(*urgency)));
        splits.dedup_by_key(|(key, _)| *key);
    }
}

#[cfg(test)]
mod tests {
    use super::super::select;
    use super::*;

    #[test]
    fn steps_of_every_size_select_the_same_chunks() {
        let land = Land::new(1);
        let viewer =
            Viewer { eye: (700, 2000, -9000), distance_m: 3000, pixels_per_radian: 312, tolerance_q4: 24 };
        for limit in [0, 10, 100, usize::MAX] {
            let whole = select(&land, &viewer, limit);
            for size in [0, 1, 7, 100] {
                let mut selector = Selector::new(&land, &viewer, limit);
                let mut steps = 0;
                while !selector.step(size) {
                    steps += 1;
                }
                assert!(steps > 3 || size == 100 || limit == 0, "{steps} steps of {size}");
                assert_eq!(selector.finish(), whole, "steps of {size}, limit {limit}");
            }
        }
    }

    #[test]
    fn a_selection_beyond_the_limit_keeps_the_children_of_the_most_urgent_splits() {
        let land = Land::new(1);
        let viewer = Viewer { eye: (0, 0, 0), distance_m: 65_536, pixels_per_radian: 1, tolerance_q4: 16 };
        let key = |x| ChunkKey::new(1, x, 0).unwrap();
        for (limit, kept) in [(20, vec![0, 1, 2, 3, 4]), (8, vec![3, 1]), (7, vec![3, 1]), (4, vec![3])] {
            for chunks in [1, 100] {
                let mut selector = Selector::new(&land, &viewer, limit);
                let urgencies = [20, 50, 30, 60, 10];
                selector.splits.levels[1] = (0..).map(key).zip(urgencies).collect();
                selector.phase = Phase::List { level: 1, listed: 0 };
                while !selector.step(chunks) {}
                let found: Vec<_> = selector.finish().iter().map(|needed| needed.key).collect();
                let children = kept.iter().flat_map(|x| key(*x).children().unwrap());
                assert_eq!(found, children.take(limit).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn a_step_examines_as_many_chunks_as_it_is_given_and_counts_them() {
        let land = Land::new(1);
        // Chunks of level 9, whose errors take no measurement.
        let viewer = Viewer { eye: (0, 0, 0), distance_m: 65_536, pixels_per_radian: 1, tolerance_q4: 16 };
        let mut selector = Selector::new(&land, &viewer, usize::MAX);
        assert!(!selector.step(3) && matches!(selector.phase, Phase::Split { examined: 3, .. }));
        assert!(!selector.step(2) && matches!(selector.phase, Phase::Split { examined: 5, .. }));
        selector.splits.levels[0] = (0..5).map(|x| (ChunkKey::new(0, x, 0).unwrap(), 20)).collect();
        for phase in [Phase::Balance { level: 0, examined: 2 }, Phase::List { level: 0, listed: 2 }] {
            selector.phase = phase;
            assert_eq!(selector.advance(100), 3);
        }
    }
}
