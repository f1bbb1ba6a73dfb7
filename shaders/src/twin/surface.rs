//! Twin of `wgsl/bound/surface.wesl`: the drawn surface around the eye, at any point of it, in
//! integers.
//!
//! Places are counted from the low corner of the occlusion grid of 32 x 32 tiles of 128 m, in *fine
//! units* of 2^-12 m; so are heights, from the level of the sea. Chunks of any level and morph lie
//! under the tiles. The result is the surface that `draw_terrain` draws, to 1/2 mm: the same
//! vertices, the same diagonals, the same morphs.

use super::grid::GridVertex;
use super::morph::{Seams, morph_at, morphed, snapped};
use super::ring::mul_hi;
use crate::layout::{
    BLOCK_TEXELS, ChunkWords, GRID_NODES, GRID_TILES, NO_CHUNK, OccluderChunk, OcclusionNode,
};
use terrain::constants::{CELLS, SPACING_BITS};

/// log2 of the fine units in a unit.
pub const FINE_BITS: u32 = 4;
/// log2 of the side of a tile, fine units: 128 m.
pub const TILE_BITS: u32 = 19;
/// log2 of the side of the grid, fine units.
pub const GRID_BITS: u32 = 24;
/// log2 of the spacing of level-0 vertices, fine units: 2 m.
pub const STEP_BITS: u32 = SPACING_BITS + FINE_BITS;
/// Height of nothing, units: below everything, and its fine units fit in 32 bits.
pub const NOWHERE: i32 = -(1 << 25);

/// The source of the surface: the slots of resident chunks.
pub trait Slots {
    /// Height of vertex `index` of a slot, units.
    fn height(&self, slot: u32, index: u32) -> i32;
    /// Upper bound of a block of a slot, units; `texel` below [`BLOCK_TEXELS`].
    fn top(&self, slot: u32, texel: u32) -> i32;
    /// Lower bound of a block of a slot, units.
    fn bottom(&self, slot: u32, texel: u32) -> i32;
    /// Word `word` of a slot's density grid: four texels of a byte.
    fn density(&self, slot: u32, word: u32) -> u32;
    /// Called for every tile or node that is read, for statistics.
    fn note(&self) {}
}

/// The surface around the eye.
#[derive(Debug)]
pub struct Surface<'a, S> {
    /// Where heights and bounds are.
    pub slots: &'a S,
    /// The tiles row by row, then 16 x 16 nodes above them, and so on: [`GRID_NODES`].
    pub nodes: &'a [OcclusionNode],
    /// The chunks under them.
    pub chunks: &'a [OccluderChunk],
}

/// Bounds of the drawn surface over a square of side `2^bits`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Node {
    /// Nothing in it is higher, units; [`NOWHERE`] where nothing is drawn.
    pub top: i32,
    /// Nothing in it is lower, units; [`NOWHERE`] where anything is not drawn.
    pub bottom: i32,
    /// log2 of the side of the smallest block here that has bounds of its own; 0 above tiles.
    pub finest: u32,
}

/// A cell of a chunk and a place in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Spot {
    /// The vertex in the low corner.
    low: GridVertex,
    /// Vertices from one corner to the next: 2 in a decimated chunk.
    stride: u32,
    /// log2 of the side, fine units.
    bits: u32,
    /// From the low corner, fine units, 0 to 2^bits.
    east: i32,
    south: i32,
}

/// `a + (b - a) * part / 2^bits`, rounded down. Differences below 2^29, `part` at most 2^bits,
/// `bits` at most 29.
#[must_use]
pub fn part_of(difference: i32, part: i32, bits: u32) -> i32 {
    return mul_hi(difference << 2, part << (30 - bits));
}

/// The seams of a chunk, unpacked.
fn seams_of(words: &ChunkWords) -> Seams {
    let coarser = |side: u32| words.inside >> (8 + side) & 1 != 0;
    Seams {
        inside: words.inside as u8,
        edges: words.edges.to_le_bytes(),
        corners: words.corners.to_le_bytes(),
        is_coarser: [coarser(0), coarser(1), coarser(2), coarser(3)],
        is_decimated: words.inside & ChunkWords::DECIMATED != 0,
    }
}

/// The block of 2 x 2 cells that holds a cell.
fn block_around(cell: GridVertex) -> GridVertex {
    return GridVertex { column: cell.column & !1, row: cell.row & !1 };
}

impl<S: Slots> Surface<'_, S> {
    /// The chunk under a place of the grid.
    fn chunk_at(&self, x: i32, z: i32) -> u32 {
        return self.nodes[((z >> TILE_BITS) * GRID_TILES + (x >> TILE_BITS)) as usize].chunk;
    }

    /// Height at which a vertex is drawn, units. Twin of what `draw_terrain` does.
    fn drawn_vertex(&self, chunk: &OccluderChunk, vertex: GridVertex) -> i32 {
        // Nothing is morphed, so nothing beside it is coarser either, and no vertex is moved.
        if chunk.words.edges | chunk.words.corners | chunk.words.inside == 0 {
            return self.slots.height(chunk.words.slot, vertex.row * 65 + vertex.column);
        }
        let seams = seams_of(&chunk.words);
        let at = snapped(&seams, vertex);
        let own = self.slots.height(chunk.words.slot, at.row * 65 + at.column);
        let morph = morph_at(&seams, at);
        if morph == 0 {
            return own;
        }
        let half = CELLS as u32 / 2;
        let column = (chunk.words.place >> 8 & 1) * half + (at.column >> 1);
        let row = (chunk.words.place >> 9 & 1) * half + (at.row >> 1);
        let first = self.slots.height(chunk.words.parent_slot, row * 65 + column);
        let second =
            self.slots.height(chunk.words.parent_slot, (row + (at.row & 1)) * 65 + column + (at.column & 1));
        return morphed(own, (first + second) >> 1, morph);
    }

    /// The cell of a chunk that holds a place.
    fn spot(&self, chunk: &OccluderChunk, x: i32, z: i32) -> Spot {
        let level = chunk.words.place & 255;
        let decimated = u32::from(chunk.words.inside & ChunkWords::DECIMATED != 0);
        let last = CELLS as i32 - 1;
        let (steps_x, steps_z) = ((x >> STEP_BITS) - chunk.x, (z >> STEP_BITS) - chunk.z);
        let column = (steps_x >> level).clamp(0, last) & !(decimated as i32);
        let row = (steps_z >> level).clamp(0, last) & !(decimated as i32);
        let bits = STEP_BITS + level + decimated;
        let step = (1 << STEP_BITS) - 1;
        return Spot {
            low: GridVertex { column: column as u32, row: row as u32 },
            stride: 1 + decimated,
            bits,
            east: ((steps_x - (column << level)) << STEP_BITS) + (x & step),
            south: ((steps_z - (row << level)) << STEP_BITS) + (z & step),
        };
    }

    /// The chunk and the cell under a place. None where nothing is drawn.
    fn cell_at(&self, x: i32, z: i32) -> Option<(&OccluderChunk, Spot)> {
        let index = self.chunk_at(x, z);
        if index == NO_CHUNK {
            return None;
        }
        let chunk = &self.chunks[index as usize];
        return Some((chunk, self.spot(chunk, x, z)));
    }

    /// Whether the triangles of a block of 2 x 2 cells are not those of the grid: it lies at a
    /// border that a coarser chunk shares.
    fn is_block_rough(&self, chunk: &OccluderChunk, block: GridVertex) -> bool {
        let (coarser, last) = (chunk.words.inside >> 8, CELLS as u32 - 2);
        if chunk.words.inside & ChunkWords::DECIMATED != 0 {
            return false;
        }
        return (coarser & 1 != 0 && block.row == 0)
            || (coarser & 2 != 0 && block.column == last)
            || (coarser & 4 != 0 && block.row == last)
            || (coarser & 8 != 0 && block.column == 0);
    }

    /// Whether a place lies in a block with other triangles than the grid's, or nothing is drawn
    /// there.
    #[must_use]
    pub fn is_rough_at(&self, x: i32, z: i32) -> bool {
        return match self.cell_at(x, z) {
            None => true,
            Some((chunk, spot)) => self.is_block_rough(chunk, block_around(spot.low)),
        };
    }

    /// Whether moved vertices of a chunk with cells of 8 m and more may leave edges between the
    /// vertices of level 0: there a block's own samples are no bound.
    #[must_use]
    pub fn is_rough_near(&self, x: i32, z: i32) -> bool {
        let index = self.chunk_at(x, z);
        if index == NO_CHUNK {
            return true;
        }
        let chunk = &self.chunks[index as usize];
        return (chunk.words.place & 255) >= 2 && chunk.words.inside & 0xf00 != 0;
    }

    /// Height of a corner of a cell, 0 or 1 east and south, fine units.
    fn cell_corner(&self, chunk: &OccluderChunk, spot: &Spot, east: u32, south: u32) -> i32 {
        let column = spot.low.column + east * spot.stride;
        let row = spot.low.row + south * spot.stride;
        return self.drawn_vertex(chunk, GridVertex { column, row }) << FINE_BITS;
    }

    /// Height on the triangles of a cell of the grid, fine units, rounded down.
    fn on_cell(&self, chunk: &OccluderChunk, spot: &Spot) -> i32 {
        let corner = |east, south| self.cell_corner(chunk, spot, east, south);
        let (low, high) = (corner(0, 0), corner(1, 1));
        if spot.east >= spot.south {
            let side = corner(1, 0);
            return low
                + part_of(side - low, spot.east, spot.bits)
                + part_of(high - side, spot.south, spot.bits);
        }
        let side = corner(0, 1);
        return low + part_of(side - low, spot.south, spot.bits) + part_of(high - side, spot.east, spot.bits);
    }

    /// The drawn vertex that stands for a corner of a block of 2 x 2 cells, relative to the block:
    /// 0 to 2 each way, and its height.
    fn block_vertex(
        &self,
        chunk: &OccluderChunk,
        block: GridVertex,
        east: u32,
        south: u32,
    ) -> (i32, i32, i32) {
        let vertex = GridVertex { column: block.column + east, row: block.row + south };
        let at = snapped(&seams_of(&chunk.words), vertex);
        let height = self.drawn_vertex(chunk, vertex) << FINE_BITS;
        return (at.column as i32 - block.column as i32, at.row as i32 - block.row as i32, height);
    }

    /// Height on the triangles of a block of 2 x 2 cells beside a coarser chunk, where some
    /// vertices have been moved; fine units, rounded down.
    fn on_rough(&self, chunk: &OccluderChunk, spot: &Spot) -> i32 {
        let block = block_around(spot.low);
        let east = spot.east + (((spot.low.column & 1) as i32) << spot.bits);
        let south = spot.south + (((spot.low.row & 1) as i32) << spot.bits);
        for triangle in 0..8u32 {
            let (column, row, upper) = (triangle >> 1 & 1, triangle >> 2, triangle & 1);
            let a = self.block_vertex(chunk, block, column, row);
            let b = self.block_vertex(chunk, block, column + 1 - upper, row + upper);
            let c = self.block_vertex(chunk, block, column + 1, row + 1);
            let area = (b.0 - a.0) * (c.1 - a.1) - (c.0 - a.0) * (b.1 - a.1);
            if area == 0 {
                continue;
            }
            let sign = area.signum();
            let (from_x, from_z) = (east - (a.0 << spot.bits), south - (a.1 << spot.bits));
            // Twice the areas of the triangles that the place makes with two sides, in fine units
            // times cells.
            let of_b = sign * (from_x * (c.1 - a.1) - (c.0 - a.0) * from_z);
            let of_c = sign * ((b.0 - a.0) * from_z - from_x * (b.1 - a.1));
            let whole = area.abs() << spot.bits;
            if of_b < 0 || of_c < 0 || of_b + of_c > whole {
                continue;
            }
            // Areas are 1 or 2: a shift divides.
            let more = (area.abs() - 1) as u32;
            let bits = spot.bits + more;
            return a.2 + part_of(b.2 - a.2, of_b, bits) + part_of(c.2 - a.2, of_c, bits);
        }
        // The triangles cover the block.
        return NOWHERE << FINE_BITS;
    }

    /// Height of the drawn surface, fine units: at most 1/2 mm too low, never too high. [`NOWHERE`]
    /// in fine units where nothing is drawn.
    #[must_use]
    pub fn height_at(&self, x: i32, z: i32) -> i32 {
        let Some((chunk, spot)) = self.cell_at(x, z) else { return NOWHERE << FINE_BITS };
        if self.is_block_rough(chunk, block_around(spot.low)) {
            return self.on_rough(chunk, &spot);
        }
        return self.on_cell(chunk, &spot);
    }

    /// Height between the four corners of the cell, bilinear, fine units; the drawn surface is
    /// triangles. For a reference method.
    #[must_use]
    pub fn bilinear_at(&self, x: i32, z: i32) -> i32 {
        let Some((chunk, spot)) = self.cell_at(x, z) else { return NOWHERE << FINE_BITS };
        let corner = |east, south| self.cell_corner(chunk, &spot, east, south);
        let near = corner(0, 0) + part_of(corner(1, 0) - corner(0, 0), spot.east, spot.bits);
        let far = corner(0, 1) + part_of(corner(1, 1) - corner(0, 1), spot.east, spot.bits);
        return near + part_of(far - near, spot.south, spot.bits);
    }

    /// A lower bound of the drawn surface at a place that also holds, where vertices have been
    /// moved, for all of the block of 2 x 2 cells around it; fine units.
    #[must_use]
    pub fn lowest_at(&self, x: i32, z: i32) -> i32 {
        let Some((chunk, spot)) = self.cell_at(x, z) else { return NOWHERE << FINE_BITS };
        let block = block_around(spot.low);
        if !self.is_block_rough(chunk, block) {
            return self.on_cell(chunk, &spot);
        }
        let mut lowest = i32::MAX;
        for vertex in 0..9 {
            lowest = lowest.min(self.block_vertex(chunk, block, vertex % 3, vertex / 3).2);
        }
        return lowest;
    }

    /// log2 of the cells of the chunk under a place, fine units; the largest where nothing is
    /// drawn.
    #[must_use]
    pub fn cell_bits(&self, x: i32, z: i32) -> u32 {
        let index = self.chunk_at(x, z);
        if index == NO_CHUNK {
            return GRID_BITS;
        }
        return STEP_BITS + (self.chunks[index as usize].words.place & 255);
    }

    /// Bounds of a block of a chunk, of `2^bits` fine units around a place or of the smallest that
    /// has bounds.
    fn block(&self, chunk: &OccluderChunk, bits: u32, x: i32, z: i32) -> Node {
        let level = chunk.words.place & 255;
        let finest = STEP_BITS + level + 3;
        // Blocks a side: 8, 4, 2, 1.
        let coarser = (bits.max(finest) - finest).min(3);
        let shift = level + 3 + coarser;
        let side = 8 >> coarser;
        let last = side - 1;
        let column = (((x >> STEP_BITS) - chunk.x) >> shift).clamp(0, last);
        let row = (((z >> STEP_BITS) - chunk.z) >> shift).clamp(0, last);
        let texel = BLOCK_TEXELS as i32 - (4 * side * side - 1) / 3 + row * side + column;
        let mut top = self.slots.top(chunk.words.slot, texel as u32);
        let mut bottom = self.slots.bottom(chunk.words.slot, texel as u32);
        if chunk.words.edges | chunk.words.corners | (chunk.words.inside & 255) != 0 {
            // The block of the parent that holds this one: the same place, as large or, for the
            // smallest, twice as large.
            let above = (8 >> (coarser.max(1) - 1)).min(8);
            let half = above / 2;
            let down = if coarser == 0 { 1 } else { 0 };
            let column = (chunk.words.place >> 8 & 1) as i32 * half + (column >> down);
            let row = (chunk.words.place >> 9 & 1) as i32 * half + (row >> down);
            let texel = BLOCK_TEXELS as i32 - (4 * above * above - 1) / 3 + row * above + column;
            top = top.max(self.slots.top(chunk.words.parent_slot, texel as u32));
            bottom = bottom.min(self.slots.bottom(chunk.words.parent_slot, texel as u32));
        }
        return Node { top, bottom, finest };
    }

    /// Bounds of the drawn surface over the square of side `2^bits` in a column and row of such
    /// squares.
    #[must_use]
    pub fn node(&self, bits: u32, column: i32, row: i32) -> Node {
        let above = bits.max(TILE_BITS) - TILE_BITS;
        let down = TILE_BITS - bits.min(TILE_BITS);
        let side = GRID_TILES >> above;
        let first = GRID_NODES as i32 - (4 * side * side - 1) / 3;
        self.slots.note();
        let tile = &self.nodes[(first + (row >> down) * side + (column >> down)) as usize];
        if above > 0 {
            return Node { top: tile.top, bottom: tile.bottom, finest: 0 };
        }
        if tile.chunk == NO_CHUNK {
            return Node { top: NOWHERE, bottom: NOWHERE, finest: GRID_BITS };
        }
        return self.block(&self.chunks[tile.chunk as usize], bits, column << bits, row << bits);
    }

    /// Share of the densest field at a place, 0 to 255; 0 where nothing is drawn.
    #[must_use]
    pub fn density_at(&self, x: i32, z: i32) -> u32 {
        let index = self.chunk_at(x, z);
        if index == NO_CHUNK {
            return 0;
        }
        let chunk = &self.chunks[index as usize];
        let shift = (chunk.words.place & 255) + 2;
        let column = (((x >> STEP_BITS) - chunk.x) >> shift).clamp(0, 15) as u32;
        let row = (((z >> STEP_BITS) - chunk.z) >> shift).clamp(0, 15) as u32;
        return self.slots.density(chunk.words.slot, row * 4 + (column >> 2)) >> (8 * (column & 3)) & 255;
    }
}
