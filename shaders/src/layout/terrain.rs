//! Terrain chunks: draw instances, chunk generation, material sets, memory of a slot.

use super::shadow::{CLEARANCE_WORDS, NODES_PER_SLOT, PageNode};
use bytemuck::{Pod, Zeroable};
use terrain::base::LATTICES;
use terrain::constants::{FINE_OCTAVES, VERTEX_COUNT};
use terrain::{ChunkKey, Octaves, Parameters};

/// How a chunk is drawn: what terrain instances and occluder chunks have in common.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ChunkWords {
    /// Slot of its heights in the pool.
    pub slot: u32,
    /// Slot of its parent's heights; its own where nothing is morphed.
    pub parent_slot: u32,
    /// Morphs of the edges, a byte each: north (lowest), east, south, west.
    pub edges: u32,
    /// Morphs of the corners, a byte each: (low, low), (high x, low z), (low x, high z), (high,
    /// high).
    pub corners: u32,
    /// Morph of the inside in the lowest byte; bits 8 to 11: the neighbour north, east, south, west
    /// is coarser; [`Self::DECIMATED`].
    pub inside: u32,
    /// Level in the lowest byte; bit 8: the chunk is an eastern quarter of its parent, bit 9: a
    /// southern one; bits 10 and 11: likewise which quarter of the chunk this is.
    pub place: u32,
}

impl ChunkWords {
    /// The bit of [`Self::inside`] that says that the instance is all of a chunk, drawn with every
    /// other vertex.
    pub const DECIMATED: u32 = 1 << 12;
}

/// A quarter of a drawn chunk.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TerrainInstance {
    /// Low corner minus the eye's whole units, metres; the vertical part is minus the eye's height.
    /// Exact below 65 km.
    pub origin_m: [f32; 3],
    /// Distance between vertices, metres.
    pub spacing_m: f32,
    /// Low corner modulo [`super::PATTERN_PERIOD_M`], metres.
    pub pattern_m: [f32; 2],
    /// Bound of the vertical error of the chunk's own surface, metres.
    pub error_m: f32,
    /// The same of its parent's surface.
    pub parent_error_m: f32,
    /// Its slots, morphs and level.
    pub words: ChunkWords,
}

/// One vertex attribute: shader location, byte offset, number of 32-bit components, float or
/// unsigned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// `@location` in the shader.
    pub location: u32,
    /// Bytes from the start of the instance.
    pub offset: usize,
    /// 1 to 4.
    pub components: u32,
    /// `f32` components, else `u32`.
    pub float: bool,
}

impl TerrainInstance {
    /// How `draw_terrain` reads an instance.
    pub const ATTRIBUTES: [Attribute; 4] = [
        Attribute { location: 0, offset: 0, components: 4, float: true },
        Attribute {
            location: 1,
            offset: std::mem::offset_of!(TerrainInstance, pattern_m),
            components: 4,
            float: true,
        },
        Attribute {
            location: 2,
            offset: std::mem::offset_of!(TerrainInstance, words.slot),
            components: 4,
            float: false,
        },
        Attribute {
            location: 3,
            offset: std::mem::offset_of!(TerrainInstance, words.inside),
            components: 2,
            float: false,
        },
    ];
}

/// The parameters of a world for the height passes; `shared/land.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct World {
    /// Seed of each fine octave, widest first.
    pub fine_seeds: [u32; FINE_OCTAVES],
    /// Seeds of the noises of the base field: octaves, warp, exposure.
    pub lattice_seeds: [u32; LATTICES],
    /// Seed of the archipelago.
    pub archipelago_seed: u32,
}

impl From<Parameters> for World {
    fn from(parameters: Parameters) -> Self {
        let Parameters { fine_seeds, lattice_seeds, archipelago_seed } = parameters;
        Self { fine_seeds, lattice_seeds, archipelago_seed }
    }
}

/// One chunk for `fill_chunks`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ChunkFill {
    /// Low corner east, units.
    pub x: i32,
    /// Low corner south, units.
    pub z: i32,
    /// log2 of the vertex spacing in units.
    pub spacing_bits: u32,
    /// Octaves that the level carries.
    pub octaves: u32,
}

impl From<ChunkKey> for ChunkFill {
    fn from(key: ChunkKey) -> Self {
        let (x, z) = key.origin();
        let octaves = Octaves::at_level(key.level()).count() as u32;
        Self { x, z, spacing_bits: key.spacing().trailing_zeros(), octaves }
    }
}

/// Most nodes of the base field that `fill_nodes` evaluates for a chunk: at level 4, where every
/// vertex has a cell of its own, the 65 x 65 vertices lie in the splines of 66 x 66 nodes.
pub const FILL_NODES: usize = 66 * 66;

/// Words of a slot in addition to its heights, which placement and occlusion of plants read: as
/// many lower bounds as upper ones, then 16 x 16 densities of a byte.
pub const RECORD_WORDS: usize = BLOCK_TEXELS + 64;

/// Words of a slot that hold the top of its max pyramid: 8 x 8 blocks, 4 x 4, 2 x 2, 1.
pub const BLOCK_TEXELS: usize = 64 + 16 + 4 + 1;

/// Memory on the GPU that a resident chunk costs, bytes: heights, clearances, bounds, densities,
/// its part of the page table.
pub const GPU_SLOT_BYTES: usize = 4 * (VERTEX_COUNT + CLEARANCE_WORDS + BLOCK_TEXELS + RECORD_WORDS)
    + NODES_PER_SLOT * size_of::<PageNode>();

/// Invocations of a workgroup of `probe_heights`, of `fill_nodes` and of `fill_heights`, in x.
pub const FILL_WORKGROUP: u32 = 64;

/// The material sets by the names of their files, in the order of `shared/material_sets.wesl`.
pub const MATERIALS: [&str; 7] = ["sand", "meadow", "dry_grass", "thicket", "cliff", "scree", "cobbles"];

/// Uniforms of `bake_materials`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Bake {
    /// Layer of the arrays, and the number of the set.
    pub layer: u32,
    /// Texels a side, a power of two.
    pub size: u32,
    /// 1 where normals are given with the texels, else 0.
    pub normals_given: u32,
    /// 1 where occlusion is given with the texels, else 0.
    pub occlusion_given: u32,
}

/// One texel of a set while it is baked.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BakeTexel {
    /// Linear.
    pub albedo: [f32; 3],
    /// 0 to 1.
    pub height: f32,
    /// Horizontal part of the unit normal, along u and v.
    pub normal: [f32; 2],
    /// Perceptual, 0 to 1.
    pub roughness: f32,
    /// Share of the sky that is seen, 0 to 1.
    pub occlusion: f32,
}

/// Invocations of a workgroup of both entries of `bake_materials`, in x.
pub const BAKE_WORKGROUP: u32 = 64;

/// Invocations of a workgroup of `reduce_materials`, in x and in y.
pub const REDUCE_WORKGROUP: u32 = 8;
