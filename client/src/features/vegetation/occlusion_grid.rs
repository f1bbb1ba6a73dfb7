//! The drawn land within 2 km of the eye: 32 x 32 tiles of 128 m with their drawn chunks, and a
//! min-max quadtree over them.
//!
//! Rebuilt for every frame from the drawn chunks, so that occluders are what is drawn.

use crate::cache::{ChunkCache, Resident};
use crate::camera::Eye;
use crate::features::terrain::instance::chunk_words;
use crate::lod::Drawn;
use shaders::layout::{
    ChunkWords, GRID_NODES, GRID_TILES, MAX_OCCLUDER_CHUNKS, NO_CHUNK, OccluderChunk, OcclusionNode,
};
use shaders::twin::surface::{FINE_BITS, NOWHERE, TILE_BITS};
use terrain::ChunkKey;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE};

/// log2 of the side of a tile, units: that of a chunk of level 0.
const TILE_UNIT_BITS: u32 = TILE_BITS - FINE_BITS;

/// Farthest clumps that are culled one by one, and farthest occlusion tests, metres: less than the
/// 1,920 m that the grid covers in every direction.
pub const REACH_M: f64 = 1900.0;

/// The occlusion grid.
#[derive(Clone, Debug, PartialEq)]
pub struct OcclusionGrid {
    /// Low corner, units. Beyond the world where the eye is near its border.
    pub corner: [i32; 2],
    /// The tiles row by row, then the 16 x 16 nodes above them, and so on to one.
    pub nodes: Vec<OcclusionNode>,
    /// The drawn chunks of the tiles.
    pub chunks: Vec<OccluderChunk>,
    /// Their keys, in the same order.
    pub keys: Vec<ChunkKey>,
}

const EMPTY: OcclusionNode = OcclusionNode { top: NOWHERE, bottom: NOWHERE, chunk: NO_CHUNK, reserved: 0 };

impl OcclusionGrid {
    /// The grid around an eye over the drawn chunks.
    #[must_use]
    pub fn around(eye: &Eye, cache: &ChunkCache, drawn: &[Drawn]) -> Self {
        let low = |at: i32| ((at >> TILE_UNIT_BITS) - GRID_TILES / 2) << TILE_UNIT_BITS;
        // Cannot overflow: an eye is clamped to 2^30 units, the grid is 2^20 wide.
        let corner = [low(eye.units[0]), low(eye.units[2])];
        let mut grid = Self { corner, nodes: vec![EMPTY; GRID_NODES], chunks: Vec::new(), keys: Vec::new() };
        for chunk in drawn {
            grid.put(cache, chunk);
        }
        grid.reduce();
        grid
    }

    /// The eye in the grid: east, up, south in fine units, rounded.
    #[must_use]
    pub fn eye(&self, eye: &Eye) -> [i32; 3] {
        let fine = f64::from(UNITS_PER_METRE << FINE_BITS);
        let fraction = eye.fraction_m.as_dvec3() * fine;
        let axis = |units: i32, low: i32, fraction: f64| {
            // Cannot overflow: heights are within 20 km and positions within the grid, 2^27 fine
            // units.
            ((units - low) << FINE_BITS) + fraction.round() as i32
        };
        [
            axis(eye.units[0], self.corner[0], fraction.x),
            axis(eye.units[1], 0, fraction.y),
            axis(eye.units[2], self.corner[1], fraction.z),
        ]
    }

    /// Enters a drawn chunk into the tiles that it covers. A chunk that is not cached, or beyond
    /// [`MAX_OCCLUDER_CHUNKS`], hides nothing, which is conservative.
    fn put(&mut self, cache: &ChunkCache, drawn: &Drawn) {
        let key = drawn.key;
        let Some(chunk) = cache.get(key) else { return };
        let parent = key.parent().and_then(|parent| cache.get(parent)).unwrap_or(chunk);
        let (x, z) = key.origin();
        let tiles = 1i64 << key.level();
        let first = |low: i32, corner: i32| (i64::from(low) - i64::from(corner)) >> TILE_UNIT_BITS;
        let span = |first: i64| {
            let side = i64::from(GRID_TILES);
            first.clamp(0, side)..(first + tiles).clamp(0, side)
        };
        let (columns, rows) = (span(first(x, self.corner[0])), span(first(z, self.corner[1])));
        if columns.is_empty() || rows.is_empty() || self.chunks.len() >= MAX_OCCLUDER_CHUNKS {
            return;
        }
        let index = self.chunks.len() as u32;
        let (top, bottom) = bounds_of(drawn, chunk, parent);
        for row in rows {
            for column in columns.clone() {
                // Bounds of the whole chunk: the traversal refines them by blocks.
                self.nodes[(row * i64::from(GRID_TILES) + column) as usize] =
                    OcclusionNode { top, bottom, chunk: index, reserved: 0 };
            }
        }
        let words = chunk_words(drawn, chunk, parent);
        let steps = |low: i32, corner: i32| ((i64::from(low) - i64::from(corner)) >> SPACING_BITS) as i32;
        self.chunks.push(OccluderChunk {
            words: ChunkWords { place: words.place | (u32::from(chunk.grass.palette) << 16), ..words },
            x: steps(x, self.corner[0]),
            z: steps(z, self.corner[1]),
        });
        self.keys.push(key);
    }

    /// Computes the nodes above the tiles.
    fn reduce(&mut self) {
        let first = |side: usize| GRID_NODES - (4 * side * side - 1) / 3;
        let mut side = GRID_TILES as usize / 2;
        while side > 0 {
            for index in 0..side * side {
                let (column, row) = (index % side, index / side);
                let below = first(2 * side) + 2 * row * 2 * side + 2 * column;
                let four =
                    [below, below + 1, below + 2 * side, below + 2 * side + 1].map(|at| self.nodes[at]);
                self.nodes[first(side) + index] = OcclusionNode {
                    top: four.iter().map(|tile| tile.top).max().unwrap_or(NOWHERE),
                    bottom: four.iter().map(|tile| tile.bottom).min().unwrap_or(NOWHERE),
                    ..EMPTY
                };
            }
            side /= 2;
        }
    }
}

/// Whether any vertex of a drawn chunk is morphed.
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
