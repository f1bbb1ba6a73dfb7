//! Baked regions: rectangles of tiles whose packs exist. The manifest of a region is written after
//! all its packs, so a server that finds it finds all of them.

use super::tile::{PackTile, SIDE};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use terrain::ChunkKey;
use terrain::constants::{TOP_LEVEL, UNITS_PER_METRE, WORLD_HALF};

/// Tiles of some levels over a rectangle of the map.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BakedRegion {
    /// Finest level.
    pub finest: u8,
    /// Coarsest level.
    pub coarsest: u8,
    /// West, north, east and south border, metres from the origin.
    pub area_m: [i32; 4],
}

impl BakedRegion {
    /// A region, if its borders are in order and in the world.
    ///
    /// # Errors
    /// The invalid value and the allowed range.
    pub fn new(levels: &RangeInclusive<u8>, area_m: [i32; 4]) -> Result<Self, String> {
        let (finest, coarsest) = (*levels.start(), *levels.end());
        if finest > coarsest || coarsest > TOP_LEVEL {
            return Err(format!("levels {finest}-{coarsest}: give 0 to {TOP_LEVEL}, the finer first"));
        }
        let [west, north, east, south] = area_m;
        let half = WORLD_HALF / UNITS_PER_METRE;
        let is_inside = area_m.iter().all(|border| (-half..=half).contains(border));
        if west >= east || north >= south || !is_inside {
            return Err(format!(
                "area {west},{north},{east},{south}: give west,north,east,south in metres, within {half} of \
                 the origin"
            ));
        }
        Ok(Self { finest, coarsest, area_m })
    }

    /// Name of its object.
    #[must_use]
    pub fn name(&self) -> String {
        let [west, north, east, south] = self.area_m;
        format!("{}-{}_{west}_{north}_{east}_{south}.json", self.finest, self.coarsest)
    }

    /// Whether the region contains the tile.
    #[must_use]
    pub fn contains(&self, tile: PackTile) -> bool {
        (self.finest..=self.coarsest).contains(&tile.level) && {
            let [x, z] = self.tiles_of(tile.level);
            x.contains(&tile.x) && z.contains(&tile.z)
        }
    }

    /// Number of its tiles.
    #[must_use]
    pub fn tile_count(&self) -> u64 {
        let count = |range: RangeInclusive<i32>| u64::from(range.end().abs_diff(*range.start())) + 1;
        (self.finest..=self.coarsest)
            .map(|level| self.tiles_of(level).map(count).iter().product::<u64>())
            .sum()
    }

    /// Its tiles, coarse levels first, row by row.
    pub fn tiles(&self) -> impl Iterator<Item = PackTile> + use<> {
        let region = self.clone();
        (self.finest..=self.coarsest).rev().flat_map(move |level| {
            let [x, z] = region.tiles_of(level);
            z.flat_map(move |z| x.clone().map(move |x| PackTile { level, x, z }))
        })
    }

    /// PackTile coordinates of a level east and south.
    fn tiles_of(&self, level: u8) -> [RangeInclusive<i32>; 2] {
        let [west, north, east, south] = self.area_m.map(|border| border.saturating_mul(UNITS_PER_METRE));
        let [low, high] = [(west, north), (east - 1, south - 1)].map(|(x, z)| {
            let key = ChunkKey::containing(level, x, z);
            (key.x().div_euclid(SIDE), key.z().div_euclid(SIDE))
        });
        [low.0..=high.0, low.1..=high.1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tiles_of_a_region_are_those_that_it_contains() {
        let region = BakedRegion::new(&(0..=4), [-3000, -100, 2100, 4100]).unwrap();
        let tiles: Vec<_> = region.tiles().collect();
        assert_eq!(tiles.len() as u64, region.tile_count());
        assert!(tiles.iter().all(|tile| region.contains(*tile)));
        // 16 chunks of 128 m: x from -3000 to 2100 m lies in tiles -2 to 1, z in tiles -1 to 2.
        let finest = tiles.iter().filter(|tile| tile.level == 0);
        assert_eq!(finest.clone().count(), 16);
        assert_eq!(finest.clone().map(|tile| tile.x).min(), Some(-2));
        assert!(!region.contains(PackTile { level: 0, x: 2, z: 0 }));
        assert!(!region.contains(PackTile { level: 5, x: 0, z: 0 }));
    }

    #[test]
    fn borders_out_of_order_or_out_of_the_world_are_errors() {
        for area in [[0, 0, 0, 10], [5, 0, 1, 10], [0, 0, i32::MAX, 10], [i32::MIN, 0, 1, 1]] {
            assert!(BakedRegion::new(&(0..=1), area).is_err(), "{area:?}");
        }
        assert!(BakedRegion::new(&RangeInclusive::new(3, 2), [0, 0, 1, 1]).is_err());
        assert!(BakedRegion::new(&(0..=17), [0, 0, 1, 1]).is_err());
        let all = WORLD_HALF / UNITS_PER_METRE;
        assert!(BakedRegion::new(&(0..=16), [-all, -all, all, all]).is_ok());
    }
}
