//! Errors of chunks by the integers of `docs/heightfield.md`, section 9: each node by itself,
//! without parts, open sea and vectors.

use terrain::constants::{BASE_OCTAVES, CELLS, VERTEX_COUNT, VERTICES, WORLD_HALF};
use terrain::triangles::drawn_height_scaled;
use terrain::{ChunkKey, Land};

/// Units between nodes.
const NODE_SPACING: i32 = 8192;

/// A node beside the triangles of one vertex cell.
struct Node {
    /// Height above the triangles, units times `2 n`: `A` and `C` of the page.
    apart: i32,
    raised: i32,
    /// Units.
    height: i32,
    /// Q15.
    roughness: i32,
}

/// The error of a chunk of level 4.
fn composed(land: &Land, key: ChunkKey) -> u32 {
    let heights = land.chunk_heights(key);
    let of_child = |(index, child): (usize, ChunkKey)| {
        let vertices = land.chunk_heights(child);
        let (column, row) = (index % 2 * CELLS, index / 2 * CELLS);
        let distance = |n: usize| {
            let drawn = drawn_height_scaled(&heights, column + n % VERTICES, row + n / VERTICES, 1);
            drawn.abs_diff(2 * i64::from(vertices[n]))
        };
        let farthest = (0..VERTEX_COUNT).map(distance).max().unwrap();
        farthest.div_ceil(2) as u32 + land.error_of(child)
    };
    key.children().unwrap().into_iter().enumerate().map(of_child).max().unwrap()
}

/// The error of a chunk of levels 5 to 7.
fn sampled(land: &Land, key: ChunkKey) -> u32 {
    let heights = land.chunk_heights(key);
    let n = key.spacing() / NODE_SPACING;
    let (x0, z0) = key.origin();
    let side = key.side() + 2 * NODE_SPACING.unsigned_abs();
    let lobes = land.archipelago().lobes_near(x0 - NODE_SPACING, z0 - NODE_SPACING, side);
    let last = CELLS as i32 - 1;
    let at = |x: i32, z: i32| heights[z as usize * VERTICES + x as usize];
    let corners = |x: i32, z: i32| [at(x, z), at(x + 1, z), at(x, z + 1), at(x + 1, z + 1)];
    let nodes_along = |cell: i32| -i32::from(cell == 0)..n + i32::from(cell == last);
    let nodes_of = |x: i32, z: i32| -> Vec<Node> {
        let [a, e, o, b] = corners(x, z);
        let all = nodes_along(z).flat_map(|j| nodes_along(x).map(move |i| (i, j)));
        let node = |(i, j): (i32, i32)| {
            let place = |origin: i32, cell: i32, node: i32| {
                origin + cell * key.spacing() + node * NODE_SPACING + NODE_SPACING / 2
            };
            let field = land.base().at(&lobes, (place(x0, x, i), place(z0, z, j)), BASE_OCTAVES);
            let (u, v) = (2 * i + 1, 2 * j + 1);
            let rise = if u >= v { (e - a) * u + (b - e) * v } else { (o - a) * v + (b - o) * u };
            let height = field.height >> 8;
            let apart = 2 * n * height - 2 * n * a - rise;
            let raised = apart + 2 * n * ((34 * field.exposure) >> 7);
            Node { apart, raised, height, roughness: field.roughness }
        };
        all.map(node).collect()
    };
    let cells: Vec<Vec<Node>> =
        (0..=last).flat_map(|z| (0..=last).map(move |x| (x, z))).map(|(x, z)| nodes_of(x, z)).collect();
    let is_sea = |node: &Node| (node.apart, node.raised, node.height, node.roughness) == (0, 0, -16_384, 0);
    if cells.iter().flatten().all(is_sea) {
        return 0;
    }
    let around = |vertex: i32| (vertex - 1).max(0)..=vertex.min(last);
    let width = |slopes: &[i32]| slopes.iter().max().unwrap() - slopes.iter().min().unwrap();
    let bound = |(x, z): (i32, i32)| {
        let cells_around = || around(z).flat_map(move |z| around(x).map(move |x| (x, z)));
        let most = |of: fn(&Node) -> i32| {
            let nodes = cells_around().flat_map(|(x, z)| &cells[z as usize * CELLS + x as usize]);
            nodes.map(of).max().unwrap()
        };
        let (low, high) = (-most(|node| -node.height), most(|node| node.height));
        let (above, below) = (most(|node| node.apart), most(|node| -node.apart));
        let (above_raised, below_raised) = (most(|node| node.raised), most(|node| -node.raised));
        let fine = ((5613 * most(|node| node.roughness)) >> 15) + 1;
        let units = |scaled: i32| (scaled + 2 * n - 1).div_euclid(2 * n);
        let nodes = if low - fine > 2048 {
            units(above_raised.max(below_raised))
        } else if high + fine < -2048 {
            units(above.max(below))
        } else {
            units(above_raised.max(below)) + 471
        };
        let (mut along, mut across) = (Vec::new(), Vec::new());
        for (x, z) in cells_around() {
            let [a, e, o, b] = corners(x, z);
            along.extend([e - a, b - o]);
            across.extend([o - a, b - e]);
        }
        nodes + fine + (width(&along) + width(&across)) / (4 * n) + 1
    };
    let vertices = (0..=last + 1).flat_map(|z| (0..=last + 1).map(move |x| (x, z)));
    (vertices.map(bound).max().unwrap() + 5).unsigned_abs()
}

#[test]
fn errors_of_levels_4_to_7_are_those_of_the_page() {
    let land = Land::new(3);
    let key = |level, x, z| ChunkKey::new(level, x, z).unwrap();
    for key in [key(4, -1, 0), key(4, 1, 1)] {
        assert_eq!(land.error_of(key), composed(&land, key), "{key}");
    }
    for key in [key(5, 0, -1), key(5, 13, 10), key(6, -1, -1), key(7, 0, 0)] {
        assert_eq!(land.error_of(key), sampled(&land, key), "{key}");
    }
    let on_land = [key(4, -1, 0), key(5, 0, -1), key(6, -1, -1), key(7, 0, 0)];
    assert!(on_land.into_iter().all(|key| land.error_of(key) > 0));
    let corner = ChunkKey::containing(5, WORLD_HALF, -WORLD_HALF);
    assert_eq!(land.error_of(corner), sampled(&land, corner));
}
