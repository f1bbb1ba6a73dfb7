//! The error of a chunk on screen, from where in the chunk it is.
//!
//! A chunk's stated error is the largest anywhere in it. Once its children are here, the land
//! between their vertices and the chunk's own triangles is known block by block, and an error far
//! from the eye counts by its own distance. That leaves more chunks whole and keeps the promise: in
//! every block the drawn surface is no farther from the land than what the block is judged by.

use crate::world::{Resident, World};
use shaders::twin::grid::GridVertex;
use shaders::twin::morph::parent_height;
use terrain::ChunkKey;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};
use terrain::lod::{self, Viewer};

/// Blocks along one side of a chunk; those of [`Resident::maxima`]' finest level.
const BLOCKS: usize = 8;

/// Cells along one side of a block.
const BLOCK_CELLS: usize = CELLS / BLOCKS;

/// Largest vertical distance between a chunk's vertices and its parent's surface in each block,
/// units, row by row.
pub type Rises = [u32; BLOCKS * BLOCKS];

/// The rises of the chunk `key` over its parent.
#[must_use]
pub fn rises(key: ChunkKey, own: &[i32; VERTEX_COUNT], parent: &[i32; VERTEX_COUNT]) -> Rises {
    let (east, south) = key.quarter();
    let quarter = (east as u32, south as u32);
    let mut rises = [0; BLOCKS * BLOCKS];
    for row in 0..VERTICES {
        for column in 0..VERTICES {
            let vertex = GridVertex { column: column as u32, row: row as u32 };
            let height = own[row * VERTICES + column];
            // One more for the half that the parent's surface is rounded down by.
            let rise = height.abs_diff(parent_height(parent, quarter, vertex)) + 1;
            // A vertex on a line between blocks belongs to both.
            for z in blocks_of(row) {
                for x in blocks_of(column) {
                    rises[z * BLOCKS + x] = rise.max(rises[z * BLOCKS + x]);
                }
            }
        }
    }
    rises
}

/// The blocks that a column or row of vertices lies in: one, or the two that it separates.
fn blocks_of(line: usize) -> std::ops::RangeInclusive<usize> {
    let low = line.saturating_sub(1) / BLOCK_CELLS;
    low..=(line / BLOCK_CELLS).min(BLOCKS - 1)
}

/// Error on screen up to which a chunk is drawn whole, 1/16 pixel.
#[must_use]
pub fn tolerance(viewer: &Viewer) -> f64 {
    f64::from(viewer.tolerance())
}

/// Whether a chunk is too coarse for a viewer. Never one that the server, which judges by the
/// level's bound, does not split.
#[must_use]
pub fn is_too_coarse(world: &World, viewer: &Viewer, key: ChunkKey, chunk: &Resident) -> bool {
    let bound = viewer.screen_error_q4(lod::level_error(key.level()), viewer.distance_to(key));
    bound > viewer.tolerance() && on_screen(world, viewer, key, chunk) > tolerance(viewer)
}

/// Error on screen of drawing a chunk, 1/16 pixel, not rounded: a bound for every place in it.
/// Never more than what the server judges the chunk by, so that less is wanted than is sent.
#[must_use]
pub fn on_screen(world: &World, viewer: &Viewer, key: ChunkKey, chunk: &Resident) -> f64 {
    let judge = Judge::new(viewer, key, chunk);
    if judge.is_settled() {
        return judge.whole;
    }
    let worst_of = |worst: f64, child| Some(worst.max(judge.portion(world, child, INSIDE)?));
    let by_blocks = key.children().and_then(|children| children.into_iter().try_fold(0.0, worst_of));
    by_blocks.unwrap_or(judge.whole).min(judge.whole)
}

/// A chunk with all its borders, for [`of_parent`].
pub const INSIDE: (i32, i32) = (0, 0);

/// Error on screen of drawing the parent of `child` in the place of it, 1/16 pixel: what of
/// [`on_screen`] of the parent is in this quarter. None without a parent that is here. Of
/// [`INSIDE`], all of it; of a step east and south, the blocks that touch the neighbour there.
#[must_use]
pub fn of_parent(world: &World, viewer: &Viewer, child: ChunkKey, toward: (i32, i32)) -> Option<f64> {
    let key = child.parent()?;
    let judge = Judge::new(viewer, key, world.get(key)?);
    let portion = if judge.is_settled() { None } else { judge.portion(world, child, toward) };
    Some(portion.unwrap_or(judge.whole).min(judge.whole))
}

/// What a chunk's error is seen as.
struct Judge<'a> {
    viewer: &'a Viewer,
    /// Bound of the error anywhere, units.
    stated: u32,
    /// No place in the chunk is nearer, units.
    nearest: u64,
    /// The largest error at the nearest distance, 1/16 pixel.
    whole: f64,
}

impl<'a> Judge<'a> {
    fn new(viewer: &'a Viewer, key: ChunkKey, chunk: &Resident) -> Self {
        // The level's bound is empirical: a chunk whose own error exceeds it would want children
        // that no server sends.
        let stated = chunk.error.min(lod::level_error(key.level()));
        let judge = Self { viewer, stated, nearest: viewer.distance_to(key), whole: 0.0 };
        let whole = judge.seen(stated, distance(viewer, key.origin(), key.side(), chunk, chunk.max));
        Self { whole, ..judge }
    }

    /// Whether the error is so small that no finer look would change anything.
    fn is_settled(&self) -> bool {
        self.whole <= f64::from(self.viewer.tolerance()) / 4.0
    }

    fn seen(&self, error: u32, distance: u64) -> f64 {
        let scaled = f64::from(error) * f64::from(self.viewer.pixels_per_radian) * 16.0;
        scaled / distance.max(self.nearest).max(1) as f64
    }

    /// The largest error in the quarter that a child covers, or along a side of it, block by block,
    /// if the child is here.
    fn portion(&self, world: &World, key: ChunkKey, (east, south): (i32, i32)) -> Option<f64> {
        let child = world.get(key)?;
        let rises = child.rises.as_ref()?;
        let (x, z) = key.origin();
        let side = key.side() / BLOCKS as u32;
        let blocks = rows_toward(south).flat_map(|row| rows_toward(east).map(move |column| (column, row)));
        let blocks = blocks.map(|(column, row)| {
            let index = row * BLOCKS + column;
            let corner = (x + column as i32 * side as i32, z + row as i32 * side as i32);
            let error =
                rises[index].saturating_add(error_in_block(world, key, child, index)).min(self.stated);
            self.seen(error, distance(self.viewer, corner, side, child, child.maxima[index]))
        });
        Some(blocks.fold(0.0, f64::max))
    }
}

/// Rows of blocks: the first towards -1, the last towards 1, else all.
fn rows_toward(way: i32) -> std::ops::Range<usize> {
    match way {
        -1 => 0..1,
        1 => BLOCKS - 1..BLOCKS,
        _ => 0..BLOCKS,
    }
}

/// Bound of a chunk's own error in one of its blocks, units: what it states of itself, or what its
/// children, if they are here, and their stated errors say.
fn error_in_block(world: &World, key: ChunkKey, chunk: &Resident, block: usize) -> u32 {
    let Some(children) = key.children() else { return chunk.error };
    // A block is two by two blocks of one child.
    let (x, z) = (2 * (block % BLOCKS), 2 * (block / BLOCKS));
    let child = world.get(children[x / BLOCKS + 2 * (z / BLOCKS)]);
    let Some((child, rises)) = child.and_then(|child| Some((child, child.rises.as_ref()?))) else {
        return chunk.error;
    };
    let (x, z) = (x % BLOCKS, z % BLOCKS);
    let rise = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dz)| rises[(z + dz) * BLOCKS + x + dx]);
    rise.into_iter().max().unwrap_or(0).saturating_add(child.error).min(chunk.error)
}

/// Distance from the eye to where the true land of a square can be that lies in a chunk and whose
/// drawn surface rises no higher than `highest`, units.
fn distance(viewer: &Viewer, corner: (i32, i32), side: u32, chunk: &Resident, highest: i32) -> u64 {
    let error = i32::try_from(chunk.error).unwrap_or(i32::MAX);
    viewer.distance_to_block(corner, side, chunk.min.saturating_sub(error), highest.saturating_add(error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::Land;

    #[test]
    fn every_vertex_of_a_block_is_within_its_rise_and_some_is_at_it() {
        let land = Land::new(1);
        for (level, x, z) in [(0, 3, -2), (1, -4, 5), (2, 1, 1)] {
            let key = ChunkKey::new(level, x, z).unwrap();
            let (own, parent) = (land.chunk_heights(key), land.chunk_heights(key.parent().unwrap()));
            let (east, south) = key.quarter();
            let rises = rises(key, &own, &parent);
            let largest = |block: usize| {
                let (x, z) = (block % BLOCKS * BLOCK_CELLS, block / BLOCKS * BLOCK_CELLS);
                let vertices = (z..=z + BLOCK_CELLS)
                    .flat_map(|row| (x..=x + BLOCK_CELLS).map(move |column| (column, row)));
                let rise = |(column, row): (usize, usize)| {
                    let vertex = GridVertex { column: column as u32, row: row as u32 };
                    own[row * VERTICES + column].abs_diff(parent_height(
                        &parent,
                        (east as u32, south as u32),
                        vertex,
                    ))
                };
                vertices.map(rise).max().unwrap()
            };
            for (block, rise) in rises.iter().enumerate() {
                assert_eq!(*rise, largest(block) + 1, "{key} block {block}");
            }
        }
    }

    #[test]
    fn a_finer_look_only_lowers_the_error_and_lowers_it_somewhere() {
        let land = Land::new(1);
        let mut world = World::new(100);
        let key = ChunkKey::new(1, 2, 3).unwrap();
        let viewer = Viewer {
            eye: (100_000, 30_000, 260_000),
            distance_m: 4000,
            pixels_per_radian: 900,
            tolerance_q4: 1,
        };
        world.insert(land.chunk(key));
        let before = on_screen(&world, &viewer, key, world.get(key).unwrap());
        let [first, rest @ ..] = key.children().unwrap();
        for child in rest {
            world.insert(land.chunk(child));
        }
        assert_eq!(on_screen(&world, &viewer, key, world.get(key).unwrap()), before, "one child is missing");
        world.insert(land.chunk(first));
        let after = on_screen(&world, &viewer, key, world.get(key).unwrap());
        assert!(after < before && after > 0.0, "{after} {before}");
    }

    #[test]
    fn rises_are_known_in_whichever_order_parent_and_child_arrive() {
        let land = Land::new(1);
        let child = ChunkKey::new(0, 3, -2).unwrap();
        let parent = child.parent().unwrap();
        let rises_after = |order: [ChunkKey; 2]| {
            let mut world = World::new(4);
            for key in order {
                world.insert(land.chunk(key));
            }
            world.get(child).unwrap().rises
        };
        let rises = rises_after([parent, child]);
        assert!(rises.is_some() && rises == rises_after([child, parent]));
    }
}
