//! Every number that two languages must agree on, with its unit and range.
//!
//! Changing any of them changes the world: bump [`GENERATOR_VERSION`] with it.

/// Version of the height formula and of the grass record. Part of the world digest.
pub const GENERATOR_VERSION: u32 = 3;

/// Position and height units per metre: both are multiples of 2^-8 m.
pub const UNITS_PER_METRE: i32 = 256;
/// log2 of [`UNITS_PER_METRE`].
pub const UNIT_BITS: u32 = 8;

/// The world is the square `[-WORLD_HALF, WORLD_HALF]` in both axes, units (4,194,304 m each way).
///
/// Capped below the i32 range so that neighbour, halo and parent arithmetic cannot overflow.
pub const WORLD_HALF: i32 = 1 << 30;

/// Every height satisfies `|h| < HEIGHT_LIMIT` units, so `f32(h) * 2^-8` is exact on every machine.
pub const HEIGHT_LIMIT: i32 = 1 << 24;

/// Cells along one side of a chunk.
pub const CELLS: usize = 64;
/// Vertices along one side of a chunk; the last row and column repeat the neighbours' first.
pub const VERTICES: usize = CELLS + 1;
/// Vertices of a chunk.
pub const VERTEX_COUNT: usize = VERTICES * VERTICES;

/// log2 of the level-0 vertex spacing in units (2 m). Level `k` doubles it `k` times.
pub const SPACING_BITS: u32 = 9;
/// log2 of the side of a level-0 chunk in units (128 m).
pub const CHUNK_BITS: u32 = SPACING_BITS + 6;
/// The coarsest level: one chunk covers the world.
pub const TOP_LEVEL: u8 = 16;

/// Octaves of the fractal sum.
pub const OCTAVES: usize = 8;
/// log2 of the first octave's lattice cell in units (1,024 m); every further octave halves it
/// (last: 8 m).
pub const FIRST_CELL_BITS: u32 = 18;
/// log2 of the amplitude of the first octave in metres (128 m); every further octave halves it.
pub const FIRST_AMPLITUDE_BITS: u32 = 7;
/// The first octaves, which are tall, keep [`SPLIT_BITS`] more bits of every weight and slope.
pub const WIDE_OCTAVES: usize = 3;
/// Bits that a wide operand has below the 16 of a narrow one.
pub const SPLIT_BITS: u32 = 8;

/// Lattice shift of each octave in units, odd multiples of 1 m below the cell size.
///
/// Gradient noise is zero on its lattice points. Without the shift all octaves would vanish
/// together every 1,024 m, and vertices (multiples of 2 m) would sit on the zeros of the last
/// octaves; odd metres keep every vertex off every lattice line.
pub const OCTAVE_SHIFT: [(i32, i32); OCTAVES] = [
    (633 << 8, 391 << 8),
    (195 << 8, 317 << 8),
    (121 << 8, 75 << 8),
    (37 << 8, 93 << 8),
    (47 << 8, 29 << 8),
    (11 << 8, 19 << 8),
    (7 << 8, 5 << 8),
    (3 << 8, 1 << 8),
];

/// Fraction bits inside a lattice cell, the same for all octaves (a finer octave is shifted up).
pub const FRACTION_BITS: u32 = 18;
/// Fraction bits of a gradient component.
pub const GRADIENT_BITS: u32 = 15;

/// 32 unit directions in Q15, at angles `(i + 1/2) * 360/32` degrees: none along an axis or a
/// diagonal, so no lattice direction is privileged.
pub const GRADIENTS: [(i16, i16); 32] = [
    (32610, 3212),
    (31357, 9512),
    (28899, 15447),
    (25330, 20788),
    (20788, 25330),
    (15447, 28899),
    (9512, 31357),
    (3212, 32610),
    (-3212, 32610),
    (-9512, 31357),
    (-15447, 28899),
    (-20788, 25330),
    (-25330, 20788),
    (-28899, 15447),
    (-31357, 9512),
    (-32610, 3212),
    (-32610, -3212),
    (-31357, -9512),
    (-28899, -15447),
    (-25330, -20788),
    (-20788, -25330),
    (-15447, -28899),
    (-9512, -31357),
    (-3212, -32610),
    (3212, -32610),
    (9512, -31357),
    (15447, -28899),
    (20788, -25330),
    (25330, -20788),
    (28899, -15447),
    (31357, -9512),
    (32610, -3212),
];

/// Fraction bits of a height while it is being composed: 2^-16 m, rounded once at the end to 2^-8
/// m.
pub const FINE_BITS: u32 = 16;

/// Depth of the open sea floor in metres below sea level (height 0). Exactly flat outside every
/// island.
pub const SEA_FLOOR_M: i32 = 64;

/// log2 of the archipelago cell in units (16,384 m): each cell holds at most one island, wholly
/// inside it.
pub const ISLAND_CELL_BITS: u32 = 22;
/// Island radii are multiples of this many metres.
pub const ISLAND_RADIUS_STEP_M: i32 = 64;
/// Radius of the island at the origin, in steps of [`ISLAND_RADIUS_STEP_M`] (6,656 m).
pub const HOME_RADIUS_STEPS: u32 = 104;
/// Dome height above the sea floor at the origin island's centre, metres.
pub const HOME_DOME_M: i32 = 264;

/// Half height of the beach shelf in metres: raw heights within it are flattened towards sea level.
pub const BEACH_M: i32 = 8;
/// Crest height of the ridges over the hills at an island's centre, and the folds at which they
/// end; metres, a power of two.
pub const RIDGE_M: i32 = 64;

/// Side of the grass density grid of a chunk.
pub const GRASS_GRID: usize = 16;
/// Cells along the side of one block of the grass density grid.
pub const BLOCK_CELLS: usize = CELLS / GRASS_GRID;
