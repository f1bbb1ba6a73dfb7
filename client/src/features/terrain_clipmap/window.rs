//! The window of tiles that each level of the clipmap holds around the eye.

use crate::camera::Eye;
use shaders::layout::CLIPMAP_LEVELS;
use terrain::ChunkKey;
use terrain::constants::{CELLS, UNITS_PER_METRE};

/// Texels along a side of a tile: the cells of a chunk, which a tile covers.
pub const TILE_TEXELS: u32 = CELLS as u32;

/// Texel spacing of the finest level, metres: the spacing of the land's vertices.
pub const FINEST_SPACING_M: f64 = 2.0;

/// Texels along a side of each level, unless a user sets another number.
pub const STANDARD_TEXELS: u32 = 512;

/// Texels at the rim of a window that a filter may read but that are not shown.
const RIM_TEXELS: f64 = 2.0;

/// Size of a clipmap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClipmapSize {
    /// Tiles along a side of each level, even.
    pub side_tiles: u32,
    /// Levels, at most [`CLIPMAP_LEVELS`].
    pub levels: u32,
}

impl ClipmapSize {
    /// The levels of `texels` texels a side that reach `view_distance_m`; `texels` is rounded down
    /// to an even number of tiles, at least 4.
    #[must_use]
    pub fn new(texels: u32, view_distance_m: u32) -> Self {
        let side_tiles = (texels / TILE_TEXELS / 2 * 2).max(4);
        let most = Self { side_tiles, levels: CLIPMAP_LEVELS as u32 };
        Self { side_tiles, levels: most.levels_for(view_distance_m) }
    }

    /// Levels that reach `view_distance_m`, as far as there are any.
    #[must_use]
    pub fn levels_for(self, view_distance_m: u32) -> u32 {
        let finest = f64::from(view_distance_m) / self.reach_m(0);
        (finest.max(1.0).log2().ceil() as u32 + 1).min(self.levels)
    }

    /// Texels along a side of each level.
    #[must_use]
    pub fn texels(self) -> u32 {
        self.side_tiles * TILE_TEXELS
    }

    /// Spacing of a level's texels, metres.
    #[must_use]
    pub fn spacing_m(self, level: u32) -> f64 {
        FINEST_SPACING_M * f64::from(1 << level)
    }

    /// Distance from the eye, along either axis, up to which a level is filled, metres. The eye is
    /// at most half a tile from the middle of the window.
    #[must_use]
    pub fn reach_m(self, level: u32) -> f64 {
        let texels = (f64::from(self.side_tiles) - 1.0) / 2.0 * f64::from(TILE_TEXELS) - RIM_TEXELS;
        texels * self.spacing_m(level)
    }

    /// The low tile, column and row, of a level's window around an eye.
    #[must_use]
    pub fn window(self, level: u32, eye: &Eye) -> (i32, i32) {
        let side = f64::from(TILE_TEXELS) * self.spacing_m(level) * f64::from(UNITS_PER_METRE);
        let half = self.side_tiles as i32 / 2;
        let low = |units: i32| (f64::from(units) / side).round() as i32 - half;
        (low(eye.units[0]), low(eye.units[2]))
    }

    /// Whether a tile holds a place that is shown from an eye: one within the reach, and a texel
    /// more for the filter.
    #[must_use]
    pub fn is_shown(self, level: u32, eye: &Eye, (column, row): (i32, i32)) -> bool {
        let tile_m = f64::from(TILE_TEXELS) * self.spacing_m(level);
        let most_m = tile_m / 2.0 + self.reach_m(level) + self.spacing_m(level);
        let is_near = |place: i32, units: i32| {
            let middle_m = (f64::from(place) + 0.5) * tile_m;
            (middle_m - f64::from(units) / f64::from(UNITS_PER_METRE)).abs() < most_m
        };
        is_near(column, eye.units[0]) && is_near(row, eye.units[2])
    }

    /// The slot, row by row, of a tile in its level: the same for all tiles a whole side apart.
    #[must_use]
    pub fn slot(self, (column, row): (i32, i32)) -> usize {
        let side = self.side_tiles as i32;
        (row.rem_euclid(side) * side + column.rem_euclid(side)) as usize
    }
}

/// The chunk that a tile covers; none outside the world.
#[must_use]
pub fn chunk_of(level: u32, (column, row): (i32, i32)) -> Option<ChunkKey> {
    ChunkKey::new(level as u8, column, row).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;

    fn eye(camera: &str) -> Eye {
        camera.parse::<Pose>().unwrap().eye()
    }

    #[test]
    fn a_window_reaches_as_far_as_stated_from_every_eye_and_no_farther() {
        let size = ClipmapSize::new(512, 20_000);
        assert_eq!((size.side_tiles, size.texels()), (8, 512));
        assert!(size.reach_m(size.levels - 1) >= 20_000.0 && size.reach_m(size.levels - 2) < 20_000.0);
        let mut nearest = f64::MAX;
        for step in -70..70 {
            let at = f64::from(step) * 3.7;
            let eye = eye(&format!("{at},10,{at},0,0"));
            for level in 0..size.levels {
                let tile_m = f64::from(TILE_TEXELS) * size.spacing_m(level);
                let (column, _) = size.window(level, &eye);
                let (low, high) =
                    (f64::from(column) * tile_m, f64::from(column + size.side_tiles as i32) * tile_m);
                let rim_m = (at - low).min(high - at);
                assert!(rim_m >= size.reach_m(level), "{at} m, level {level}: {rim_m} m");
                nearest = nearest.min(rim_m / size.reach_m(level));
            }
        }
        assert!(nearest < 1.05, "the stated reach is tight: {nearest}");
    }

    #[test]
    fn tiles_of_one_window_have_slots_of_their_own_and_those_a_side_apart_share_one() {
        let size = ClipmapSize::new(256, 1_000);
        let tiles = (-3..1).flat_map(|row| (5..9).map(move |column| (column, row)));
        let slots: std::collections::BTreeSet<usize> = tiles.map(|tile| size.slot(tile)).collect();
        assert_eq!(slots.len(), 16);
        assert_eq!(size.slot((-3, 2)), size.slot((1, -2)));
        assert_ne!(size.slot((-3, 2)), size.slot((0, -2)));
    }

    #[test]
    fn sizes_outside_the_range_are_brought_into_it() {
        assert_eq!(ClipmapSize::new(0, 100), ClipmapSize { side_tiles: 4, levels: 1 });
        assert_eq!(ClipmapSize::new(4, u32::MAX).levels, CLIPMAP_LEVELS as u32);
        assert_eq!(chunk_of(0, (i32::MAX, 0)), None);
    }
}
