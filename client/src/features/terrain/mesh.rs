//! The index buffer that all instances share: 32 x 32 cells, a quarter of a chunk. Quarters are
//! culled one by one: near the eye a whole chunk is much wider than the image.
//!
//! Cells are cut from their low corner to their high corner, the rule that the land is defined by
//! (`terrain::chunk::drawn_height_scaled`). Seen from above, triangles run counter-clockwise.

use shaders::twin::grid::grid_index;
use terrain::constants::CELLS;

/// Cells along a side.
const SIDE: usize = CELLS / 2;

/// Indices of one instance.
pub const INDEX_COUNT: u32 = (6 * SIDE * SIDE) as u32;

/// The indices.
#[must_use]
pub fn indices() -> Vec<u16> {
    let last = SIDE as u16;
    let mut indices = Vec::with_capacity(INDEX_COUNT as usize);
    for row in 0..last {
        for column in 0..last {
            let corner = |dx: u16, dz: u16| grid_index(column + dx, row + dz);
            indices.extend([corner(0, 0), corner(1, 1), corner(1, 0)]);
            indices.extend([corner(0, 0), corner(0, 1), corner(1, 1)]);
        }
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use shaders::twin::grid::grid_vertex;

    fn corners(triangle: &[u16]) -> [Vec3; 3] {
        [0, 1, 2].map(|i| {
            let vertex = grid_vertex(u32::from(triangle[i]));
            Vec3::new(vertex.column as f32, 0.0, vertex.row as f32)
        })
    }

    #[test]
    fn the_ground_faces_up() {
        let indices = indices();
        assert_eq!(indices.len(), INDEX_COUNT as usize);
        for triangle in indices.chunks_exact(3) {
            let [a, b, c] = corners(triangle);
            assert!((b - a).cross(c - a).y > 0.0, "{a} {b} {c}");
        }
    }

    #[test]
    fn every_cell_is_cut_from_its_low_to_its_high_corner() {
        for (cell, pair) in indices().chunks_exact(6).enumerate() {
            let (x, z) = ((cell % SIDE) as f32, (cell / SIDE) as f32);
            for triangle in pair.chunks_exact(3) {
                let corners = corners(triangle);
                assert!(corners.contains(&Vec3::new(x, 0.0, z)));
                assert!(corners.contains(&Vec3::new(x + 1.0, 0.0, z + 1.0)));
            }
        }
    }
}
