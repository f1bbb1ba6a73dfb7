//! The drawn surface without a GPU: the triangles that `draw_terrain` draws of a chunk, by the twin
//! of its arithmetic.

use client::cache::ChunkCache;
use client::lod::Drawn;
use shaders::twin::grid::GridVertex;
use shaders::twin::morph::{Seams, morph_at, morphed, parent_height, snapped};
use terrain::ChunkKey;
use terrain::chunk::drawn_height_scaled;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// The drawn triangles of a chunk.
#[derive(Clone, Debug)]
pub struct DrawnChunk {
    key: ChunkKey,
    seams: Seams,
    /// Drawn heights, units, of the vertices that stand in place of those of the grid.
    heights: Box<[i32; VERTEX_COUNT]>,
}

/// A corner of a triangle: column and row in cells of the chunk, height in units.
type Corner = (i64, i64, i64);

impl DrawnChunk {
    /// The surface of a chunk that a selection draws; none if the chunk, or a parent that it is
    /// morphed into, is not here.
    pub fn new(world: &ChunkCache, drawn: &Drawn) -> Option<Self> {
        let chunk = world.get(drawn.key)?;
        let parent = drawn.key.parent().and_then(|parent| world.get(parent));
        let (east, south) = drawn.key.quarter();
        let mut heights = Box::new([0; VERTEX_COUNT]);
        for (index, height) in heights.iter_mut().enumerate() {
            let grid = GridVertex { column: (index % VERTICES) as u32, row: (index / VERTICES) as u32 };
            let vertex = snapped(&drawn.seams, grid);
            let own = chunk.heights[vertex.row as usize * VERTICES + vertex.column as usize];
            let morph = morph_at(&drawn.seams, vertex);
            *height = if morph == 0 {
                own
            } else {
                let above = parent_height(&parent?.heights, (east as u32, south as u32), vertex);
                morphed(own, above, morph)
            };
        }
        Some(Self { key: drawn.key, seams: drawn.seams, heights })
    }

    /// Which chunk.
    pub fn key(&self) -> ChunkKey {
        self.key
    }

    /// Whether every vertex is drawn at one height, units.
    pub fn is_flat_at(&self, height: i32) -> bool {
        self.heights.iter().all(|drawn| *drawn == height)
    }

    /// Drawn height, units times `2^level`, at a vertex of level 0, counted from the low corner (0
    /// to `64 * 2^level`).
    ///
    /// # Panics
    /// If no triangle covers the vertex: the mesh would have a hole.
    pub fn height_scaled(&self, column: usize, row: usize) -> f64 {
        let level = self.key.level();
        let cell = |vertex: usize| (vertex >> level).min(CELLS - 1);
        let (x, z) = (cell(column), cell(row));
        if self.seams.is_decimated {
            // With every other vertex moved onto the one before it, these cells have the whole
            // triangles and the others none.
            return self.height_within([(x | 1, z | 1)], column, row);
        }
        let [north, east, south, west] = self.seams.is_coarser;
        let last = CELLS - 1;
        if (north && z == 0) || (south && z == last) || (west && x == 0) || (east && x == last) {
            return self.height_among_moved(column, row, (x, z));
        }
        drawn_height_scaled(&self.heights, column, row, level) as f64
    }

    /// The same where vertices of the border were moved: the triangle over a point may be that of a
    /// cell beside it.
    fn height_among_moved(&self, column: usize, row: usize, (x, z): (usize, usize)) -> f64 {
        let around = |cell: usize| cell.saturating_sub(1)..=(cell + 1).min(CELLS - 1);
        let cells = around(z).flat_map(|z| around(x).map(move |x| (x, z)));
        self.height_within(cells, column, row)
    }

    /// The height of whichever triangle of some cells covers a point.
    fn height_within(
        &self,
        cells: impl IntoIterator<Item = (usize, usize)>,
        column: usize,
        row: usize,
    ) -> f64 {
        let level = self.key.level();
        let point = (column as i64, row as i64);
        let height = cells.into_iter().flat_map(|cell| self.triangles(cell)).find_map(|triangle| {
            let scaled = triangle.map(|(x, z, height)| (x << level, z << level, height));
            height_over(scaled, point)
        });
        height.expect("the moved triangles cover the chunk, tested below") * f64::from(1 << level)
    }

    /// The triangles of a cell of the grid and, where vertices were moved, of those around it: all
    /// that may lie over it. Corners are column and row in cells, and height in units.
    pub fn triangles_over(&self, (x, z): (usize, usize)) -> impl Iterator<Item = [(i64, i64, i64); 3]> + '_ {
        let [north, east, south, west] = self.seams.is_coarser;
        let last = CELLS - 1;
        let is_moved =
            (north && z <= 1) || (south && z + 1 >= last) || (west && x <= 1) || (east && x + 1 >= last);
        let reach = usize::from(is_moved || self.seams.is_decimated);
        let around = move |cell: usize| cell.saturating_sub(reach)..=(cell + reach).min(last);
        around(z).flat_map(move |z| around(x).map(move |x| (x, z))).flat_map(|cell| self.triangles(cell))
    }

    /// Both triangles of a cell, low-to-high, as they are drawn.
    fn triangles(&self, (x, z): (usize, usize)) -> [[Corner; 3]; 2] {
        let corner = |dx: usize, dz: usize| {
            let vertex = GridVertex { column: (x + dx) as u32, row: (z + dz) as u32 };
            let moved = snapped(&self.seams, vertex);
            let height = self.heights[(z + dz) * VERTICES + x + dx];
            (i64::from(moved.column), i64::from(moved.row), i64::from(height))
        };
        [[corner(0, 0), corner(1, 1), corner(1, 0)], [corner(0, 0), corner(0, 1), corner(1, 1)]]
    }
}

/// Height of a triangle over a point, if it covers it. Corners are (x, z, height), in any turn.
fn height_over([a, b, c]: [Corner; 3], (x, z): (i64, i64)) -> Option<f64> {
    let twice_area =
        |p: (i64, i64), q: (i64, i64), r: (i64, i64)| (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
    let flat = |corner: Corner| (corner.0, corner.1);
    let whole = twice_area(flat(a), flat(b), flat(c));
    if whole == 0 {
        return None;
    }
    let parts = [
        twice_area((x, z), flat(b), flat(c)),
        twice_area(flat(a), (x, z), flat(c)),
        twice_area(flat(a), flat(b), (x, z)),
    ]
    .map(|part| part * whole.signum());
    if parts.iter().any(|part| *part < 0) {
        return None;
    }
    let weighted: i64 = parts.iter().zip([a, b, c]).map(|(part, corner)| part * corner.2).sum();
    Some(weighted as f64 / whole.abs() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::Land;

    fn world_of(key: ChunkKey) -> ChunkCache {
        let land = Land::new(1);
        let mut world = ChunkCache::new(8);
        world.insert(land.chunk(key));
        world.insert(land.chunk(key.parent().unwrap()));
        world
    }

    fn key(level: u8) -> ChunkKey {
        ChunkKey::containing(level, 300 * 256, 900 * 256)
    }

    #[test]
    fn without_morph_it_is_the_chunk_and_with_full_morph_the_parent() {
        for level in [0, 1, 3] {
            let (key, world) = (key(level), world_of(key(level)));
            let all = Seams { inside: 64, edges: [64; 4], corners: [64; 4], ..Seams::default() };
            let own = DrawnChunk::new(&world, &Drawn { key, seams: Seams::default() }).unwrap();
            let full = DrawnChunk::new(&world, &Drawn { key, seams: all }).unwrap();
            let decimated = DrawnChunk::new(&world, &Drawn { key, seams: Seams::DECIMATED }).unwrap();
            let (chunk, parent) = (world.get(key).unwrap(), world.get(key.parent().unwrap()).unwrap());
            let (east, south) = key.quarter();
            let side = CELLS << level;
            let mut apart = 0;
            for (column, row) in (0..=side).flat_map(|row| (0..=side).map(move |column| (column, row))) {
                let expected = drawn_height_scaled(&chunk.heights, column, row, level);
                assert_eq!(own.height_scaled(column, row), expected as f64);
                // The same point of the parent; its middles are rounded down to whole units.
                let (over_x, over_z) = (side * east as usize + column, side * south as usize + row);
                let above = drawn_height_scaled(&parent.heights, over_x, over_z, level + 1) as f64 / 2.0;
                let drawn = full.height_scaled(column, row);
                assert!((drawn - above).abs() <= f64::from(1 << level), "{drawn} {above}");
                assert_eq!(
                    decimated.height_scaled(column, row),
                    above,
                    "its parent's triangles, not rounded"
                );
                apart += usize::from(drawn != expected as f64);
            }
            assert!(apart > 100, "own and parent must differ for this to say anything");
        }
    }

    #[test]
    fn moved_vertices_leave_no_hole_and_borders_are_straight() {
        let (key, world) = (key(2), world_of(key(2)));
        let side = CELLS << 2;
        for mask in 1..16 {
            let is_coarser = [1, 2, 4, 8].map(|bit| mask & bit != 0);
            let edges = is_coarser.map(|is| if is { 64 } else { 0 });
            let seams = Seams { inside: 20, edges, corners: [64; 4], is_coarser, is_decimated: false };
            let drawn = DrawnChunk::new(&world, &Drawn { key, seams }).unwrap();
            for (column, row) in (0..=side).flat_map(|row| (0..=side).map(move |column| (column, row))) {
                assert!(drawn.height_scaled(column, row).is_finite());
            }
            if is_coarser[0] {
                for even in (0..side).step_by(8) {
                    let [low, high] = [even, even + 8].map(|column| drawn.height_scaled(column, 0));
                    for step in 1..8 {
                        let line = low + (high - low) * step as f64 / 8.0;
                        assert!((drawn.height_scaled(even + step, 0) - line).abs() < 1e-6);
                    }
                }
            }
        }
    }

    #[test]
    fn away_from_the_border_both_ways_of_looking_up_a_height_agree() {
        let (key, world) = (key(3), world_of(key(3)));
        let seams = Seams { inside: 31, edges: [64, 3, 0, 64], corners: [64; 4], ..Seams::default() };
        let drawn = DrawnChunk::new(&world, &Drawn { key, seams }).unwrap();
        for (column, row) in (0..200).map(|n| (n * 37 % 513, n * 101 % 513)) {
            let cell = |vertex: usize| (vertex >> 3).min(CELLS - 1);
            let slowly = drawn.height_among_moved(column, row, (cell(column), cell(row)));
            assert!((drawn.height_scaled(column, row) - slowly).abs() < 1e-6);
        }
    }
}
