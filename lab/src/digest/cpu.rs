//! The words of this program: the scalar definition and every kernel.

use crate::digest::probes::Probe;
use rayon::prelude::*;
use shaders::layout::{PROBE_COARSE_OCTAVES, PROBE_WORDS};
use terrain::constants::{SPACING_BITS, WORLD_HALF};
use terrain::hash::mix;
use terrain::ring::{mod_floor, mod_trunc};
use terrain::{Grid, Kernel, Land, Octaves, Position};

/// Longest row that a probe is hidden in: the widest vector twice, and one vertex that fills no
/// vector.
const MOST_COLUMNS: usize = 33;

/// Rows of the grids that probes are hidden in: a first, one that follows it, and one that follows
/// a follower.
const MOST_ROWS: usize = 3;

/// Levels whose grids carry all octaves, so that their heights are those of the definition.
const FULL_LEVELS: usize = 3;

/// The definition, point by point.
pub fn scalar(land: &Land, probes: &[Probe]) -> Vec<i32> {
    let mut words = Vec::with_capacity(probes.len() * PROBE_WORDS);
    for [x, z] in probes.iter().copied() {
        let fine = land.fbm().at(x, z, Octaves::ALL);
        // No land is defined outside the world; backends that cannot reject a position return 0.
        let [height, coarse] = [Octaves::ALL, coarse_octaves()]
            .map(|octaves| Position::new(x, z).map_or(0, |position| land.height_keeping(position, octaves)));
        words.extend([mod_trunc(x, z), mod_floor(x, z), fine, height, coarse]);
    }
    words
}

/// Octaves of the coarse height.
pub(super) fn coarse_octaves() -> Octaves {
    Octaves::new(PROBE_COARSE_OCTAVES).expect("fewer than the land has")
}

/// The definition's words with a kernel's fine sums and heights in place of its own, where the
/// probe lies in the world: grids lie nowhere else. Each comes from a grid of another size, with
/// the probe in another column and row, so that every lane, every remainder, and what a row takes
/// over from the one before are asked.
pub fn by_kernel(land: &Land, kernel: Kernel, probes: &[Probe], scalar: &[i32]) -> Vec<i32> {
    let mut words = scalar.to_vec();
    let of_probe = words.par_chunks_exact_mut(PROBE_WORDS).zip(probes).enumerate();
    of_probe.filter(|(_, (_, [x, z]))| Position::new(*x, *z).is_ok()).for_each(|(index, (words, [x, z]))| {
        let (grid, vertex) = grid_around(index as u32, *x, *z);
        let mut values = [[0; MOST_COLUMNS * MOST_ROWS]; 3];
        let [fine, heights, coarse] = values.each_mut().map(|values| &mut values[..grid.vertex_count()]);
        land.fbm().grid_on(kernel, &grid, fine);
        land.heights_on(kernel, &grid, heights);
        land.heights_on(kernel, &grid.keeping(coarse_octaves()), coarse);
        words[PROBE_WORDS - 3..].copy_from_slice(&[fine[vertex], heights[vertex], coarse[vertex]]);
    });
    words
}

/// A grid with the probe in it, cut to the world, and the probe's place in it. The index draws its
/// size.
fn grid_around(index: u32, x: i32, z: i32) -> (Grid, usize) {
    let draw = |purpose: u32, count: usize| mix(4 * index + purpose) as usize % count;
    let level = draw(0, FULL_LEVELS) as u8;
    let spacing_bits = SPACING_BITS + u32::from(level);
    // As many vertices before and after as the world has room for.
    let span = |at: i32, drawn: usize, most: usize| {
        let count = 1 + drawn % most;
        let before = (drawn / most % count).min((at.abs_diff(-WORLD_HALF) >> spacing_bits) as usize);
        let after = (count - 1 - before).min((at.abs_diff(WORLD_HALF) >> spacing_bits) as usize);
        (at - ((before as i32) << spacing_bits), before, before + 1 + after)
    };
    let (low_x, column, columns) = span(x, draw(1, usize::MAX), MOST_COLUMNS);
    let (low_z, row, rows) = span(z, draw(2, usize::MAX), MOST_ROWS);
    let grid = Grid::new(low_x, low_z, level, columns, rows).expect("cut to the world");
    (grid, row * columns + column)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn grids_hold_their_probe_and_take_every_size_and_place() {
        let (mut sizes, mut places) = (BTreeSet::new(), BTreeSet::new());
        for index in 0..200_000 {
            let (grid, vertex) = grid_around(index, 5, -7);
            assert!(vertex < grid.vertex_count());
            sizes.insert((grid.columns(), grid.rows()));
            places.insert((vertex % grid.columns(), vertex / grid.columns()));
        }
        assert_eq!((sizes.len(), places.len()), (MOST_COLUMNS * MOST_ROWS, MOST_COLUMNS * MOST_ROWS));
        for corner in [-WORLD_HALF, WORLD_HALF] {
            (0..200).for_each(|index| {
                grid_around(index, corner, corner);
            });
        }
    }
}
