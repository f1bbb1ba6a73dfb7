//! Vegetation: occlusion grid, culling, placement, visible clumps, drawing.

use super::terrain::ChunkWords;
use bytemuck::{Pod, Zeroable};

/// Tiles of the occlusion grid along a side.
pub const GRID_TILES: i32 = 32;

/// Nodes of the min-max quadtree over the tiles: 32 x 32, 16 x 16, and so on to one.
pub const GRID_NODES: usize = (4 * 32 * 32 - 1) / 3;

/// Most chunks in the occlusion grid: one for each tile.
pub const MAX_OCCLUDER_CHUNKS: usize = 32 * 32;

/// [`OcclusionNode::chunk`] where nothing is drawn.
pub const NO_CHUNK: u32 = u32::MAX;

/// A tile of the occlusion grid, or a node above tiles; `bound/surface.wesl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct OcclusionNode {
    /// Nothing drawn under it is higher, units.
    pub top: i32,
    /// Nothing drawn under it is lower, units.
    pub bottom: i32,
    /// The chunk under a tile, or [`NO_CHUNK`].
    pub chunk: u32,
    /// Unused; fills 16 bytes.
    pub reserved: u32,
}

/// A drawn chunk in the occlusion grid; `bound/surface.wesl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct OccluderChunk {
    /// Its slots, morphs and level; bits 16 and 17 of [`ChunkWords::place`]: palette of its plants.
    pub words: ChunkWords,
    /// Low corner, east of that of the grid, steps of 2 m.
    pub x: i32,
    /// The same, south.
    pub z: i32,
}

/// [`Culling::path`]: clumps within their draw distance (T0).
pub const CULL_DISTANCE: u32 = 0;

/// [`Culling::path`]: of these, clumps in the frustum (T1).
pub const CULL_FRUSTUM: u32 = 1;

/// [`Culling::path`]: of these, clumps that ray marching over the noise does not find occluded
/// (T2). Loses visible clumps.
pub const CULL_NOISE: u32 = 2;

/// [`Culling::path`]: clumps in the frustum that ray marching over the drawn vertices does not find
/// occluded, chunks by five points. Loses visible clumps.
pub const CULL_MARCH: u32 = 3;

/// [`Culling::path`]: clumps in the frustum that the drawn triangles do not provably occlude (T3).
pub const CULL_EXACT: u32 = 4;

/// Octaves of the height that [`CULL_NOISE`] marches over: the most whose base field is evaluated
/// at the point itself, not splined from nine nodes.
pub const NOISE_OCTAVES: usize = 6;

/// [`Culling::path`]: the same, whole blocks first (T4).
pub const CULL_HIERARCHICAL: u32 = 5;

/// Kinds of fields: grass.
pub const KIND_GRASS: u32 = 0;

/// Kinds of fields: trees.
pub const KIND_TREES: u32 = 1;

/// Uniforms of culling; `shared/culling.wesl` documents each field. Fine units are 2^-12 m.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Culling {
    /// The eye: east and south of the low corner of the grid, and above the sea; fine units.
    pub eye: [i32; 3],
    /// `CULL_*`.
    pub path: u32,
    /// Inward normals of the four side planes of the view, Q14, and a gap each.
    pub planes: [[i32; 4]; 4],
    /// Terrain nearer than this occludes nothing, fine units.
    pub start: i32,
    /// 0 where the eye is below the ground: nothing is occluded then.
    pub occlusion_enabled: u32,
    /// Step of ray marching ([`CULL_NOISE`], [`CULL_MARCH`]), fine units.
    pub step: i32,
    /// Frames for which a block stays visible after it was last seen.
    pub stay: u32,
    /// Low corner of the grid, units.
    pub corner: [i32; 2],
    /// Number of the frame, for `stay`.
    pub frame: u32,
    /// Seed of the archipelago, for the noise of T2.
    pub archipelago_seed: u32,
    /// Seeds of the fine octaves, then of the noises of the base field, likewise; then two unused
    /// words.
    pub land_seeds: [u32; 16],
    /// How much higher than its noise the land is, Q8.
    pub stretch: i32,
    /// Unused; fills 16 bytes.
    pub reserved: [u32; 3],
}

/// One species of a field; `shared/culling.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Planting {
    /// `KIND_*`.
    pub kind: u32,
    /// Of the clump streams.
    pub seed: u32,
    /// log2 of the side of a cell, fine units.
    pub cell_bits: u32,
    /// Clumps of a cell where the field is densest, 1 to 32.
    pub per_cell: u32,
    /// Cells from the world's origin to the low corner of the grid, east.
    pub cell_x: i32,
    /// The same, south.
    pub cell_z: i32,
    /// Least width, fine units.
    pub width_low: i32,
    /// Difference of the greatest width from the least, fine units.
    pub width_span: i32,
    /// Least height, fine units.
    pub height_low: i32,
    /// Difference of the greatest height from the least, fine units.
    pub height_span: i32,
    /// From here on the field is thinned, fine units.
    pub thin_from: i32,
    /// Most that a clump is widened by, Q8.
    pub widest: u32,
    /// The most that any clump reaches sideways from its root, fine units.
    pub reach: i32,
    /// The most that any clump reaches above its root, fine units.
    pub over: i32,
    /// Heights have sunk to nothing here, 1/16 m.
    pub range: i32,
    /// Distance from where heights begin to sink to `range`, 1/16 m, at least 1.
    pub collapse: i32,
    /// Squares of the distances beyond which clumps are drawn in the second and in the third level
    /// of detail, (1/16 m)².
    pub detail: [u32; 2],
    /// Most that the wind pushes the tip of a stem aside, a horizontal part of its direction, Q8.
    pub wind_reach: i32,
    /// The same of leaning away from the eye, where the eye is straight above; falls with the sine
    /// of its height.
    pub lean_reach: i32,
    /// By rank, four to a row: the square of the draw distance, (1/16 m)².
    pub draw_distance_squared: [[u32; 4]; 64],
    /// Vertices of a clump in each level of detail.
    pub vertices: [u32; 4],
    /// Capacity for clumps of each level of detail; for blocks.
    pub room: [u32; 4],
}

/// Most patches of a field: all tiles of the grid.
pub const MAX_PATCHES: usize = 1024;

/// Blocks of a patch.
pub const PATCH_BLOCK_COUNT: usize = 256;

/// Bytes of a visible clump: four words, `shared/clump.wesl` documents their bits.
pub const CLUMP_BYTES: usize = 16;

/// Bytes of what is prepared for a visible clump; `shared/prepared_clump.wesl` documents its bits.
pub const PREPARED_BYTES: usize = 16;

/// Entries of [`PREPARED_BYTES`] before those of the clumps: the indirect arguments.
pub const PREPARED_HEAD: usize = INDIRECT_WORDS / 4;

/// First word of the lists of visible blocks in the state of a culling.
pub const BLOCK_LIST: usize = 1280;
/// First word of the visibility masks in the state of a culling.
pub const MASK_BEGIN: usize = BLOCK_LIST + MAX_PATCHES * PATCH_BLOCK_COUNT;

/// Words of the visibility mask of a block: 2 bits a clump, then three counts.
pub const VISIBILITY_WORDS: usize = 35;

/// Words of the indirect arguments of a field: of a dispatch over blocks, of three draws, four
/// counts, of a dispatch over clumps, and where the clumps of each level of detail begin.
pub const INDIRECT_WORDS: usize = 28;

/// First word of the draws in the indirect arguments.
pub const INDIRECT_DRAWS: usize = 4;

/// First word of the counts in the indirect arguments: visible blocks, blocks without room, visible
/// clumps, clumps without room.
pub const INDIRECT_STATS: usize = 16;

/// First word of the dispatch over clumps in the indirect arguments.
pub const INDIRECT_PREPARE: usize = 20;

/// First word of the beginnings of the levels of detail in the indirect arguments.
pub const INDIRECT_REGIONS: usize = 24;

/// Words of the buffer of last-seen frames, for all species.
pub const LAST_SEEN_WORDS: usize = 2 << 18;

/// One kind of plant in a frame; `shared/field.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Field {
    /// Eye east of the low corner of the grid, fine units ([`FINE_PER_METRE`]), rounded.
    pub eye_x: i32,
    /// Above the sea.
    pub eye_y: i32,
    /// South of the low corner.
    pub eye_z: i32,
    /// [`KIND_GRASS`] or [`KIND_TREES`].
    pub kind: u32,
    /// Narrowest plant, metres.
    pub width_low_m: f32,
    /// Widest plant, metres.
    pub width_high_m: f32,
    /// Lowest plant, metres.
    pub height_low_m: f32,
    /// Highest plant, metres.
    pub height_high_m: f32,
    /// Distance up to which every clump is drawn, metres; beyond, a share of them that falls with
    /// the distance.
    pub thin_from_m: f32,
    /// Most that a clump is widened to make up for those that were left out, at least 1.
    pub widest: f32,
    /// Draw distance, metres.
    pub range_m: f32,
    /// Length of the end of the range over which heights sink to nothing, metres.
    pub collapse_m: f32,
    /// Distances at which the first and the second level of detail end, metres, increasing.
    pub lod_m: [f32; 2],
    /// 0 none to 1 a gale.
    pub wind: f32,
    /// How far clumps lean away from an eye above them, 0 to 1.
    pub lean: f32,
    /// Whether the plants cast shadows, 0 or 1.
    pub casts: u32,
    /// Factor of a distance that decides about detail: more than 1 in images with fewer pixels.
    /// Already in `lod_m`.
    pub detail: f32,
    /// Distance up to which plants of this kind stand, metres, by whatever pass.
    pub stand_m: f32,
    /// Cells along a side of the square around the eye in which each tree is known: a multiple of
    /// 8, at most [`MOST_TREE_GRID_CELLS`].
    pub tree_grid_cells: u32,
}

/// Trees beyond the range of per-tree culling; `shared/far_trees.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct FarTrees {
    /// Patches in the list, at most [`MAX_FAR_PATCHES`].
    pub patches: u32,
    /// Capacity for trees.
    pub room: u32,
    /// Nearer trees are not among them, metres.
    pub begin_m: f32,
    /// Unused; fills 16 bytes.
    pub reserved: u32,
}

/// Most patches of far trees.
pub const MAX_FAR_PATCHES: usize = 32_768;

/// Cells along a side of a patch of far trees.
pub const FAR_PATCH_CELLS: i32 = 8;

/// First word of the counts of the patches in the state of far trees.
pub const FAR_COUNTS: usize = 8;

/// First word of their masks.
pub const FAR_MASKS: usize = FAR_COUNTS + MAX_FAR_PATCHES;

/// Words of the state of far trees: arguments of the draw, counts, masks.
pub const FAR_STATE_WORDS: usize = FAR_MASKS + 8 * MAX_FAR_PATCHES;

/// Word of the state with the number of trees without room.
pub const FAR_LOST: usize = 4;

/// Bytes of a far tree.
pub const FAR_TREE_BYTES: usize = 32;

/// Side of a cell of trees, metres. Equal to the constant of `shared/tree_cells.wesl`.
pub const TREE_CELL_M: f32 = 8.0;

/// Most cells of trees along a side of the square around the eye in which each tree is known:
/// 1,524 m in every direction.
pub const MOST_TREE_GRID_CELLS: usize = 384;

/// Bytes of the buffer of trees: two vectors, then four trees for each cell; see
/// `shared/tree_cells.wesl`.
pub const TREE_CELL_BYTES: usize = 16 * (2 + 4 * MOST_TREE_GRID_CELLS * MOST_TREE_GRID_CELLS);

/// Bytes of the buffer of marks: a word for each cell.
pub const TREE_MARK_BYTES: usize = 4 * MOST_TREE_GRID_CELLS * MOST_TREE_GRID_CELLS;

/// Bytes of the buffer of light: a word for each tree.
pub const TREE_LIGHT_BYTES: usize = 4 * TREE_MARK_BYTES;

/// Fine units, in which clumps are placed, per metre.
pub const FINE_PER_METRE: i32 = 4096;

/// Vertices of one clump of grass at each level of detail, finest first: 128 blades of 3 segments
/// as a strip of triangles, then 32 and 6 single triangles.
pub const GRASS_VERTICES: [u32; 3] = [128 * 9, 32 * 3, 6 * 3];

/// Vertices of one tree at each level of detail, finest first: triangles, those of the trunk last;
/// then an impostor.
pub const TREE_VERTICES: [u32; 3] = [6 * (168 + 10), 6 * (40 + 6), 6];

/// Longest horizontal part of the direction in which grass stands. Equal to `MAX_TILT` of
/// `shared/clump.wesl`.
pub const GRASS_TILT: f32 = 0.75;

/// Reach of blades of grass beyond half the width of their clump in the first two levels of detail,
/// metres. Equal to `SPREAD` of `bound/visibility.wesl`.
pub const GRASS_SPREAD_M: f32 = 0.22;

/// No vertex of a clump of grass is farther from its root horizontally, metres; width and height as
/// drawn, widened and collapsed. `spread_m`: [`GRASS_SPREAD_M`], or 0 in the third level of detail.
#[must_use]
pub fn grass_reach_m(width_m: f32, height_m: f32, spread_m: f32) -> f32 {
    0.5 * width_m + spread_m + GRASS_TILT * height_m
}

/// No vertex of a clump of grass is higher above its root, metres: feet follow slopes of up to 1.
/// `spread_m`: as for [`grass_reach_m`].
#[must_use]
pub fn grass_rise_m(width_m: f32, height_m: f32, spread_m: f32) -> f32 {
    height_m + 0.5 * width_m + spread_m
}
