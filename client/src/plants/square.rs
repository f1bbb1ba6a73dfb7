//! The drawn land within 2 km of the eye: 32 x 32 tiles of 128 m, each with the chunk that is drawn
//! there, and bounds over them.
//!
//! Made anew for every frame from what the frame draws, so that what hides a thing is what is drawn
//! before it.

use crate::camera::Eye;
use crate::world::{Drawn, Resident, World};
use shaders::layout::{Leaf, MAX_LEAVES, NO_LEAF, SQUARE_NODES, SQUARE_TILES, TerrainInstance, Tile};
use shaders::twin::surface::{FINE_BITS, NOWHERE, TILE_BITS};
use terrain::ChunkKey;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE};

/// log2 of the side of a tile, units: that of a chunk of level 0.
const TILE_UNIT_BITS: u32 = TILE_BITS - FINE_BITS;

/// Plants stand and sight is tested up to so far from the eye, metres: the square without the tile
/// that the eye stands in.
pub const REACH_M: f64 = 1900.0;

/// The square.
#[derive(Clone, Debug, PartialEq)]
pub struct Square {
    /// Low corner, units. Beyond the world where the eye is near its border.
    pub corner: [i32; 2],
    /// The tiles row by row, then 16 x 16 nodes over them, and so on to one.
    pub tiles: Vec<Tile>,
    /// The drawn chunks under them.
    pub leaves: Vec<Leaf>,
    /// Their keys, in the same order.
    pub keys: Vec<ChunkKey>,
}

const EMPTY: Tile = Tile { top: NOWHERE, bottom: NOWHERE, leaf: NO_LEAF, reserved: 0 };

impl Square {
    /// The square around an eye over what is drawn.
    #[must_use]
    pub fn around(eye: &Eye, world: &World, drawn: &[Drawn]) -> Self {
        let low = |at: i32| ((at >> TILE_UNIT_BITS) - SQUARE_TILES / 2) << TILE_UNIT_BITS;
        // An eye is held within 2^30 units, the square is 2^20 wide.
        let corner = [low(eye.units[0]), low(eye.units[2])];
        let mut square =
            Self { corner, tiles: vec![EMPTY; SQUARE_NODES], leaves: Vec::new(), keys: Vec::new() };
        for chunk in drawn {
            square.put(world, chunk);
        }
        square.reduce();
        square
    }

    /// The eye in the square: east, up, south in fine units, rounded.
    #[must_use]
    pub fn eye(&self, eye: &Eye) -> [i32; 3] {
        let fine = f64::from(UNITS_PER_METRE << FINE_BITS);
        let fraction = eye.fraction_m.as_dvec3() * fine;
        let axis = |units: i32, low: i32, fraction: f64| {
            // Heights stay within 20 km and places within the square: 2^27 fine units.
            ((units - low) << FINE_BITS) + fraction.round() as i32
        };
        [
            axis(eye.units[0], self.corner[0], fraction.x),
            axis(eye.units[1], 0, fraction.y),
            axis(eye.units[2], self.corner[1], fraction.z),
        ]
    }

    /// Puts a drawn chunk under the tiles that it covers.
    fn put(&mut self, world: &World, drawn: &Drawn) {
        let key = drawn.key;
        let Some(chunk) = world.get(key) else { return };
        let parent = key.parent().and_then(|parent| world.get(parent)).unwrap_or(chunk);
        let (x, z) = key.origin();
        let tiles = 1i64 << key.level();
        let first = |low: i32, corner: i32| (i64::from(low) - i64::from(corner)) >> TILE_UNIT_BITS;
        let span = |first: i64| {
            let side = i64::from(SQUARE_TILES);
            first.clamp(0, side)..(first + tiles).clamp(0, side)
        };
        let (columns, rows) = (span(first(x, self.corner[0])), span(first(z, self.corner[1])));
        if columns.is_empty() || rows.is_empty() || self.leaves.len() >= MAX_LEAVES {
            return;
        }
        let index = self.leaves.len() as u32;
        let (top, bottom) = bounds_of(drawn, chunk, parent);
        for row in rows {
            for column in columns.clone() {
                // Of a large chunk it would be enough to take the blocks under the tile; the walk
                // takes those anyway.
                self.tiles[(row * i64::from(SQUARE_TILES) + column) as usize] =
                    Tile { top, bottom, leaf: index, reserved: 0 };
            }
        }
        let (east, south) = key.quarter();
        let [edges, corners, inside] = TerrainInstance::seam_words(&drawn.seams);
        let steps = |low: i32, corner: i32| ((i64::from(low) - i64::from(corner)) >> SPACING_BITS) as i32;
        self.leaves.push(Leaf {
            slot: chunk.slot,
            parent_slot: parent.slot,
            edges,
            corners,
            inside,
            place: u32::from(key.level())
                | ((east as u32) << 8)
                | ((south as u32) << 9)
                | (u32::from(chunk.grass.palette) << 16),
            x: steps(x, self.corner[0]),
            z: steps(z, self.corner[1]),
        });
        self.keys.push(key);
    }

    /// Fills the nodes over the tiles.
    fn reduce(&mut self) {
        let first = |side: usize| SQUARE_NODES - (4 * side * side - 1) / 3;
        let mut side = SQUARE_TILES as usize / 2;
        while side > 0 {
            for index in 0..side * side {
                let (column, row) = (index % side, index / side);
                let below = first(2 * side) + 2 * row * 2 * side + 2 * column;
                let four =
                    [below, below + 1, below + 2 * side, below + 2 * side + 1].map(|at| self.tiles[at]);
                self.tiles[first(side) + index] = Tile {
                    top: four.iter().map(|tile| tile.top).max().unwrap_or(NOWHERE),
                    bottom: four.iter().map(|tile| tile.bottom).min().unwrap_or(NOWHERE),
                    ..EMPTY
                };
            }
            side /= 2;
        }
    }
}

/// Whether any vertex of a drawn chunk is moved towards its parent's surface.
fn is_morphed(drawn: &Drawn) -> bool {
    let seams = &drawn.seams;
    seams.inside != 0 || seams.edges.iter().chain(&seams.corners).any(|morph| *morph != 0)
}

/// Highest and lowest drawn point, units.
fn bounds_of(drawn: &Drawn, chunk: &Resident, parent: &Resident) -> (i32, i32) {
    if is_morphed(drawn) {
        (chunk.max.max(parent.max), chunk.min.min(parent.min))
    } else {
        (chunk.max, chunk.min)
    }
}
