//! The words of this program: the scalar definition, and heights by every kernel.

use crate::digest::probes::Probe;
use shaders::layout::PROBE_WORDS;
use terrain::constants::{SPACING_BITS, WORLD_HALF};
use terrain::ring::{mod_floor, mod_trunc};
use terrain::{Grid, Kernel, Land, Octaves, Position};

/// Longest row that a probe is hidden in: the widest vector twice, and one vertex that fills no vector.
const ROW: i32 = 33;

/// Levels whose grids carry all octaves, so that their heights are those of the definition.
const FULL_LEVELS: u8 = 3;

/// The definition, point by point.
#[must_use]
pub fn scalar(land: &Land, probes: &[Probe]) -> Vec<i32> {
    let mut words = Vec::with_capacity(probes.len() * PROBE_WORDS);
    for [x, z] in probes.iter().copied() {
        let relief = land.fbm().at(x, z, Octaves::ALL);
        // No land is defined outside the world; backends that cannot refuse a position answer 0.
        let height = Position::new(x, z).map_or(0, |position| land.height_at(position));
        words.extend([mod_trunc(x, z), mod_floor(x, z), relief.hills, relief.folds, height]);
    }
    words
}

/// The definition with the heights of a kernel in place of its own. Each comes from a row of another length, with the probe
/// in another column, so that every lane and every remainder is asked.
#[must_use]
pub fn by_kernel(land: &Land, kernel: Kernel, probes: &[Probe], scalar: &[i32]) -> Vec<i32> {
    let mut words = scalar.to_vec();
    let mut row = [0; ROW as usize];
    for (index, [x, z]) in probes.iter().copied().enumerate() {
        if Position::new(x, z).is_err() {
            continue;
        }
        let level = (index % usize::from(FULL_LEVELS)) as u8;
        let spacing_bits = SPACING_BITS + u32::from(level);
        // As many vertices on either side as the world has room for.
        let before = (index as i32 % ROW).min((x.abs_diff(-WORLD_HALF) >> spacing_bits) as i32);
        let after = (ROW - 1 - before).min((x.abs_diff(WORLD_HALF) >> spacing_bits) as i32);
        let columns = (before + 1 + after) as usize;
        let grid = Grid::new(x - (before << spacing_bits), z, level, columns, 1).expect("cut to the world");
        land.heights_on(kernel, &grid, &mut row[..columns]);
        words[index * PROBE_WORDS + PROBE_WORDS - 1] = row[before as usize];
    }
    words
}
