//! Schedule of the clipmap's tiles. Knows neither land nor GPU.
//!
//! Coarse levels come first: they cover everything with little work, and the shaders use a level
//! only when all its tiles that they show are filled. Within a level, the nearest tiles come first.

use super::window::ClipmapSize;
use crate::camera::Eye;

/// A tile of a level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tile {
    /// Level, 0 the finest.
    pub level: u32,
    /// Column and row of tiles of this level, from the origin of the world.
    pub place: (i32, i32),
}

/// Which tiles are filled.
#[derive(Clone, Debug)]
pub struct Schedule {
    size: ClipmapSize,
    /// The tile in each slot, level by level.
    filled: Vec<Option<(i32, i32)>>,
}

impl Schedule {
    /// A schedule with nothing filled.
    #[must_use]
    pub fn new(size: ClipmapSize) -> Self {
        let slots = size.levels * size.side_tiles * size.side_tiles;
        Self { size, filled: vec![None; slots as usize] }
    }

    /// The next tiles of the first `levels` levels to fill around an eye, at most `most`. They
    /// count as filled.
    pub fn next(&mut self, eye: &Eye, levels: u32, most: usize) -> Vec<Tile> {
        let mut tiles = Vec::new();
        for level in (0..levels.min(self.size.levels)).rev() {
            if tiles.len() >= most {
                break;
            }
            let mut missing: Vec<(i32, i32)> = self.missing(level, eye).collect();
            let (column, row) = self.size.window(level, eye);
            let middle = self.size.side_tiles as i32 / 2;
            missing.sort_by_key(|(x, z)| {
                let from_middle = |at: i32, low: i32| i64::from(2 * (at - low - middle) + 1).pow(2);
                (from_middle(*x, column) + from_middle(*z, row), *z, *x)
            });
            missing.truncate(most - tiles.len());
            for place in missing {
                let slot = self.slot(level, place);
                self.filled[slot] = Some(place);
                tiles.push(Tile { level, place });
            }
        }
        tiles
    }

    /// Whether all tiles of a level that are shown from an eye are filled. Those at the rim of the
    /// window follow within some frames; a level that waited for them would not be shown each time
    /// the eye passes a tile.
    #[must_use]
    pub fn is_ready(&self, level: u32, eye: &Eye) -> bool {
        !self.missing(level, eye).any(|place| self.size.is_shown(level, eye, place))
    }

    fn missing(&self, level: u32, eye: &Eye) -> impl Iterator<Item = (i32, i32)> {
        let (column, row) = self.size.window(level, eye);
        let side = self.size.side_tiles as i32;
        let places = (row..row + side).flat_map(move |z| (column..column + side).map(move |x| (x, z)));
        places.filter(move |place| self.filled[self.slot(level, *place)] != Some(*place))
    }

    fn slot(&self, level: u32, place: (i32, i32)) -> usize {
        let level_slots = self.size.side_tiles * self.size.side_tiles;
        (level * level_slots) as usize + self.size.slot(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;
    use std::collections::HashSet;

    const SIZE: ClipmapSize = ClipmapSize { side_tiles: 4, levels: 3 };

    fn eye(x_m: f64) -> Eye {
        format!("{x_m},10,0,0,0").parse::<Pose>().unwrap().eye()
    }

    #[test]
    fn all_tiles_are_filled_once_coarse_levels_first_and_then_nothing() {
        let mut schedule = Schedule::new(SIZE);
        let mut seen = Vec::new();
        loop {
            let tiles = schedule.next(&eye(0.0), 3, 5);
            assert!(tiles.len() <= 5);
            if tiles.is_empty() {
                break;
            }
            seen.extend(tiles);
        }
        assert!(seen.is_sorted_by_key(|tile| std::cmp::Reverse(tile.level)));
        assert_eq!((seen.len(), seen.iter().collect::<HashSet<_>>().len()), (48, 48));
        assert!((0..3).all(|level| schedule.is_ready(level, &eye(0.0))));
    }

    #[test]
    fn a_step_fills_one_column_of_the_finest_level_and_a_step_back_fills_it_again() {
        let mut schedule = Schedule::new(SIZE);
        assert!(!schedule.is_ready(0, &eye(0.0)));
        let _ = schedule.next(&eye(0.0), 9, usize::MAX);
        assert!(schedule.next(&eye(20.0), 9, usize::MAX).is_empty());
        // Beside the border between two tiles the new column is at the rim.
        let mut crossing = schedule.clone();
        assert!(crossing.is_ready(0, &eye(65.0)));
        assert_eq!(crossing.next(&eye(65.0), 9, usize::MAX).len(), 4);
        for x_m in [100.0, 0.0] {
            assert!(!schedule.is_ready(0, &eye(x_m)) && schedule.is_ready(1, &eye(x_m)));
            let tiles = schedule.next(&eye(x_m), 9, usize::MAX);
            assert!(tiles.len() == 4 && tiles.iter().all(|tile| tile.level == 0), "{tiles:?}");
        }
    }
}
