//! The index buffer that all chunks share: 64 x 64 cells and four skirts.
//!
//! Cells are cut from their low corner to their high corner, the rule that the land is defined by
//! (`terrain::chunk::drawn_height_scaled`). Seen from above, and skirts from outside, triangles run counter-clockwise.

use shaders::twin::grid::grid_index;
use terrain::constants::CELLS;

/// Indices of one chunk.
pub const INDEX_COUNT: u32 = (6 * CELLS * CELLS + 4 * 6 * CELLS) as u32;

/// The indices.
#[must_use]
pub fn indices() -> Vec<u16> {
    let last = CELLS as u16;
    let mut indices = Vec::with_capacity(INDEX_COUNT as usize);
    for row in 0..last {
        for column in 0..last {
            let corner = |dx: u16, dz: u16| grid_index(column + dx, row + dz, false);
            indices.extend([corner(0, 0), corner(1, 1), corner(1, 0)]);
            indices.extend([corner(0, 0), corner(0, 1), corner(1, 1)]);
        }
    }
    // Once around, the chunk on the right hand seen from above, so that one winding serves all four sides.
    let north = (0..last).map(|i| ((i, 0), (i + 1, 0)));
    let east = (0..last).map(|i| ((last, i), (last, i + 1)));
    let south = (0..last).map(|i| ((last - i, last), (last - i - 1, last)));
    let west = (0..last).map(|i| ((0, last - i), (0, last - i - 1)));
    for ((x0, z0), (x1, z1)) in north.chain(east).chain(south).chain(west) {
        let edge = |x, z| grid_index(x, z, false);
        let hem = |x, z| grid_index(x, z, true);
        indices.extend([edge(x0, z0), edge(x1, z1), hem(x0, z0)]);
        indices.extend([edge(x1, z1), hem(x1, z1), hem(x0, z0)]);
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
            Vec3::new(vertex.column as f32, -(vertex.skirt as f32), vertex.row as f32)
        })
    }

    #[test]
    fn the_ground_faces_up_and_each_skirt_faces_outward() {
        let indices = indices();
        assert_eq!(indices.len(), INDEX_COUNT as usize);
        for triangle in indices.chunks_exact(3) {
            let [a, b, c] = corners(triangle);
            let normal = (b - a).cross(c - a);
            if a.y == b.y && b.y == c.y {
                assert!(normal.y > 0.0, "{a} {b} {c}");
            } else {
                let middle = (a + b + c) / 3.0 - Vec3::new(32.0, 0.0, 32.0);
                assert!(normal.dot(middle.with_y(0.0)) > 0.0, "{a} {b} {c}");
            }
        }
    }

    #[test]
    fn every_cell_is_cut_from_its_low_to_its_high_corner() {
        for (cell, pair) in indices().chunks_exact(6).take(CELLS * CELLS).enumerate() {
            let (x, z) = ((cell % CELLS) as f32, (cell / CELLS) as f32);
            for triangle in pair.chunks_exact(3) {
                let corners = corners(triangle);
                assert!(corners.contains(&Vec3::new(x, 0.0, z)));
                assert!(corners.contains(&Vec3::new(x + 1.0, 0.0, z + 1.0)));
            }
        }
    }
}
