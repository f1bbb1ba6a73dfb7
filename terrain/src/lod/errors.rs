//! Errors of chunks before they are generated: proved bounds, computed once and remembered.
//!
//! - Levels 1 to 3 are measured against every level-0 vertex under them. One measurement covers a
//!   chunk of level 3 (1 km²) and the 20 chunks under it, and evaluates 64 chunks: about 2 ms.
//! - Level [`COMPOSED_LEVEL`] follows from its children: its distance from each child, and the
//!   child's error.
//! - Levels 5 to [`SAMPLED_LEVEL`] are compared with every node of the base field under them; what
//!   is between nodes is bounded (`sampled`). At most 264,196 nodes (level 7).
//! - Above, the bound is the whole range of heights.

use super::RELIEF;
use super::sampled::sampled;
use crate::constants::{CELLS, VERTEX_COUNT, VERTICES};
use crate::grid::Grid;
use crate::key::ChunkKey;
use crate::land::Land;
use crate::simd::farthest;
use crate::triangles::drawn_height_scaled;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// The level up to which errors are measured.
pub const MEASURED_LEVEL: u8 = 3;
/// The level whose errors follow from those of its children.
pub const COMPOSED_LEVEL: u8 = 4;
/// The level up to which errors are measured against the nodes of the base field.
pub const SAMPLED_LEVEL: u8 = 7;

/// Errors remembered per generation of the memory: a view of 20 km needs some 10,000.
const REMEMBERED: usize = 1 << 16;

/// What [`Land::known_error`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The bound, units.
    Known(u32),
    /// One measurement was made; more are needed.
    Measured,
}

/// Two generations: when the younger is full, it becomes the older, and what was not asked for since
/// is forgotten.
static MEMORY: Mutex<Option<[Errors; 2]>> = Mutex::new(None);

/// Errors by world seed and chunk, units.
type Errors = HashMap<(u64, ChunkKey), u32>;

impl Land {
    /// The error bound of a chunk, or one measurement towards it.
    #[must_use]
    pub fn known_error(&self, key: ChunkKey) -> Progress {
        if key.level() == 0 {
            return Progress::Known(0);
        }
        let (x, z) = key.origin();
        let is_open_sea = || self.archipelago().is_open_sea(x, z, key.side());
        if key.level() > SAMPLED_LEVEL {
            return Progress::Known(if is_open_sea() { 0 } else { RELIEF });
        }
        if let Some(error) = self.remembered(key) {
            return Progress::Known(error);
        }
        // Remembered too: finding the lobes near a chunk takes a microsecond, and a view asks for
        // each of its chunks many times.
        if is_open_sea() {
            self.remember([(key, 0)]);
            return Progress::Known(0);
        }
        if key.level() <= MEASURED_LEVEL {
            let measured = std::iter::successors(Some(key), |key| key.parent())
                .find(|above| above.level() == MEASURED_LEVEL)
                .unwrap_or(key);
            self.measure(measured);
            return Progress::Measured;
        }
        if key.level() > COMPOSED_LEVEL {
            self.remember([(key, sampled(self, key))]);
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
        self.compose(key, children, errors);
        Progress::Measured
    }

    /// The error bound of a chunk: one measurement if it was not asked for before.
    #[must_use]
    pub fn error_of(&self, key: ChunkKey) -> u32 {
        loop {
            if let Progress::Known(error) = self.known_error(key) {
                return error;
            }
        }
    }

    fn remembered(&self, key: ChunkKey) -> Option<u32> {
        let entry = (self.world_seed(), key);
        let mut memory = MEMORY.lock().unwrap_or_else(PoisonError::into_inner);
        let [young, old] = memory.as_mut()?;
        if let Some(error) = young.get(&entry) {
            return Some(*error);
        }
        let error = old.remove(&entry)?;
        young.insert(entry, error);
        Some(error)
    }

    fn remember(&self, errors: impl IntoIterator<Item = (ChunkKey, u32)>) {
        let mut memory = MEMORY.lock().unwrap_or_else(PoisonError::into_inner);
        let generations = memory.get_or_insert_with(Default::default);
        if generations[0].len() >= REMEMBERED {
            generations[1] = std::mem::take(&mut generations[0]);
        }
        let seed = self.world_seed();
        generations[0].extend(errors.into_iter().map(|(key, error)| ((seed, key), error)));
    }

    /// Measures a chunk of [`MEASURED_LEVEL`] and all chunks between it and level 0.
    fn measure(&self, key: ChunkKey) {
        let side = (CELLS << MEASURED_LEVEL) + 1;
        let (x, z) = key.origin();
        let grid = Grid::new(x, z, 0, side, side).expect("a chunk lies in the world");
        let mut fine = vec![0; side * side];
        self.heights(&grid, &mut fine);
        let mut found = Vec::with_capacity(21);
        let mut level = vec![key];
        for depth in (1..=MEASURED_LEVEL).rev() {
            for key in &level {
                let (column, row) = offset_of(*key, (x, z));
                let error = farthest(&self.chunk_heights(*key), depth, &fine[row * side + column..], side);
                found.push((*key, error));
            }
            level = level.iter().filter_map(|key| key.children()).flatten().collect();
        }
        self.remember(found);
    }

    /// The bound of a chunk from its children's.
    fn compose(&self, key: ChunkKey, children: [ChunkKey; 4], errors: [u32; 4]) {
        let heights = self.chunk_heights(key);
        let bounds = children
            .into_iter()
            .zip(errors)
            .enumerate()
            .map(|(index, (child, error))| apart(&heights, &self.chunk_heights(child), index) + error);
        let bound = bounds.max().unwrap_or(0);
        self.remember([(key, bound)]);
    }
}

/// The first column and row of a chunk in the level-0 grid from a corner.
fn offset_of(key: ChunkKey, (x, z): (i32, i32)) -> (usize, usize) {
    let spacing = 1u32 << crate::constants::SPACING_BITS;
    let (low_x, low_z) = key.origin();
    ((low_x.abs_diff(x) / spacing) as usize, (low_z.abs_diff(z) / spacing) as usize)
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
        assert!((2..=5).contains(&steps), "{steps} steps for four measurements and one comparison");
        assert!(matches!(land.known_error(key), Progress::Known(1..)));
        assert_eq!(land.known_error(ChunkKey::new(0, 5, 5).unwrap()), Progress::Known(0));
        assert_eq!(land.known_error(ChunkKey::new(9, 0, 0).unwrap()), Progress::Known(RELIEF));
    }

    #[test]
    fn the_memory_forgets_what_is_not_asked_for() {
        let land = Land::new(0x5eed_0002);
        let key = |n: usize| ChunkKey::new(1, (n % 8192) as i32, (n / 8192) as i32).unwrap();
        let asked = ChunkKey::new(1, -1, -1).unwrap();
        land.remember([(asked, 7)]);
        for start in (0..3 * REMEMBERED).step_by(1000) {
            land.remember((start..start + 1000).map(|n| (key(n), 1)));
            assert_eq!(land.remembered(asked), Some(7), "asked for again and again");
        }
        for start in (3 * REMEMBERED..6 * REMEMBERED).step_by(1000) {
            land.remember((start..start + 1000).map(|n| (key(n), 1)));
        }
        assert_eq!(land.remembered(asked), None);
    }
}
