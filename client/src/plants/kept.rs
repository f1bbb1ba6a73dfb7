//! Which clumps are kept, on the CPU: the twin of the passes that choose on the GPU, in the same
//! order.

use crate::plants::square::Square;
use crate::plants::stand::{PlantFrame, Stand};
use crate::render::pool::density_word;
use crate::world::stretch::times;
use crate::world::{Resident, World};
use shaders::layout::{BLOCK_TEXELS, CULL_MARCH};
use shaders::twin::march::chunk_is_hidden;
use shaders::twin::planting::{
    BLOCK_CELL_BITS, BLOCK_CELLS, Clump, PATCH_BLOCKS, block_is_kept, clump_at, kept,
};
use shaders::twin::surface::{FINE_BITS, Slots, Surface};
use terrain::Position;
use terrain::land::SEA_FLOOR;

/// Resident chunks by their slots.
#[derive(Debug)]
pub struct BySlot<'a> {
    chunks: Vec<Option<&'a Resident>>,
}

impl<'a> BySlot<'a> {
    /// Those of a world.
    #[must_use]
    pub fn new(world: &'a World) -> Self {
        let mut chunks = vec![None; world.capacity() as usize];
        for chunk in world.residents() {
            chunks[chunk.slot as usize] = Some(chunk);
        }
        Self { chunks }
    }

    fn get(&self, slot: u32) -> Option<&'a Resident> {
        self.chunks.get(slot as usize).copied().flatten()
    }
}

/// An empty slot reads as zeros, as it does on the GPU before its first upload.
impl Slots for BySlot<'_> {
    fn height(&self, slot: u32, index: u32) -> i32 {
        self.get(slot).map_or(0, |chunk| chunk.heights[index as usize])
    }

    fn top(&self, slot: u32, texel: u32) -> i32 {
        debug_assert!(texel < BLOCK_TEXELS as u32);
        self.get(slot).map_or(0, |chunk| chunk.maxima[texel as usize])
    }

    fn bottom(&self, slot: u32, texel: u32) -> i32 {
        self.get(slot).map_or(0, |chunk| chunk.minima[texel as usize])
    }

    fn density(&self, slot: u32, word: u32) -> u32 {
        self.get(slot).map_or(0, |chunk| density_word(chunk, word as usize))
    }
}

/// A clump that is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Kept {
    /// Level of detail.
    pub detail: u32,
    /// The clump.
    pub clump: Clump,
}

/// What is drawn of a stand.
#[must_use]
pub fn kept_of(world: &World, plants: &PlantFrame, stand: &Stand) -> Vec<Kept> {
    let slots = BySlot::new(world);
    let square = &plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    let (culling, planting) = (&stand.culling, &stand.planting);
    let noise = noise_of(world, square);
    let marches = culling.path == CULL_MARCH && culling.sees_land != 0;
    let patches = stand
        .patches
        .iter()
        .copied()
        .filter(|[column, row]| !marches || !chunk_is_hidden(&surface, culling, planting, *column, *row));
    let seen = patches
        .flat_map(blocks_of_patch)
        .filter(|[column, row]| block_is_kept(&surface, culling, planting, *column, *row));
    let clumps = seen.flat_map(|block| clumps_of(&surface, stand, block).collect::<Vec<_>>());
    let keeps =
        |clump: Clump| kept(&surface, &noise, culling, planting, &clump).map(|detail| Kept { detail, clump });
    clumps.filter_map(keeps).collect()
}

/// The height of the noise at a place of a square, fine units: what T2 marches over. The sea's
/// floor where no seed is known.
pub fn noise_of(world: &World, square: &Square) -> impl Fn(i32, i32) -> i32 {
    let (land, corner, scale) = (world.land().copied(), square.corner, world.stretch());
    move |x: i32, z: i32| {
        let at = Position::new(corner[0] + (x >> FINE_BITS), corner[1] + (z >> FINE_BITS));
        match (&land, at) {
            (Some(land), Ok(at)) => times(land.height_at(at), scale) << FINE_BITS,
            _ => SEA_FLOOR << FINE_BITS,
        }
    }
}

/// All blocks of a stand's patches, column and row in the square.
pub fn blocks_of(stand: &Stand) -> impl Iterator<Item = [i32; 2]> {
    stand.patches.iter().copied().flat_map(blocks_of_patch)
}

/// The blocks of a patch, column and row in the square.
pub fn blocks_of_patch([column, row]: [i32; 2]) -> impl Iterator<Item = [i32; 2]> {
    let side = PATCH_BLOCKS as i32;
    let (west, north) = (column * side, row * side);
    (0..side * side).map(move |index| [west + index % side, north + index / side])
}

/// All clumps that stand in a block, whether seen or not, in the order in which the passes look at
/// them.
pub fn clumps_of<'a, S: Slots>(
    surface: &'a Surface<'a, S>,
    stand: &'a Stand,
    [column, row]: [i32; 2],
) -> impl Iterator<Item = Clump> + 'a {
    let cells = 1 << BLOCK_CELL_BITS;
    (0..stand.planting.per_cell * BLOCK_CELLS).filter_map(move |lane| {
        let (cell, index) = ((lane % BLOCK_CELLS) as i32, lane / BLOCK_CELLS);
        clump_at(surface, &stand.planting, column * cells + cell % cells, row * cells + cell / cells, index)
    })
}
