//! Errors of chunks before they are generated: proved bounds, computed once and remembered.
//!
//! - Levels 1 to 3 are measured against every level-0 vertex under them. One measurement covers a
//!   chunk of level 1 (256 m along a side), and its part of the chunks of levels 2 and 3 above it:
//!   129 x 129 vertices of level 0, some 0.1 ms.
//! - Level [`COMPOSED_LEVEL`] follows from its children: its distance from each child, and the
//!   child's error. One measurement covers one child.
//! - Levels 5 to [`SAMPLED_LEVEL`] are compared with every node of the base field under them; what
//!   is between nodes is bounded (`sampled`). One measurement covers a part of the chunk: up to
//!   7,000 nodes, some 0.1 ms.
//! - Above, the bound is the whole range of heights.
//!
//! A measurement is short, because a server makes it within one turn of a session, which others
//! wait for.

use super::RELIEF;
use super::sampled::{self, sampled};
use crate::constants::{CELLS, VERTEX_COUNT, VERTICES};
use crate::grid::Grid;
use crate::key::ChunkKey;
use crate::land::Land;
use crate::octaves::Octaves;
use crate::simd::{Window, farthest};
use crate::triangles::drawn_height_scaled;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// The level up to which errors are measured.
pub const MEASURED_LEVEL: u8 = 3;
/// The level whose errors follow from those of its children.
pub const COMPOSED_LEVEL: u8 = 4;
/// The level up to which errors are measured against the nodes of the base field.
pub const SAMPLED_LEVEL: u8 = 7;

/// Errors remembered per generation of the memory: a view of 20 km needs some 10,000.
const REMEMBERED: usize = 1 << 16;

/// Entries that one measurement may add to a full generation.
const MOST_AT_ONCE: usize = 16;

/// What [`Land::known_error`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The bound, units.
    Known(u32),
    /// One measurement was made; more are needed.
    Measured,
}

/// What is remembered of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Entry {
    /// The bound, units.
    Known(u32),
    /// Some chunks of level 1 under it are measured: a bit for each, row by row, and the largest
    /// error so far.
    Measured { parts: u16, worst: u32 },
    /// The children before this one are compared with the chunk, and the largest bound so far.
    Composed { next: u8, worst: u32 },
    /// The parts before this one are compared with the nodes under them.
    Sampled { next: u8, worst: sampled::Worst },
}

/// Two generations: when the younger is full, it becomes the older, and what was not asked for
/// since is forgotten.
static MEMORY: Mutex<Option<[Errors; 2]>> = Mutex::new(None);

/// What is remembered, by world seed and chunk.
type Errors = HashMap<(u64, ChunkKey), Entry>;

impl Land {
    /// The error bound of a chunk, or one measurement towards it.
    #[must_use]
    pub fn known_error(&self, key: ChunkKey) -> Progress {
        if let Some(error) = error_of_level(key.level()) {
            return Progress::Known(error);
        }
        let (x, z) = key.origin();
        let is_open_sea = || self.archipelago().is_open_sea(x, z, key.side());
        let entry = self.remembered(key);
        if let Some(Entry::Known(error)) = entry {
            return Progress::Known(error);
        }
        // Remembered too: finding the lobes near a chunk takes a microsecond, and a view asks for
        // each of its chunks many times.
        if entry.is_none() && is_open_sea() {
            self.remember([(key, Entry::Known(0))]);
            return Progress::Known(0);
        }
        if key.level() <= MEASURED_LEVEL {
            self.measure(first_unmeasured(key, entry));
            return Progress::Measured;
        }
        if key.level() > COMPOSED_LEVEL {
            self.sample(key, entry);
            return Progress::Measured;
        }
        let mut errors = [0; 4];
        let children = key.children().expect("a level above 0 has children");
        for (child, error) in children.into_iter().zip(&mut errors) {
            match self.known_error(child) {
                Progress::Known(known) => *error = known,
                Progress::Measured => return Progress::Measured,
            }
        }
        self.compose(key, children, errors, entry);
        Progress::Measured
    }

    /// The error bound of a chunk, with all measurements that it needs.
    #[must_use]
    pub fn error_of(&self, key: ChunkKey) -> u32 {
        loop {
            if let Progress::Known(error) = self.known_error(key) {
                return error;
            }
        }
    }

    /// Whether the error bound of a chunk is known without a measurement: the chunk takes the time
    /// of its heights alone. Errors are remembered by process, so this may change at any time.
    #[must_use]
    pub fn is_error_remembered(&self, key: ChunkKey) -> bool {
        error_of_level(key.level()).is_some() || matches!(self.remembered(key), Some(Entry::Known(_)))
    }

    fn remembered(&self, key: ChunkKey) -> Option<Entry> {
        let id = (self.world_seed(), key);
        let mut memory = MEMORY.lock().unwrap_or_else(PoisonError::into_inner);
        let [young, old] = memory.as_mut()?;
        if let Some(entry) = young.get(&id) {
            return Some(*entry);
        }
        let entry = old.remove(&id)?;
        young.insert(id, entry);
        Some(entry)
    }

    fn remember(&self, entries: impl IntoIterator<Item = (ChunkKey, Entry)>) {
        let mut memory = MEMORY.lock().unwrap_or_else(PoisonError::into_inner);
        let seed = self.world_seed();
        let [young, _] = generations(&mut memory);
        young.extend(entries.into_iter().map(|(key, entry)| ((seed, key), entry)));
    }

    /// Changes what is remembered of a chunk in one step, since another thread may have measured a
    /// part of it in the meantime.
    fn update(&self, key: ChunkKey, change: impl FnOnce(Option<Entry>) -> Entry) {
        let mut memory = MEMORY.lock().unwrap_or_else(PoisonError::into_inner);
        let id = (self.world_seed(), key);
        let [young, old] = generations(&mut memory);
        let before = young.get(&id).copied().or_else(|| old.remove(&id));
        young.insert(id, change(before));
    }

    /// Measures a chunk of level 1, and the part of the chunks above it up to [`MEASURED_LEVEL`].
    fn measure(&self, part: ChunkKey) {
        let (x, z) = part.origin();
        let grid = Grid::new(x, z, 0, Window::SIDE, Window::SIDE).expect("a chunk lies in the world");
        let mut fine = Window::new();
        self.heights(&grid, fine.heights_mut());
        for key in std::iter::successors(Some(part), |key| key.parent()) {
            if key.level() > MEASURED_LEVEL {
                break;
            }
            let error = farthest(key.level(), &self.thinned(&fine, &grid, key.level()), &fine);
            self.update(key, |entry| with_part(entry, key, part, error));
        }
    }

    /// The vertices of a level in a window of level 0, row by row: those of the window itself where
    /// the level carries all octaves.
    fn thinned(&self, fine: &Window, grid: &Grid, level: u8) -> Vec<i32> {
        let side = ((Window::SIDE - 1) >> level) + 1;
        if Octaves::at_level(level) == grid.octaves() {
            return fine.thinned(level);
        }
        let coarse = Grid::new(grid.x, grid.z, level, side, side).expect("a part of the window");
        let mut heights = vec![0; side * side];
        self.heights(&coarse, &mut heights);
        heights
    }

    /// Compares the next part of a chunk with the nodes under it.
    fn sample(&self, key: ChunkKey, entry: Option<Entry>) {
        let (next, before) = match entry {
            Some(Entry::Sampled { next, worst }) => (next, worst),
            _ => (0, sampled::Worst::default()),
        };
        let worst = before.and(sampled(self, key, next));
        let after = match next + 1 == sampled::parts(key) {
            true => Entry::Known(worst.bound()),
            false => Entry::Sampled { next: next + 1, worst },
        };
        self.update(key, |now| further(now, after));
    }

    /// Compares the next child of a chunk with it.
    fn compose(&self, key: ChunkKey, children: [ChunkKey; 4], errors: [u32; 4], entry: Option<Entry>) {
        let (next, before) = match entry {
            Some(Entry::Composed { next, worst }) => (next, worst),
            _ => (0, 0),
        };
        let child = usize::from(next);
        let first = child / 2 * CELLS / 2;
        let heights = self.heights_of_rows(key, first..first + CELLS / 2 + 1);
        let bound = apart(&heights, &self.chunk_heights(children[child]), child) + errors[child];
        let worst = before.max(bound);
        let after = match child + 1 == children.len() {
            true => Entry::Known(worst),
            false => Entry::Composed { next: next + 1, worst },
        };
        self.update(key, |now| further(now, after));
    }

    /// The heights of some rows of vertices of a chunk; all others are 0.
    pub(super) fn heights_of_rows(&self, key: ChunkKey, rows: Range<usize>) -> Box<[i32; VERTEX_COUNT]> {
        let (x, z) = key.origin();
        let z = z + rows.start as i32 * key.spacing();
        let grid = Grid::new(x, z, key.level(), VERTICES, rows.len()).expect("a part of a chunk");
        let mut heights = Box::new([0; VERTEX_COUNT]);
        self.heights(&grid, &mut heights[rows.start * VERTICES..rows.end * VERTICES]);
        heights
    }
}

/// The error bound of a chunk, units, where its level alone decides.
const fn error_of_level(level: u8) -> Option<u32> {
    match level {
        0 => Some(0),
        1..=SAMPLED_LEVEL => None,
        // Larger than a cell of the archipelago, which may have an island.
        _ => Some(RELIEF),
    }
}

/// Both generations. A full younger one becomes the older one. Their tables have all the room that
/// they need from the start (8 MiB each, of which the system gives what is used): a table that
/// grows moves all its entries at once, which takes up to 6 ms in the turn of one session.
fn generations(memory: &mut Option<[Errors; 2]>) -> &mut [Errors; 2] {
    let new = || Errors::with_capacity(REMEMBERED + MOST_AT_ONCE);
    let generations = memory.get_or_insert_with(|| [new(), new()]);
    if generations[0].len() >= REMEMBERED {
        generations.swap(0, 1);
        generations[0].clear();
    }
    generations
}

/// The chunks of level 1 along a side of a chunk.
const fn parts_along(key: ChunkKey) -> i32 {
    1 << (key.level() - 1)
}

/// The first chunk of level 1 in a chunk that is not measured.
fn first_unmeasured(key: ChunkKey, entry: Option<Entry>) -> ChunkKey {
    let measured = match entry {
        Some(Entry::Measured { parts, .. }) => parts.trailing_ones() as i32,
        _ => 0,
    };
    let along = parts_along(key);
    let (x, z) = (key.x() * along + measured % along, key.z() * along + measured / along);
    ChunkKey::new(1, x, z).expect("a descendant of a chunk exists")
}

/// The entry of a chunk with the error of one more chunk of level 1 in it.
fn with_part(entry: Option<Entry>, key: ChunkKey, part: ChunkKey, error: u32) -> Entry {
    let along = parts_along(key);
    let bit = 1 << ((part.z() - key.z() * along) * along + part.x() - key.x() * along);
    let (parts, worst) = match entry {
        Some(Entry::Measured { parts, worst }) => (parts | bit, worst.max(error)),
        Some(known @ Entry::Known(_)) => return known,
        _ => (bit, error),
    };
    let all = u16::MAX >> (u16::BITS as i32 - along * along);
    if parts == all { Entry::Known(worst) } else { Entry::Measured { parts, worst } }
}

/// The entry of a chunk with one more part: two threads may compare the same part.
fn further(now: Option<Entry>, found: Entry) -> Entry {
    let parts = |entry: Entry| match entry {
        Entry::Known(_) => u8::MAX,
        Entry::Composed { next, .. } | Entry::Sampled { next, .. } => next,
        Entry::Measured { .. } => 0,
    };
    now.filter(|now| parts(*now) >= parts(found)).unwrap_or(found)
}

/// Largest distance between the drawn surface of a chunk and the vertices of one of its children,
/// units, rounded up.
fn apart(heights: &[i32; VERTEX_COUNT], child: &[i32; VERTEX_COUNT], index: usize) -> u32 {
    let (column, row) = (index % 2 * CELLS, index / 2 * CELLS);
    let mut worst = 0;
    for z in 0..VERTICES {
        for x in 0..VERTICES {
            let drawn = drawn_height_scaled(heights, column + x, row + z, 1);
            worst = worst.max(drawn.abs_diff(2 * i64::from(child[z * VERTICES + x])));
        }
    }
    worst.div_ceil(2) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::position::Position;

    /// The truth by brute force: every level-0 vertex, thinned out by a step.
    fn truth(land: &Land, key: ChunkKey, step: usize) -> u32 {
        let heights = land.chunk_heights(key);
        let (x, z) = key.origin();
        let side = CELLS << key.level();
        let mut worst = 0;
        for row in (0..=side).step_by(step) {
            for column in (0..=side).step_by(step) {
                let drawn = drawn_height_scaled(&heights, column, row, key.level());
                let place = Position::new(x + column as i32 * 512, z + row as i32 * 512).unwrap();
                worst = worst.max(drawn.abs_diff(i64::from(land.height_at(place)) << key.level()));
            }
        }
        worst.div_ceil(1 << key.level()) as u32
    }

    #[test]
    fn errors_are_exact_where_measured_and_bounds_where_sampled() {
        let land = Land::new(3);
        for (level, x, z) in
            [(1, 4, -3), (2, -3, 2), (3, 1, 1), (4, -1, 0), (5, 0, -1), (6, -1, -1), (7, 0, 0)]
        {
            let key = ChunkKey::new(level, x, z).unwrap();
            let error = land.error_of(key);
            let truth = truth(&land, key, [1, 1, 1, 1, 5, 5, 17, 61][usize::from(level)]);
            if level <= MEASURED_LEVEL {
                assert_eq!(error, truth, "{key}");
            } else {
                assert!(error >= truth && error < 4 * truth, "{key}: {error} against {truth}");
            }
        }
    }

    #[test]
    fn one_step_makes_one_measurement_and_a_known_error_takes_none() {
        let land = Land::new(0x5eed_0001);
        let key = ChunkKey::new(4, 0, 0).unwrap();
        let steps = (0..).take_while(|_| land.known_error(key) == Progress::Measured).count();
        assert!((5..=68).contains(&steps), "{steps} steps for 64 chunks of level 1 and 4 children");
        assert!(matches!(land.known_error(key), Progress::Known(1..)));
        assert_eq!(land.known_error(ChunkKey::new(0, 5, 5).unwrap()), Progress::Known(0));
        assert_eq!(land.known_error(ChunkKey::new(9, 0, 0).unwrap()), Progress::Known(RELIEF));
    }

    #[test]
    fn an_error_is_remembered_after_its_last_measurement_and_a_query_measures_nothing() {
        let land = Land::new(0x5eed_0003);
        let key = ChunkKey::new(3, 0, 0).unwrap();
        for _ in 0..16 {
            assert!(!land.is_error_remembered(key));
            assert_eq!(land.known_error(key), Progress::Measured, "of a chunk of level 1");
        }
        assert!(land.is_error_remembered(key));
        for (level, x, is_known) in
            [(0, -1, true), (1, -1, false), (7, -1, false), (8, -1, true), (16, 0, true)]
        {
            assert_eq!(land.is_error_remembered(ChunkKey::new(level, x, 0).unwrap()), is_known, "{level}");
        }
    }

    #[test]
    fn the_memory_forgets_what_is_not_asked_for() {
        let land = Land::new(0x5eed_0002);
        let key = |n: usize| ChunkKey::new(1, (n % 8192) as i32, (n / 8192) as i32).unwrap();
        let asked = ChunkKey::new(1, -1, -1).unwrap();
        land.remember([(asked, Entry::Known(7))]);
        for start in (0..3 * REMEMBERED).step_by(1000) {
            land.remember((start..start + 1000).map(|n| (key(n), Entry::Known(1))));
            assert_eq!(land.remembered(asked), Some(Entry::Known(7)), "asked for again and again");
        }
        for start in (3 * REMEMBERED..6 * REMEMBERED).step_by(1000) {
            land.remember((start..start + 1000).map(|n| (key(n), Entry::Known(1))));
        }
        assert_eq!(land.remembered(asked), None);
    }

    #[test]
    fn a_part_that_is_measured_again_changes_nothing() {
        let (key, part) = (ChunkKey::new(2, -1, 3).unwrap(), ChunkKey::new(1, -1, 6).unwrap());
        let once = with_part(None, key, part, 5);
        assert_eq!(once, Entry::Measured { parts: 0b10, worst: 5 });
        assert_eq!(with_part(Some(once), key, part, 5), once);
        assert_eq!(with_part(Some(Entry::Known(9)), key, part, 5), Entry::Known(9));
    }
}
