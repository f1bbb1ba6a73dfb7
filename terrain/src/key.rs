//! Chunk keys: a quadtree over the world.
//!
//! Level 0 chunks are 128 m wide; level `k` doubles the side `k` times; level 16 is one chunk over
//! the whole world. Coordinates count chunks from the origin (signed): `(0, 0, 0)` has its low
//! corner at the origin for every level up to
//! 15. The single chunk of level 16 is `(16, 0, 0)` with its low corner at the world's.

use crate::constants::{CELLS, CHUNK_BITS, SPACING_BITS, TOP_LEVEL, WORLD_HALF};
use std::fmt;

/// One chunk of the quadtree. Always inside the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ChunkKey {
    level: u8,
    x: i32,
    z: i32,
}

/// The root: the level-16 chunk that covers the world.
pub const ROOT: ChunkKey = ChunkKey { level: TOP_LEVEL, x: 0, z: 0 };

impl ChunkKey {
    /// A key from its numbers; refused if no such chunk exists.
    pub fn new(level: u8, x: i32, z: i32) -> Result<Self, InvalidKey> {
        let exists = level <= TOP_LEVEL && {
            let range = axis_range(level);
            range.contains(&x) && range.contains(&z)
        };
        if exists { Ok(Self { level, x, z }) } else { Err(InvalidKey { level, x, z }) }
    }

    /// The key of the chunk of `level` that holds a coordinate pair (units, inside the world).
    /// Points on the world's far border belong to the last chunk.
    #[must_use]
    pub fn containing(level: u8, x: i32, z: i32) -> Self {
        let level = level.min(TOP_LEVEL);
        let axis = |v: i32| {
            let index = (i64::from(v) + i64::from(WORLD_HALF)) >> (CHUNK_BITS + u32::from(level));
            let range = axis_range(level);
            (index as i32 + range.start).clamp(range.start, range.end - 1)
        };
        Self { level, x: axis(x), z: axis(z) }
    }

    /// Level of detail, 0 (finest) to 16.
    #[must_use]
    pub const fn level(self) -> u8 {
        self.level
    }

    /// Chunk coordinate east.
    #[must_use]
    pub const fn x(self) -> i32 {
        self.x
    }

    /// Chunk coordinate south.
    #[must_use]
    pub const fn z(self) -> i32 {
        self.z
    }

    /// Low corner of the chunk, units.
    #[must_use]
    pub fn origin(self) -> (i32, i32) {
        let start = axis_range(self.level).start;
        let axis = |v: i32| {
            let from_border = i64::from(v - start) << (CHUNK_BITS + u32::from(self.level));
            (from_border - i64::from(WORLD_HALF)) as i32
        };
        (axis(self.x), axis(self.z))
    }

    /// Distance between neighbouring vertices, units.
    #[must_use]
    pub const fn spacing(self) -> i32 {
        1 << (SPACING_BITS + self.level as u32)
    }

    /// Side of the chunk, units (2^31 at the root, hence unsigned).
    #[must_use]
    pub const fn side(self) -> u32 {
        (self.spacing() as u32) * CELLS as u32
    }

    /// The chunk one level up that covers this one; none above the root.
    #[must_use]
    pub fn parent(self) -> Option<Self> {
        if self.level >= TOP_LEVEL {
            return None;
        }
        let (own, above) = (axis_range(self.level), axis_range(self.level + 1));
        let axis = |v: i32| ((v - own.start) >> 1) + above.start;
        Some(Self { level: self.level + 1, x: axis(self.x), z: axis(self.z) })
    }

    /// The chunk of the same level this many chunks east and south; none beyond the world's border.
    #[must_use]
    pub fn neighbour(self, east: i32, south: i32) -> Option<Self> {
        let (x, z) = (self.x.checked_add(east)?, self.z.checked_add(south)?);
        Self::new(self.level, x, z).ok()
    }

    /// Which quarter of its parent a chunk is: 0 or 1 east, 0 or 1 south. (0, 0) for the root.
    #[must_use]
    pub fn quarter(self) -> (i32, i32) {
        let start = axis_range(self.level).start;
        ((self.x - start) & 1, (self.z - start) & 1)
    }

    /// The four chunks one level down, in the order (low, low), (high x, low z), (low x, high z),
    /// (high, high); none at level 0.
    #[must_use]
    pub fn children(self) -> Option<[Self; 4]> {
        let level = self.level.checked_sub(1)?;
        let (own, below) = (axis_range(self.level), axis_range(level));
        let axis = |v: i32| 2 * (v - own.start) + below.start;
        let (x, z) = (axis(self.x), axis(self.z));
        Some([(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dz)| Self { level, x: x + dx, z: z + dz }))
    }
}

/// The chunk coordinates that exist along one axis at a level.
fn axis_range(level: u8) -> std::ops::Range<i32> {
    let n = 1i32 << (TOP_LEVEL - level);
    -(n >> 1)..n - (n >> 1)
}

impl fmt::Display for ChunkKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.level, self.x, self.z)
    }
}

/// Numbers that name no chunk of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidKey {
    /// The refused level.
    pub level: u8,
    /// The refused chunk coordinate east.
    pub x: i32,
    /// The refused chunk coordinate south.
    pub z: i32,
}

impl fmt::Display for InvalidKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { level, x, z } = *self;
        if level > TOP_LEVEL {
            return write!(f, "chunk {level}/{x}/{z} does not exist: levels are 0 to {TOP_LEVEL}");
        }
        let range = axis_range(level);
        let (low, high) = (range.start, range.end - 1);
        write!(
            f,
            "chunk {level}/{x}/{z} is outside the world: level {level} has x and z from {low} to {high}"
        )
    }
}

impl std::error::Error for InvalidKey {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_key() -> impl Strategy<Value = ChunkKey> {
        (0..=TOP_LEVEL, -WORLD_HALF..=WORLD_HALF, -WORLD_HALF..=WORLD_HALF)
            .prop_map(|(level, x, z)| ChunkKey::containing(level, x, z))
    }

    #[test]
    fn the_root_covers_exactly_the_world() {
        assert_eq!(ROOT.origin(), (-WORLD_HALF, -WORLD_HALF));
        assert_eq!(ROOT.side(), 1 << 31);
        assert_eq!(ROOT.parent(), None);
        assert_eq!(ROOT.children().unwrap().map(|key| (key.x, key.z)), [(-1, -1), (0, -1), (-1, 0), (0, 0)]);
    }

    #[test]
    fn the_chunk_zero_of_every_level_but_the_root_starts_at_the_origin() {
        for level in 0..TOP_LEVEL {
            assert_eq!(ChunkKey::new(level, 0, 0).unwrap().origin(), (0, 0));
            assert_eq!(
                ChunkKey::new(level, -1, 0).unwrap().origin().0,
                -(1 << (CHUNK_BITS + u32::from(level)))
            );
        }
    }

    #[test]
    fn keys_outside_the_world_are_refused_with_the_allowed_range() {
        for (level, x, z) in [
            (17, 0, 0),
            (255, 0, 0),
            (16, 1, 0),
            (16, -1, 0),
            (0, 32_768, 0),
            (0, 0, -32_769),
            (3, i32::MIN, i32::MAX),
        ] {
            assert_eq!(ChunkKey::new(level, x, z), Err(InvalidKey { level, x, z }));
        }
        let ranges = [(0, 32_768, "from -32768 to 32767"), (16, 1, "from 0 to 0"), (17, 0, "0 to 16")];
        for (level, x, range) in ranges {
            let message = ChunkKey::new(level, x, 0).unwrap_err().to_string();
            assert!(message.contains(&format!("{level}/{x}/0")) && message.ends_with(range), "{message}");
        }
    }

    #[test]
    fn a_key_is_shown_as_level_x_and_z() {
        assert_eq!(ChunkKey::new(3, -1, 2).unwrap().to_string(), "3/-1/2");
    }

    proptest! {
        #[test]
        fn children_tile_their_parent(key in any_key()) {
            let Some(children) = key.children() else { return Ok(()) };
            let (x, z) = key.origin();
            for (child, (dx, dz)) in children.into_iter().zip([(0, 0), (1, 0), (0, 1), (1, 1)]) {
                prop_assert_eq!(child.parent(), Some(key));
                prop_assert_eq!(child.side() * 2, key.side());
                let step = i64::from(child.side());
                let at = |low: i32, quarter: i64| (i64::from(low) + quarter * step) as i32;
                prop_assert_eq!(child.origin(), (at(x, dx), at(z, dz)));
                prop_assert_eq!(ChunkKey::new(child.level, child.x, child.z), Ok(child));
            }
        }

        #[test]
        fn neighbours_touch_and_quarters_name_the_side_of_the_parent(
            key in any_key(), east in -1i32..=1, south in -1i32..=1,
        ) {
            let (x, z) = key.origin();
            let step = i64::from(key.side());
            if let Some(next) = key.neighbour(east, south) {
                let (nx, nz) = next.origin();
                let offset = (i64::from(nx) - i64::from(x), i64::from(nz) - i64::from(z));
                prop_assert_eq!(offset, (i64::from(east) * step, i64::from(south) * step));
                prop_assert_eq!(next.neighbour(-east, -south), Some(key));
            }
            if let Some(parent) = key.parent() {
                let (qx, qz) = key.quarter();
                let (px, pz) = parent.origin();
                let offset = (i64::from(x) - i64::from(px), i64::from(z) - i64::from(pz));
                prop_assert_eq!(offset, (i64::from(qx) * step, i64::from(qz) * step));
            }
        }

        #[test]
        fn a_point_is_inside_its_chunk(
            level in 0..=TOP_LEVEL, x in -WORLD_HALF..=WORLD_HALF, z in -WORLD_HALF..=WORLD_HALF,
        ) {
            let key = ChunkKey::containing(level, x, z);
            let (x0, z0) = key.origin();
            let side = i64::from(key.side());
            let inside = |v: i32, low: i32| (0..=side).contains(&(i64::from(v) - i64::from(low)));
            prop_assert!(inside(x, x0) && inside(z, z0));
        }
    }
}
