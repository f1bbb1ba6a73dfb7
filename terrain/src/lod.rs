//! Level of detail by screen error: which chunks a viewer needs.
//!
//! A chunk whose drawn surface is at most `e` away from the truth looks wrong by at most `e * K / D` pixels from
//! distance `D`, with `K = height / (2 tan(fov / 2))` pixels (Ulrich, "Rendering Massive Terrains using Chunked
//! Level of Detail Control", SIGGRAPH 2002). A chunk is refined while that exceeds the tolerance.

use crate::constants::{TOP_LEVEL, UNITS_PER_METRE};
use crate::key::{ChunkKey, ROOT};
use crate::land::Land;

/// Upper bound of the land's height, units; lets a high eye count its height as distance.
pub const SUMMIT: i32 = 600 * UNITS_PER_METRE;

/// Largest view distance that a selection serves, metres.
pub const MAX_VIEW_DISTANCE_M: u32 = 65_536;

/// Empirical bound of the vertical error of a level against level 0 in units: a search with a margin, not a proof.
///
/// Levels 1 to 6: the worst value that `cargo run --release -p terrain --example level_error` finds by brute force
/// (2.5, 5.5, 10.1, 18.5, 31.3, 44.3 m), plus a quarter, and a little more at levels 4 to 6, where a longer search of summits found 19.4, 35.0
/// and 57.1 m. A test repeats part of that search. From level 7 on a cell is wider than the hills, and the bound is the whole relief.
const LEVEL_ERROR: [u32; TOP_LEVEL as usize + 1] = {
    let mut bounds = [SUMMIT as u32 + 64 * 256; TOP_LEVEL as usize + 1];
    let measured = [0, 815, 1_775, 3_222, 6_199, 11_198, 18_275];
    let mut level = 0;
    while level < measured.len() {
        bounds[level] = measured[level];
        level += 1;
    }
    bounds
};

/// Empirical bound of the vertical error of a level against level 0, units; `level` up to 16.
#[must_use]
pub const fn level_error(level: u8) -> u32 {
    LEVEL_ERROR[level as usize]
}

/// What a selection needs to know of a viewer. Integers, so that two machines choose alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Viewer {
    /// Eye, units: east, up, south.
    pub eye: (i32, i32, i32),
    /// Chunks farther than this (metres, horizontal) are not needed. At most [`MAX_VIEW_DISTANCE_M`].
    pub distance_m: u32,
    /// `K` in pixels: viewport height / (2 tan(vertical field of view / 2)).
    pub pixels_per_radian: u32,
    /// Tolerated screen error in 1/16 pixel; 0 is treated as 1.
    pub tolerance_q4: u32,
}

/// One needed chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needed {
    /// The chunk.
    pub key: ChunkKey,
    /// Distance from the eye, units.
    pub distance: u64,
    /// Screen error in 1/16 pixel while this chunk's *parent* is drawn instead of it, saturating: how much
    /// better the picture becomes when it arrives.
    pub gain_q4: u32,
}

/// The chunks a viewer needs, parents before children.
///
/// Contains every ancestor of a needed chunk up to the level whose side first reaches the view distance, so that
/// something coarse can be drawn while the fine chunks are under way. Stops at `limit` chunks (coarse ones are found
/// first).
#[must_use]
pub fn select(land: &Land, viewer: &Viewer, limit: usize) -> Vec<Needed> {
    let mut needed = Vec::new();
    let mut level = vec![ROOT];
    while !level.is_empty() && needed.len() < limit {
        let mut below = Vec::new();
        for key in level {
            let distance = viewer.distance_to(key);
            if distance > u64::from(viewer.distance_m) * UNITS_PER_METRE as u64 {
                continue;
            }
            if !viewer.is_larger_than_the_view(key) {
                let gain_q4 = viewer.screen_error_q4(level_error((key.level() + 1).min(TOP_LEVEL)), distance);
                needed.push(Needed { key, distance, gain_q4 });
                if viewer.screen_error_q4(error_bound(land, key), distance) <= viewer.tolerance_q4.max(1) {
                    continue;
                }
            }
            below.extend(key.children().into_iter().flatten());
        }
        level = below;
    }
    needed.truncate(limit);
    needed
}

/// Bound of the error of a chunk before it is generated: zero over open sea, else the level's.
#[must_use]
pub fn error_bound(land: &Land, key: ChunkKey) -> u32 {
    let (x, z) = key.origin();
    if key.level() == 0 || land.archipelago().is_open_sea(x, z, key.side()) {
        0
    } else {
        level_error(key.level())
    }
}

impl Viewer {
    /// Distance from the eye to the box of a chunk: the square of the chunk, from below the sea up to [`SUMMIT`]. Units.
    #[must_use]
    pub fn distance_to(&self, key: ChunkKey) -> u64 {
        let (x, z) = key.origin();
        let gap = |eye: i32, low: i32| {
            let (eye, low) = (i64::from(eye), i64::from(low));
            (low - eye).max(eye - low - i64::from(key.side())).max(0).unsigned_abs()
        };
        let above = (i64::from(self.eye.1) - i64::from(SUMMIT)).max(0).unsigned_abs();
        let (dx, dz) = (gap(self.eye.0, x), gap(self.eye.2, z));
        (dx * dx + dz * dz + above * above).isqrt()
    }

    /// Screen error of a vertical error at a distance (both units), 1/16 pixel, saturating.
    #[must_use]
    pub fn screen_error_q4(&self, error: u32, distance: u64) -> u32 {
        let scaled = u64::from(error) * u64::from(self.pixels_per_radian) * 16;
        u32::try_from(scaled / distance.max(1)).unwrap_or(u32::MAX)
    }

    fn is_larger_than_the_view(&self, key: ChunkKey) -> bool {
        key.level() > 0 && u64::from(key.side()) > u64::from(self.distance_m) * UNITS_PER_METRE as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::WORLD_HALF;
    use std::collections::HashSet;

    fn viewer() -> Viewer {
        Viewer { eye: (0, 100 * 256, 0), distance_m: 8000, pixels_per_radian: 312, tolerance_q4: 24 }
    }

    #[test]
    fn a_selection_is_closed_under_parents_and_covers_the_view() {
        let land = Land::new(1);
        let selected = select(&land, &viewer(), usize::MAX);
        let keys: HashSet<_> = selected.iter().map(|needed| needed.key).collect();
        assert_eq!(keys.len(), selected.len(), "no chunk twice");
        let top = selected[0].key.level();
        for key in &keys {
            assert!(key.level() == top || keys.contains(&key.parent().unwrap()), "{key} without its parent");
        }
        for (x, z) in [(0, 0), (7_900, 0), (-5_000, 5_000), (3, -7_990)] {
            let covers = |level| keys.contains(&ChunkKey::containing(level, x * 256, z * 256));
            assert!(covers(top), "({x}, {z}) is not covered");
        }
        assert!(keys.contains(&ChunkKey::new(0, 0, 0).unwrap()), "full detail under the eye");
        assert!((60..2000).contains(&keys.len()), "{} chunks", keys.len());
    }

    #[test]
    fn every_chunk_that_stays_a_leaf_is_within_the_tolerance() {
        let land = Land::new(1);
        let selected = select(&land, &viewer(), usize::MAX);
        let keys: HashSet<_> = selected.iter().map(|needed| needed.key).collect();
        for needed in &selected {
            let refined =
                needed.key.children().is_some_and(|children| children.iter().any(|c| keys.contains(c)));
            let error = viewer().screen_error_q4(error_bound(&land, needed.key), needed.distance);
            assert!(refined || error <= 24 || needed.key.level() == 0, "{} at {error}/16 px", needed.key);
        }
    }

    #[test]
    fn a_tighter_tolerance_needs_more_and_the_limit_is_kept() {
        let land = Land::new(1);
        let count = |tolerance_q4| select(&land, &Viewer { tolerance_q4, ..viewer() }, usize::MAX).len();
        assert!(count(16) > count(32) && count(32) > count(160));
        assert_eq!(select(&land, &viewer(), 10).len(), 10);
        assert!(select(&land, &viewer(), 0).is_empty());
    }

    #[test]
    fn corners_of_the_world_and_absurd_viewers_are_served() {
        let land = Land::new(1);
        for eye in [
            (WORLD_HALF, 0, WORLD_HALF),
            (-WORLD_HALF, i32::MAX, -WORLD_HALF),
            (i32::MIN, i32::MIN, i32::MAX),
        ] {
            for distance_m in [0, 1, MAX_VIEW_DISTANCE_M] {
                let viewer = Viewer { eye, distance_m, pixels_per_radian: u32::MAX, tolerance_q4: 0 };
                assert!(select(&land, &viewer, 500).len() <= 500);
            }
        }
    }

    #[test]
    fn sampled_chunks_stay_below_the_level_error() {
        for seed in 0..3 {
            let land = Land::new(seed);
            for level in 1..=4 {
                for (x, z) in [(500, 700), (-3000, 2000), (2500, -1500), (-900, -2800)] {
                    let chunk = land.chunk(ChunkKey::containing(level, x * 256, z * 256));
                    // Above level 2 an error is a bound itself, with that of the grid that it was measured on.
                    let allowed = level_error(level) + if level > 2 { level_error(level - 2) } else { 0 };
                    assert!(chunk.error <= allowed, "{}: {}", chunk.key, chunk.error);
                }
            }
        }
    }
}
