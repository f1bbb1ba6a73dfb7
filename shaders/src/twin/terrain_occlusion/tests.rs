//! Occlusion beside a coarser chunk.

use super::super::surface::STEP_BITS;
use super::*;
use crate::layout::{ChunkWords, GRID_NODES, GRID_TILES, OccluderChunk, OcclusionNode};

const METRE: i32 = 1 << 12;
/// A tile in the middle of the grid, and the low corner of the next one to the east.
const TILE: i32 = 16;
const CELL: i32 = 1 << 13;
/// Row of the block at the border, of the western chunk.
const ROW: u32 = 20;

/// Heights of two chunks of which the eastern one (slot 2) is coarser than the western one (slot
/// 1, parent in slot 3), in a land (slot 0) far below, units.
struct Border;

impl Slots for Border {
    fn height(&self, slot: u32, index: u32) -> i32 {
        let (column, row) = (index % 65, index / 65);
        let coarse = |column, row| match (column, row) {
            (0, 10) => 0,
            (0, 11) => 806,
            (1, 11) => 1305,
            (1, 10) => 537,
            (2, 10 | 11) => 2048,
            _ => -1280,
        };
        let is_in_block = (62..=64).contains(&column) && (ROW..=ROW + 2).contains(&row);
        match slot {
            1 if is_in_block => 8,
            2 => coarse(column, row),
            // Its last column is the first one of slot 2.
            3 if column == 64 => coarse(0, row),
            _ => -1280,
        }
    }
    fn top(&self, _: u32, _: u32) -> i32 {
        2048
    }
    fn bottom(&self, _: u32, _: u32) -> i32 {
        -1280
    }
    fn density(&self, _: u32, _: u32) -> u32 {
        0
    }
}

fn chunk(slot: u32, parent_slot: u32, level: u32, (x, z): (i32, i32)) -> OccluderChunk {
    let words = ChunkWords { slot, parent_slot, edges: 0, corners: 0, inside: 0, place: level };
    OccluderChunk { words, x: x << (TILE_BITS - STEP_BITS), z: z << (TILE_BITS - STEP_BITS) }
}

/// A block at a border with a coarser chunk is bounded by its lowest vertex, up to its end: there
/// the neighbour is higher, but the drawn edges inside the block are not.
#[test]
fn a_slope_that_rises_over_the_lowest_vertex_of_a_moved_block_is_in_sight() {
    let mut chunks: Vec<_> = (0..GRID_TILES * GRID_TILES)
        .map(|tile| chunk(0, 0, 0, (tile % GRID_TILES, tile / GRID_TILES)))
        .collect();
    let mut nodes = vec![OcclusionNode { top: 0, bottom: 0, chunk: 0, reserved: 0 }; GRID_NODES];
    nodes.iter_mut().zip(0..chunks.len() as u32).for_each(|(node, index)| node.chunk = index);
    let at = |x: i32, z: i32| (z * GRID_TILES + x) as usize;
    let mut west = chunk(1, 3, 0, (TILE - 1, TILE));
    west.words = ChunkWords {
        edges: 64 << 8,
        corners: 64 << 8 | 64 << 24,
        inside: 1 << 9,
        place: 1 << 8,
        ..west.words
    };
    chunks[at(TILE - 1, TILE)] = west;
    for (x, z) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        nodes[at(TILE + x, TILE + z)].chunk = chunks.len() as u32;
    }
    chunks.push(chunk(2, 2, 1, (TILE, TILE)));
    let surface = Surface { slots: &Border, nodes: &nodes, chunks: &chunks };

    // The column of the ray lies 0.4 cells behind the begin of the block.
    let (x, z) = ((TILE << TILE_BITS) + 2 * CELL / 5, (TILE << TILE_BITS) + ROW as i32 * CELL + 2 * CELL / 5);
    let (progress, distance) = (60 * METRE, 66 * METRE);
    let eye = [x + 9 * progress / 10, METRE, z - progress];
    let radius = 13 * METRE / 5;
    let occludes = |below_eye: i32, slope_east: i32, slope_south: i32| {
        let occludee = Occludee {
            radius,
            slope_radius: radius,
            slope_east,
            slope_south,
            ..point_occludee(eye[0] - 9 * distance / 10, eye[1] - below_eye, eye[2] + distance)
        };
        let ray = ray_to(eye, &occludee, METRE).unwrap();
        (progress - 400..progress + 400)
            .any(|at| centre_is_above(&surface, &ray, at) && occludes_at(&surface, &ray, at))
    };
    assert!(!occludes(8, 8192, 7373), "a point of it is seen 9 cm over the triangles");
    // The control: a level one below all of the block.
    assert!(occludes(2 * METRE, 0, 0));
}
