//! Tiles: squares of 16 x 16 chunks of one level. Objects are named by tile and chunk.

use crate::chunk_id::ChunkId;
use object_store::path::Path;
use terrain::{ChunkKey, WorldDigest};

/// Chunks per side of a tile.
pub const SIDE: i32 = 16;

/// Chunks of a tile.
pub const CHUNKS: usize = (SIDE * SIDE) as usize;

/// A tile. Its chunks may lie beyond the border of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PackTile {
    /// Level of its chunks.
    pub level: u8,
    /// Chunk coordinate divided by [`SIDE`], rounded down.
    pub x: i32,
    /// Likewise.
    pub z: i32,
}

impl PackTile {
    /// The tile of a chunk, and the chunk's index in it.
    #[must_use]
    pub const fn of(key: ChunkKey) -> (Self, usize) {
        let tile = Self { level: key.level(), x: key.x().div_euclid(SIDE), z: key.z().div_euclid(SIDE) };
        let index = key.z().rem_euclid(SIDE) * SIDE + key.x().rem_euclid(SIDE);
        (tile, index as usize)
    }

    /// The chunk of an index; none beyond the border of the world.
    #[must_use]
    pub fn chunk(self, index: usize) -> Option<ChunkKey> {
        let index = i32::try_from(index).ok()?;
        ChunkKey::new(self.level, self.x * SIDE + index % SIDE, self.z * SIDE + index / SIDE).ok()
    }
}

/// Names of the objects of one world.
///
/// | object | path under the URL of the store |
/// | --- | --- |
/// | a chunk | `{world}/{level}/{tile x}_{tile z}/{x}_{z}/{edition}` |
/// | the chunks of a baked tile | `{world}/{level}/{tile x}_{tile z}/pack` |
/// | a baked region | `{world}/regions/{name}` |
///
/// The edition `base` is the land that the seed makes; packs have no other.
#[derive(Clone, Debug)]
pub struct ObjectNames {
    world: Path,
}

impl ObjectNames {
    /// The names under a root.
    #[must_use]
    pub fn new(root: &Path, world: &WorldDigest) -> Self {
        Self { world: root.clone().join(world.to_string()) }
    }

    /// A chunk.
    #[must_use]
    pub fn chunk(&self, id: ChunkId) -> Path {
        let ChunkId { key, edition } = id;
        self.tile(PackTile::of(key).0).join(format!("{}_{}", key.x(), key.z())).join(edition.to_string())
    }

    /// The pack of a tile.
    #[must_use]
    pub fn pack(&self, tile: PackTile) -> Path {
        self.tile(tile).join("pack")
    }

    /// The folder of the regions.
    #[must_use]
    pub fn regions(&self) -> Path {
        self.world.clone().join("regions")
    }

    fn tile(&self, tile: PackTile) -> Path {
        self.world.clone().join(tile.level.to_string()).join(format!("{}_{}", tile.x, tile.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk_id::Edition;

    #[test]
    fn a_chunk_has_one_place_in_one_tile_also_west_of_the_origin() {
        for (x, z) in [(0, 0), (-1, 15), (16, -17), (-16, -16)] {
            let key = ChunkKey::new(2, x, z).unwrap();
            let (tile, index) = PackTile::of(key);
            assert_eq!(tile.chunk(index), Some(key));
            assert_eq!((tile.x, tile.z), (x.div_euclid(SIDE), z.div_euclid(SIDE)));
        }
        assert_eq!(PackTile { level: 16, x: 0, z: 0 }.chunk(1), None, "there is one chunk");
    }

    #[test]
    fn names_have_the_world_and_the_tile() {
        let names = ObjectNames::new(&Path::from("some/prefix"), &WorldDigest([0xab; 32]));
        let world = "ab".repeat(32);
        let key = ChunkKey::new(3, -1, 17).unwrap();
        let chunk = format!("some/prefix/{world}/3/-1_1/-1_17");
        assert_eq!(names.chunk(ChunkId::base(key)).as_ref(), format!("{chunk}/base"));
        let changed = ChunkId { key, edition: Edition::changed([0xcd; 16]) };
        assert_eq!(names.chunk(changed).as_ref(), format!("{chunk}/{}", "cd".repeat(16)));
        assert_eq!(names.pack(PackTile::of(key).0).as_ref(), format!("some/prefix/{world}/3/-1_1/pack"));
        assert_eq!(names.regions().as_ref(), format!("some/prefix/{world}/regions"));
    }
}
