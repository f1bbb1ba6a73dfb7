//! Twin of `wgsl/shared/morph.wesl`: the height at which a vertex of a chunk is drawn.

use super::grid::GridVertex;
use crate::layout::ChunkWords;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// A morph of one: entirely the parent's surface.
pub const MORPH_ONE: u8 = 64;

const MORPH_BAND_BITS: u32 = 0;
/// Cells from the border over which a morph goes from the edge's number to the inside's.
///
/// Along a coarser neighbour the band blends into the parent's surface, whose error is only known
/// to be within the tolerance on the border itself. Eight cells drew up to 1.2 tolerances there,
/// two 1.04; one stays within it (`tombolo-lab lod`).
pub const MORPH_BAND: u32 = 1 << MORPH_BAND_BITS;

/// How a chunk joins its neighbours. Morphs are 0 (the chunk's own surface) to [`MORPH_ONE`] (the
/// parent's).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seams {
    /// Morph away from the border.
    pub inside: u8,
    /// Morphs of the edges: north, east, south, west.
    pub edges: [u8; 4],
    /// Morphs of the corners: (low, low), (high x, low z), (low x, high z), (high, high).
    pub corners: [u8; 4],
    /// Whether the neighbour across each edge is coarser: vertices there that it does not have are
    /// moved onto one that it has.
    pub is_coarser: [bool; 4],
    /// Whether only every other vertex is drawn, all the way in.
    pub is_decimated: bool,
}

impl Seams {
    /// A chunk that is drawn as its parent's triangles.
    pub const DECIMATED: Self = Self {
        inside: MORPH_ONE,
        edges: [MORPH_ONE; 4],
        corners: [MORPH_ONE; 4],
        is_coarser: [true; 4],
        is_decimated: true,
    };
}

impl ChunkWords {
    /// Seams as an instance carries them: edges, corners, inside.
    #[must_use]
    pub fn seam_words(seams: &Seams) -> [u32; 3] {
        let coarser =
            seams.is_coarser.iter().enumerate().map(|(side, is)| u32::from(*is) << (8 + side)).sum::<u32>();
        [
            u32::from_le_bytes(seams.edges),
            u32::from_le_bytes(seams.corners),
            u32::from(seams.inside) | coarser | (u32::from(seams.is_decimated) * Self::DECIMATED),
        ]
    }
}

/// The vertex that is drawn in place of another (a snapped vertex): the even one beside it on an
/// edge that a coarser chunk shares, and anywhere in a decimated chunk.
#[must_use]
pub fn snapped(seams: &Seams, vertex: GridVertex) -> GridVertex {
    let [north, east, south, west] = seams.is_coarser;
    let last = CELLS as u32;
    let along_x = seams.is_decimated || (north && vertex.row == 0) || (south && vertex.row == last);
    let along_z = seams.is_decimated || (west && vertex.column == 0) || (east && vertex.column == last);
    GridVertex {
        column: vertex.column - (vertex.column & u32::from(along_x)),
        row: vertex.row - (vertex.row & u32::from(along_z)),
    }
}

/// Morph at a vertex, 0 to [`MORPH_ONE`]: that of the corner or edge on the border, that of the
/// inside from [`MORPH_BAND`] cells on, bilinear between.
#[must_use]
pub fn morph_at(seams: &Seams, vertex: GridVertex) -> i32 {
    let last = CELLS as u32;
    let (east, south) = (vertex.column > last / 2, vertex.row > last / 2);
    let from_x = if east { last - vertex.column } else { vertex.column };
    let from_z = if south { last - vertex.row } else { vertex.row };
    let near_x = (MORPH_BAND - from_x.min(MORPH_BAND)) as i32;
    let near_z = (MORPH_BAND - from_z.min(MORPH_BAND)) as i32;
    let far_x = MORPH_BAND as i32 - near_x;
    let far_z = MORPH_BAND as i32 - near_z;
    let corner = i32::from(seams.corners[usize::from(east) + 2 * usize::from(south)]);
    let edge_x = i32::from(if east { seams.edges[1] } else { seams.edges[3] });
    let edge_z = i32::from(if south { seams.edges[2] } else { seams.edges[0] });
    let inside = i32::from(seams.inside);
    let sum = near_z * (near_x * corner + far_x * edge_z) + far_z * (near_x * edge_x + far_x * inside);
    sum >> (2 * MORPH_BAND_BITS)
}

/// Height of the parent's surface, units, at a vertex of the chunk that is the quarter
/// `(east, south)` of it: a vertex of the parent, or the middle between two, rounded down. The
/// middle of a cell lies on its diagonal from low to high.
#[must_use]
pub fn parent_height(parent: &[i32; VERTEX_COUNT], quarter: (u32, u32), vertex: GridVertex) -> i32 {
    let half = CELLS as u32 / 2;
    let column = quarter.0 * half + (vertex.column >> 1);
    let row = quarter.1 * half + (vertex.row >> 1);
    let height = |column: u32, row: u32| parent[row as usize * VERTICES + column as usize];
    let low = height(column, row);
    let high = height(column + (vertex.column & 1), row + (vertex.row & 1));
    (low + high) >> 1
}

/// Height between the chunk's own and its parent's, units. Heights are below 2^24, so nothing
/// overflows.
#[must_use]
pub fn morphed(own: i32, parent: i32, morph: i32) -> i32 {
    own + (((parent - own) * morph) >> 6)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> impl Iterator<Item = GridVertex> {
        (0..=CELLS as u32).flat_map(|row| (0..=CELLS as u32).map(move |column| GridVertex { column, row }))
    }

    const MIXED: Seams = Seams {
        inside: 20,
        edges: [64, 5, 0, 33],
        corners: [64, 64, 0, 7],
        is_coarser: [true, false, false, false],
        is_decimated: false,
    };

    #[test]
    fn border_vertices_depend_on_shared_numbers_alone() {
        let other = Seams { inside: 51, edges: [64, 64, 64, 33], corners: [64, 0, 0, 7], ..Seams::default() };
        for row in 0..=64 {
            let vertex = GridVertex { column: 0, row };
            assert_eq!(morph_at(&MIXED, vertex), morph_at(&Seams { inside: 0, ..MIXED }, vertex));
            if row > 32 {
                // The western edge and its southern corner agree in both.
                assert_eq!(morph_at(&MIXED, vertex), morph_at(&other, vertex));
            }
        }
    }

    #[test]
    fn a_morph_keeps_between_its_numbers_and_reaches_each() {
        for vertex in grid() {
            assert!((0..=64).contains(&morph_at(&MIXED, vertex)));
        }
        let at = |column, row| morph_at(&MIXED, GridVertex { column, row });
        assert_eq!([at(0, 0), at(64, 0), at(0, 64), at(64, 64)], [64, 64, 0, 7]);
        assert_eq!([at(32, 0), at(64, 32), at(32, 64), at(0, 32)], [64, 5, 0, 33]);
        let (low, high) = (MORPH_BAND, CELLS as u32 - MORPH_BAND);
        assert_eq!([at(low, low), at(32, 32), at(high, high)], [20; 3]);
        assert!(at(low - 1, 32) != 20 && at(32, high + 1) != 20);
        let all = Seams { inside: 64, edges: [64; 4], corners: [64; 4], ..Seams::default() };
        assert!(grid().all(|vertex| morph_at(&all, vertex) == 64));
    }

    #[test]
    fn only_odd_vertices_on_a_coarser_edge_are_moved() {
        for vertex in grid() {
            let moved = snapped(&MIXED, vertex);
            let expected = if vertex.row == 0 { vertex.column & !1 } else { vertex.column };
            assert_eq!(moved, GridVertex { column: expected, ..vertex });
            let decimated = GridVertex { column: vertex.column & !1, row: vertex.row & !1 };
            assert_eq!(snapped(&Seams::DECIMATED, vertex), decimated);
        }
    }

    #[test]
    fn the_parents_surface_is_the_drawn_one() {
        let heights: Vec<i32> = (0..VERTEX_COUNT as i32).map(|n| (n * 7919) % 4001 - 2000).collect();
        let parent: Box<[i32; VERTEX_COUNT]> = heights.into_boxed_slice().try_into().unwrap();
        for quarter in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            for vertex in grid() {
                let (column, row) = (64 * quarter.0 + vertex.column, 64 * quarter.1 + vertex.row);
                let twice = terrain::chunk::drawn_height_scaled(&parent, column as usize, row as usize, 1);
                assert_eq!(i64::from(parent_height(&parent, quarter, vertex)), twice >> 1);
            }
        }
    }

    #[test]
    fn the_ends_of_a_morph_are_exact_at_all_heights() {
        let limit = terrain::constants::HEIGHT_LIMIT - 1;
        for (own, parent) in [(limit, -limit), (-limit, limit), (5, -3), (0, 0)] {
            assert_eq!((morphed(own, parent, 0), morphed(own, parent, 64)), (own, parent));
            assert!((own.min(parent)..=own.max(parent)).contains(&morphed(own, parent, 31)));
        }
    }
}
