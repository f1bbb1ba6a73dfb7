//! What the CPU hands to the shaders, byte for byte. Tests compare every offset with naga's
//! reflection of the WGSL.

use crate::twin::morph::Seams;
use bytemuck::{Pod, Zeroable};
use terrain::constants::{OCTAVES, VERTEX_COUNT, VERTICES};
use terrain::{ChunkKey, Octaves, Parameters};

/// The uniforms of a frame; `shared/frame.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Frame {
    /// Camera-relative metres to clip space, column by column; infinite reversed-Z.
    pub clip_from_camera: [[f32; 4]; 4],
    /// Half the width of the image plane at distance 1, along the camera's right.
    pub ray_right: [f32; 3],
    /// Seconds; moves water and clouds.
    pub time_s: f32,
    /// Half the height of the image plane at distance 1, along the camera's up.
    pub ray_up: [f32; 3],
    /// Eye above sea level, metres.
    pub eye_height_m: f32,
    /// Unit vector into the picture.
    pub ray_forward: [f32; 3],
    /// End of the land, metres.
    pub view_distance_m: f32,
    /// Unit vector to the sun.
    pub sun: [f32; 3],
    /// Multiplies the light before the tone curve; 1 is neutral.
    pub exposure: f32,
    /// The eye's position below one unit, metres (0 to 2^-8).
    pub eye_fraction_m: [f32; 3],
    /// 1 / height of the target in pixels.
    pub pixel: f32,
    /// Eye east and south, metres modulo [`PATTERN_PERIOD_M`].
    pub pattern_eye_m: [f32; 2],
    /// Target size, pixels.
    pub viewport: [f32; 2],
    /// 0 Lambert, 1 Burley.
    pub diffuse: u32,
    /// 0 exact, 1 fast.
    pub visibility: u32,
    /// 0 off, 1 two scales, 2 hexagons.
    pub tiling: u32,
    /// 0 flat, 1 one offset, 2 to 4 that many steps, 5 marched.
    pub water_tier: u32,
    /// 0 none, 1 hard, 2 soft.
    pub shadows: u32,
    /// 0 picture, 1 wireframe, 2 levels, 3 normals, 4 error.
    pub show: u32,
    /// Pixels per radian in the middle of the picture.
    pub pixels_per_radian: f32,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f32,
    /// Depth of the waves' parallax, 0 to 1; 0.2 is their true height.
    pub parallax_factor: f32,
    /// Raises the surface of the water, metres.
    pub parallax_bias_m: f32,
    /// Multiplies heights and slopes of the waves; 1 is a fresh breeze.
    pub wave_steepness: f32,
    /// Unused; fills 16 bytes.
    pub reserved: f32,
    /// How reliefs are marched.
    pub relief: Relief,
    /// Written on the GPU, by `measure_sky`.
    pub air: Air,
}

/// What sun and sky give in a frame; `shared/frame.wesl` documents each field. Three components and
/// a gap each.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Air {
    /// White ground that faces the sun.
    pub sun: [f32; 4],
    /// The same at the height of the clouds.
    pub sun_aloft: [f32; 4],
    /// Sunlight in the air, level towards the sun.
    pub toward: [f32; 4],
    /// Level away from it.
    pub away: [f32; 4],
    /// Upwards.
    pub upward: [f32; 4],
    /// Light scattered more than once.
    pub manifold: [f32; 4],
    /// The sky on a white surface, mean over all normals.
    pub sky_mean: [f32; 4],
    /// Its growth with the normal's axis east.
    pub sky_east: [f32; 4],
    /// Up.
    pub sky_up: [f32; 4],
    /// South.
    pub sky_south: [f32; 4],
}

/// Every pattern in the world repeats after so many metres; a power of two. Equal to the constant
/// of `shared/frame.wesl`.
pub const PATTERN_PERIOD_M: i32 = 8192;

/// One ray for `probe_waves`; that file documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct WaveProbe {
    /// Where the ray meets the mean plane, pattern metres.
    pub place_m: [f32; 2],
    /// Size of a pixel there, metres.
    pub footprint_m: f32,
    /// Scales the waves.
    pub strength: f32,
    /// Unit vector to the eye; y positive.
    pub to_eye: [f32; 3],
    /// Eye above the plane, metres.
    pub eye_m: f32,
    /// A tier's word, or one of [`PROBE_STEPPED`], [`PROBE_MARCHED`], [`PROBE_FIXED`].
    pub method: u32,
    /// Steps of the first two.
    pub steps: u32,
    /// Least cosine of [`PROBE_STEPPED`].
    pub floor_cosine: f32,
    /// Unused.
    pub reserved: u32,
}

/// Iterative parallax with steps and least cosine of the probe.
pub const PROBE_STEPPED: u32 = 6;
/// Marched with as many steps as the probe says.
pub const PROBE_MARCHED: u32 = 7;
/// The plain parallax of a fixed view.
pub const PROBE_FIXED: u32 = 8;

/// How reliefs are marched; `shared/relief.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Relief {
    /// 0 flat, 1 one offset, 2 linear search, 3 relaxed cones, 4 max pyramid, 5 by travel.
    pub tier: u32,
    /// Steps of the linear search looking straight down, 1 to 256.
    pub steps_min: u32,
    /// The same along the plane.
    pub steps_max: u32,
    /// 0 none, 1 segment, 2 secant, 3 bisection.
    pub refine: u32,
    /// Rounds of the last two.
    pub refinements: u32,
    /// 0 leaves the loop at the crossing, 1 runs to its end.
    pub loop_form: u32,
    /// 0 by the sampler, 1 by f32.
    pub heights: u32,
    /// Of the relief on itself: 0 none, 1 hard, 2 soft.
    pub shadow: u32,
    /// 0 none, 1 rectangle, 2 curved edge, 3 shell.
    pub silhouette: u32,
    /// 1: depth of the relief, 0: of the plane.
    pub depth: u32,
    /// Height that lies on the plane, 0 to 1.
    pub pivot: f32,
    /// Multiplies the relief of every material.
    pub amplitude: f32,
    /// Of a curved edge: strength, height bias, safe threshold, falloff power.
    pub horizon: [f32; 4],
    /// Texels of travel up to which nothing is displaced.
    pub travel_flat: f32,
    /// Up to which one offset is taken.
    pub travel_offset: f32,
    /// Up to which the search is linear.
    pub travel_linear: f32,
    /// Height of a relief on screen at which it begins to sink, pixels; 0: it never does.
    pub fade_px: f32,
}

/// One pass over the bounds of a height map; `reduce_relief.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ReliefReduction {
    /// Texels a side of the map.
    pub side: u32,
    /// Mip level of the map.
    pub lod: u32,
    /// Level of bounds.
    pub level: u32,
    /// Unused.
    pub reserved: u32,
}

/// Threads of a workgroup of `reduce_relief` along either side.
pub const RELIEF_WORKGROUP: u32 = 8;

/// One dispatch of the baking of cones; `bake_cones.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ConeOrder {
    /// Texels a side of the map.
    pub side: u32,
    /// Mip level.
    pub lod: u32,
    /// Layer of the map.
    pub layer: u32,
    /// Texels a side of the block that a cone holds for.
    pub block: u32,
    /// First cone, row by row.
    pub first: u32,
    /// Cones.
    pub count: u32,
    /// Unused.
    pub reserved: [u32; 2],
    /// Where cones look, 1/4096 texels along u and v.
    pub directions: [[i32; 2]; 32],
}

/// Threads of a workgroup of `bake_cones`.
pub const CONE_WORKGROUP: u32 = 64;

/// One ray for `probe_relief`; that file documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ReliefProbe {
    /// Where it meets the plane, tiles.
    pub uv: [f32; 2],
    /// Height of the relief, tiles.
    pub amplitude: f32,
    /// Mip level of the map.
    pub lod: u32,
    /// Unit vector to the eye: along u, along v, along the normal.
    pub to_eye: [f32; 3],
    /// Layer of the map.
    pub layer: u32,
    /// Unit vector to the sun in the same frame.
    pub to_sun: [f32; 3],
    /// Unused.
    pub reserved: u32,
}

/// What `probe_relief` found; that file documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ReliefFinding {
    /// Where the ray meets the relief, tiles.
    pub uv: [f32; 2],
    /// Height there on the ray, 0 to 1.
    pub height: f32,
    /// Height of the surface there minus that.
    pub residual: f32,
    /// Share of the sun that is seen from there.
    pub sun: f32,
    /// Heights and bounds looked up to find it.
    pub fetches: u32,
    /// Unused.
    pub reserved: [u32; 2],
}

/// An object of the relief scenes; `shared/relief_object.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ReliefObject {
    /// Middle, camera-relative metres.
    pub origin_m: [f32; 3],
    /// 0 as the knobs say, 1 flat, 2 one offset, 3 displaced geometry, 4 plain.
    pub mode: u32,
    /// The object's first axis in those of the world.
    pub tangent: [f32; 3],
    /// As [`Relief::silhouette`], where that says none.
    pub silhouette: u32,
    /// The second axis.
    pub bitangent: [f32; 3],
    /// 0 plane, 1 capsule, 2 cube.
    pub shape: u32,
    /// The third axis.
    pub normal: [f32; 3],
    /// Material set.
    pub layer: u32,
    /// Width and height; radius and half length; half side twice. Metres.
    pub size_m: [f32; 2],
    /// Metres that a tile covers along u and v.
    pub tile_m: [f32; 2],
    /// Colour of a plain object, linear.
    pub tint: [f32; 3],
    /// Metres from height 0 to height 1.
    pub relief_m: f32,
    /// Tiles around a capsule, else over those of the mesh; over those of the mesh along v.
    pub repeats: [f32; 2],
    /// Unused.
    pub reserved: [f32; 2],
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
    /// Low corner modulo [`PATTERN_PERIOD_M`], metres.
    pub pattern_m: [f32; 2],
    /// Bound of the vertical error of the chunk's own surface, metres.
    pub error_m: f32,
    /// The same of its parent's surface.
    pub parent_error_m: f32,
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
    /// is coarser; [`Self::HALVED`].
    pub inside: u32,
    /// Level in the lowest byte; bit 8: the chunk is an eastern quarter of its parent, bit 9: a
    /// southern one; bits 10 and 11: likewise which quarter of the chunk this is.
    pub place: u32,
}

impl TerrainInstance {
    /// The bit of [`Self::inside`] that says that the instance is all of a chunk, drawn with every
    /// other vertex.
    pub const HALVED: u32 = 1 << 12;

    /// The three words in which seams travel: edges, corners, inside.
    #[must_use]
    pub fn seam_words(seams: &Seams) -> [u32; 3] {
        let coarser =
            seams.is_coarser.iter().enumerate().map(|(side, is)| u32::from(*is) << (8 + side)).sum::<u32>();
        [
            u32::from_le_bytes(seams.edges),
            u32::from_le_bytes(seams.corners),
            u32::from(seams.inside) | coarser | (u32::from(seams.is_halved) * Self::HALVED),
        ]
    }
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
            offset: std::mem::offset_of!(TerrainInstance, slot),
            components: 4,
            float: false,
        },
        Attribute {
            location: 3,
            offset: std::mem::offset_of!(TerrainInstance, inside),
            components: 2,
            float: false,
        },
    ];
}

/// Vertices of the `draw_water` call: eight sectors of a plane, and a triangle behind everything
/// for an eye under water.
pub const WATER_VERTICES: u32 = 27;

/// Texels along a side of the waves' distortion map. Equal to the constant of `shared/waves.wesl`.
pub const WAVE_MAP_SIDE: u32 = 256;

/// Invocations along each side of a workgroup of `bake_waves`.
pub const WAVE_WORKGROUP: u32 = 8;

/// What the height passes know of a world; `shared/land.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct World {
    /// Seed of each octave, coarsest first.
    pub octave_seeds: [u32; OCTAVES],
    /// Seed of the archipelago.
    pub archipelago_seed: u32,
}

impl From<Parameters> for World {
    fn from(parameters: Parameters) -> Self {
        Self { octave_seeds: parameters.octave_seeds, archipelago_seed: parameters.archipelago_seed }
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

/// The sun and the extent of the page table, for `cast_shadows`, which documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Caster {
    /// Unit vector towards the sun, east and south.
    pub toward: [f32; 2],
    /// Least slope of the horizon that matters, at least 0.
    pub slope_low: f32,
    /// Slope of the horizon from which on it is all the same.
    pub slope_high: f32,
    /// The sun above the level, radians.
    pub elevation: f32,
    /// log2 of the side of the roots, steps of 2 m.
    pub root_bits: u32,
    /// Roots east.
    pub columns: u32,
    /// Roots south.
    pub rows: u32,
    /// The highest point of all that is drawn, units.
    pub top: i32,
    /// [`SKY_WALK`], [`SKY_DARK`] or [`SKY_LIT`].
    pub sky: u32,
}

/// [`Caster::sky`]: the land decides.
pub const SKY_WALK: u32 = 0;
/// [`Caster::sky`]: the sun is down.
pub const SKY_DARK: u32 = 1;
/// [`Caster::sky`]: the sun is in the zenith, nothing hides it.
pub const SKY_LIT: u32 = 2;

/// A node of the page table of `cast_shadows`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct PageNode {
    /// [`LEAF`] and a slot, the index of the first of four children, or [`NOTHING`].
    pub link: u32,
    /// Nothing drawn under it is higher, units.
    pub top: i32,
}

/// The bit of [`PageNode::link`] that says leaf.
pub const LEAF: u32 = 1 << 31;
/// [`PageNode::link`] where nothing is drawn.
pub const NOTHING: u32 = LEAF - 1;

/// A chunk for `cast_shadows`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct CastTarget {
    /// Low corner east of that of the page table, steps of 2 m.
    pub x: i32,
    /// The same, south.
    pub z: i32,
    /// Its slot.
    pub slot: u32,
    /// Its level.
    pub level: u32,
}

/// Words of a slot that hold the sun's clearances: a byte per vertex, rows padded to whole words.
/// `shared/shadow.wesl` says what a byte means.
pub const CLEARANCE_WORDS: usize = VERTICES.div_ceil(4) * VERTICES;

/// A word of clearances that says: the sun is well clear of the land.
pub const CLEAR_WORD: u32 = u32::MAX;

/// Apparent radius of the sun, radians; the unit of clearances. Equal to the constant of
/// `shared/shadow.wesl`.
pub const SUN_RADIUS: f64 = 0.004651;

/// Clearances are kept up to so many radii. Equal to the constant of `shared/shadow.wesl`.
pub const CLEARANCE_RANGE: f64 = 8.0;

/// The clearance in radii of the sun that a byte means; the inverse of `clearance_byte` in
/// `shared/shadow.wesl`.
#[must_use]
pub fn clearance_of_byte(byte: u8) -> f64 {
    let part = (f64::from(byte) - 128.0) / 127.0;
    CLEARANCE_RANGE * part * part.abs()
}

/// Share of the sun's disc above a straight edge so many radii below its middle; `disc_share` of
/// `shared/shadow.wesl`.
#[must_use]
pub fn disc_share(clearance: f64) -> f64 {
    let x = clearance.clamp(-1.0, 1.0);
    0.5 + (x * (1.0 - x * x).sqrt() + x.asin()) / std::f64::consts::PI
}

/// Tiles along a side of the square around the eye in which plants stand and sight is tested.
pub const SQUARE_TILES: i32 = 32;

/// Nodes over the tiles of the square: 32 x 32, 16 x 16, and so on to one.
pub const SQUARE_NODES: usize = (4 * 32 * 32 - 1) / 3;

/// Leaves of the square at most: its tiles, were all of level 0.
pub const MAX_LEAVES: usize = 32 * 32;

/// [`Tile::leaf`] where nothing is drawn.
pub const NO_LEAF: u32 = u32::MAX;

/// A tile of the square, or a node above tiles; `bound/surface.wesl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Tile {
    /// Nothing drawn under it is higher, units.
    pub top: i32,
    /// Nothing drawn under it is lower, units.
    pub bottom: i32,
    /// The chunk under a tile, or [`NO_LEAF`].
    pub leaf: u32,
    /// Unused; fills 16 bytes.
    pub reserved: u32,
}

/// A drawn chunk, as far as sight and plants are concerned; `bound/surface.wesl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Leaf {
    /// Its slot.
    pub slot: u32,
    /// That of its parent; its own where nothing is morphed.
    pub parent_slot: u32,
    /// As in [`TerrainInstance::edges`].
    pub edges: u32,
    /// As in [`TerrainInstance::corners`].
    pub corners: u32,
    /// As in [`TerrainInstance::inside`].
    pub inside: u32,
    /// Level in the lowest byte, bits 8 and 9 as in [`TerrainInstance::place`]; bits 16 and 17:
    /// palette of its plants.
    pub place: u32,
    /// Low corner east of that of the square, steps of 2 m.
    pub x: i32,
    /// The same, south.
    pub z: i32,
}

impl Leaf {
    /// See [`TerrainInstance::HALVED`].
    pub const HALVED: u32 = TerrainInstance::HALVED;
}

/// Words of a slot beside its heights that plants and their sight read: lower bounds as many as
/// upper ones, then 16 x 16 densities of a byte.
pub const RECORD_WORDS: usize = BLOCK_TEXELS + 64;

/// [`Culling::path`]: what stands within its distance (T0).
pub const CULL_DISTANCE: u32 = 0;
/// [`Culling::path`]: of that, what is inside the view (T1).
pub const CULL_FRUSTUM: u32 = 1;
/// [`Culling::path`]: of that, what a march over the noise does not find hidden (T2). Wrong.
pub const CULL_NOISE: u32 = 2;
/// [`Culling::path`]: of that, what a march over the drawn vertices does not find hidden, chunks by five points (T3 as first published). Wrong.
pub const CULL_MARCH: u32 = 3;
/// [`Culling::path`]: of that, what is not proved hidden by the drawn triangles (T3).
pub const CULL_EXACT: u32 = 4;
/// [`Culling::path`]: the same, whole blocks first (T4).
pub const CULL_HIERARCHICAL: u32 = 5;

/// Kinds of fields: grass.
pub const KIND_GRASS: u32 = 0;
/// Kinds of fields: trees.
pub const KIND_TREES: u32 = 1;

/// From where a field is looked at; `shared/culling.wesl` documents each field. Fine units are
/// 2^-12 m.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Culling {
    /// The eye: east and south of the square's low corner, and above the sea; fine units.
    pub eye: [i32; 3],
    /// `CULL_*`.
    pub path: u32,
    /// Inward normals of the four side planes of the view, Q14, and a gap each.
    pub planes: [[i32; 4]; 4],
    /// The land hides nothing nearer than this, fine units.
    pub start: i32,
    /// 0 where the eye is below the ground: then nothing is hidden.
    pub sees_land: u32,
    /// Step of the marches of T2 and T3 as first published, fine units.
    pub step: i32,
    /// Frames for which a block stays after it was last seen.
    pub stay: u32,
    /// Low corner of the square, units.
    pub corner: [i32; 2],
    /// Number of the frame, for `stay`.
    pub frame: u32,
    /// Seed of the archipelago, for the noise of T2.
    pub archipelago_seed: u32,
    /// Seeds of the octaves, likewise.
    pub octave_seeds: [u32; OCTAVES],
    /// How much higher than its noise the land is, Q8.
    pub stretch: i32,
    /// Unused; fills 16 bytes.
    pub reserved: [u32; 3],
}

/// What grows in a field; `shared/culling.wesl` documents each field.
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
    /// Cells from the world's origin to the low corner of the square, east.
    pub cell_x: i32,
    /// The same, south.
    pub cell_z: i32,
    /// Least width, fine units.
    pub width_low: i32,
    /// The widest is so much wider.
    pub width_span: i32,
    /// Least height, fine units.
    pub height_low: i32,
    /// The highest is so much higher.
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
    /// They begin to sink so much nearer, 1/16 m, at least 1.
    pub collapse: i32,
    /// Squares of the distances beyond which clumps are drawn in the second and in the third level
    /// of detail, (1/16 m)².
    pub detail: [u32; 2],
    /// Most that the wind pushes the tip of a stem aside, a horizontal part of its direction, Q8.
    pub wind_reach: i32,
    /// The same of leaning away from the eye, where the eye is straight above; falls with the sine
    /// of its height.
    pub lean_reach: i32,
    /// By rank, four to a row: the square of the distance up to which it stands, (1/16 m)².
    pub stands_within: [[u32; 4]; 64],
    /// Vertices of a clump in each level of detail.
    pub vertices: [u32; 4],
    /// Clumps that there is room for in each level of detail; blocks.
    pub room: [u32; 4],
}

/// Patches of a field at most: all tiles of the square.
pub const MAX_PATCHES: usize = 1024;
/// Blocks of a patch.
pub const PATCH_BLOCK_COUNT: usize = 256;
/// Bytes of a kept clump: four words, `shared/clump.wesl` documents their bits.
pub const CLUMP_BYTES: usize = 16;

/// Words that are kept of a block while its clumps are chosen.
pub const VERDICT_WORDS: usize = 35;
/// Words of the tally of a field: arguments of a dispatch, of three draws, and four counts.
pub const TALLY_WORDS: usize = 20;
/// First word of the draws' arguments in a tally.
pub const TALLY_DRAWS: usize = 4;
/// First word of the counts in a tally: blocks kept, blocks without room, clumps kept, clumps
/// without room.
pub const TALLY_TOLD: usize = 16;
/// Words of the memory of blocks, for all kinds.
pub const MEMORY_WORDS: usize = 2 << 18;

/// Words of a slot that hold the top of its max pyramid: 8 x 8 blocks, 4 x 4, 2 x 2, 1.
pub const BLOCK_TEXELS: usize = 64 + 16 + 4 + 1;

/// Nodes of the page table that there is room for besides [`MAX_ROOTS`], per slot. A balanced cover
/// of the view needs 4/3 of a node per drawn chunk.
pub const NODES_PER_SLOT: usize = 8;

/// Roots of the page table at most.
pub const MAX_ROOTS: usize = 64;

/// Memory on the GPU that a resident chunk costs, bytes: heights, clearances, bounds, densities,
/// its part of the page table.
pub const GPU_SLOT_BYTES: usize = 4 * (VERTEX_COUNT + CLEARANCE_WORDS + BLOCK_TEXELS + RECORD_WORDS)
    + NODES_PER_SLOT * size_of::<PageNode>();

/// Words per probe that `probe_heights` writes: `mod_trunc(x, z)`, `mod_floor(x, z)`, hills, folds,
/// height.
pub const PROBE_WORDS: usize = 5;

/// Invocations of a workgroup of `probe_heights` and of `fill_heights`, in x.
pub const FILL_WORKGROUP: u32 = 64;

/// The material sets by the names of their files, in the order of `shared/material_sets.wesl`.
pub const MATERIALS: [&str; 7] = ["sand", "meadow", "dry_grass", "thicket", "cliff", "scree", "cobbles"];

/// What `bake_materials` is told of a set.
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

/// What `probe_tiling` looks at.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TilingProbe {
    /// Multiples of the anchors of materials, 256 m, in [0, [`PATTERN_PERIOD_M`]).
    pub anchor_m: [f32; 2],
    /// Number of the set.
    pub material: u32,
    /// `TILING_*` of `shared/frame.wesl`.
    pub tiling: u32,
    /// Texels of the field, across.
    pub width: u32,
    /// Texels of the field, down.
    pub height: u32,
    /// Texels of a tile.
    pub size: u32,
    /// After so many tiles the reference repeats; a power of two.
    pub period: u32,
}

/// Invocations of a workgroup of both entries of `probe_tiling`, in x.
pub const TILING_WORKGROUP: u32 = 64;

/// One question to `probe_brdf`; its vectors are unit ones, away from the surface.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BrdfProbe {
    /// Of the surface.
    pub normal: [f32; 3],
    /// Perceptual roughness, 0 to 1.
    pub roughness: f32,
    /// To the eye.
    pub to_eye: [f32; 3],
    /// Reflectance at normal incidence.
    pub f0: f32,
    /// To the light.
    pub to_light: [f32; 3],
    /// Unused; keeps the stride of the shader.
    pub gap: f32,
}

/// Words per probe that `probe_brdf` writes: distribution, the naive one, exact and fast
/// visibility, Fresnel term, diffuse term, specular albedo, cosine to the light.
pub const BRDF_TERMS: usize = 8;

/// One kind of plant in a frame; `shared/field.wesl` documents each field.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Field {
    /// Eye east of the low corner of the square of clumps, fine units ([`FINE_PER_METRE`]),
    /// rounded.
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
    /// Distance up to which every clump stands, metres; beyond it the share of them falls with the
    /// distance.
    pub thin_from_m: f32,
    /// Most that a clump is widened to make up for those that were left out, at least 1.
    pub widest: f32,
    /// Nothing stands beyond, metres.
    pub range_m: f32,
    /// Heights sink to nothing over so much of the end of the range, metres.
    pub collapse_m: f32,
    /// Distances at which the first and the second level of detail end, metres, increasing.
    pub lod_m: [f32; 2],
    /// 0 none to 1 a gale.
    pub wind: f32,
    /// How far clumps lean away from an eye above them, 0 to 1.
    pub lean: f32,
}

/// Fine units, in which clumps are placed, per metre.
pub const FINE_PER_METRE: i32 = 4096;

/// Vertices of one clump of grass at each level of detail, finest first: 9 blades of 3 segments as
/// a strip of triangles, then 9 and 6 single triangles.
pub const GRASS_VERTICES: [u32; 3] = [9 * 9, 9 * 3, 6 * 3];

/// Vertices of one tree at each level of detail, finest first: triangles.
pub const TREE_VERTICES: [u32; 2] = [3 * 114, 3 * 24];

/// Longest horizontal part of the direction in which grass stands. Equal to `MAX_TILT` of
/// `shared/clump.wesl`.
pub const GRASS_TILT: f32 = 0.75;

/// No vertex of a clump of grass is farther from its root horizontally, metres; width and height as
/// drawn, widened and collapsed.
#[must_use]
pub fn grass_reach_m(width_m: f32, height_m: f32) -> f32 {
    0.5 * width_m + GRASS_TILT * height_m
}

/// No vertex of a clump of grass is higher above its root, metres: feet follow slopes of up to 1.
#[must_use]
pub fn grass_rise_m(width_m: f32, height_m: f32) -> f32 {
    height_m + 0.5 * width_m
}
