//! Every number that two languages must agree on, with its unit and range.
//!
//! Changing any of them changes the world: bump [`GENERATOR_VERSION`] with it.

/// Version of the height formula, of the grass record and of the errors of chunks. Part of the
/// world digest.
pub const GENERATOR_VERSION: u32 = 4;

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

/// Octaves of the land, widest first: [`BASE_OCTAVES`] of the base field and [`FINE_OCTAVES`] that
/// vertices evaluate themselves.
pub const OCTAVES: usize = BASE_OCTAVES + FINE_OCTAVES;
/// Octaves of the base field ([`crate::base`]).
pub const BASE_OCTAVES: usize = 4;
/// Octaves that vertices evaluate themselves ([`crate::noise`]).
pub const FINE_OCTAVES: usize = 5;
/// log2 of the first base octave's cell in turned coordinates, five times a unit (1,638.4 m);
/// every further octave halves it (last: 204.8 m).
pub const BASE_CELL_BITS: u32 = 21;
/// Stream of the first base octave; the parity of a stream decides the angle of its lattice.
pub const BASE_STREAM: u32 = 16;
/// Stream of the first of four noises that warp the coasts.
pub const WARP_STREAM: u32 = 20;
/// log2 of the cells of the warp's wide and narrow noises (3,276.8 m and 819.2 m).
pub const WARP_CELL_BITS: [u32; 2] = [22, 20];
/// Amplitudes of the warp's wide and narrow noises, metres.
pub const WARP_AMPLITUDE_M: [i32; 2] = [1800, 600];
/// Bound of the warp along one axis, metres: 0.7072 of both amplitudes.
pub const WARP_M: i32 = 1698;
/// Stream of the exposure of coasts.
pub const EXPOSURE_STREAM: u32 = 24;
/// log2 of the cell of the exposure's noise (1,638.4 m).
pub const EXPOSURE_CELL_BITS: u32 = 21;
/// Amplitudes of the base octaves in the shore, metres.
pub const SHORE_M: [i32; BASE_OCTAVES] = [64, 64, 80, 128];
/// Depth of the shore at the rim of an island's mass, metres.
pub const RIM_M: i32 = 80;
/// Factor of the shore's rise towards the middle of an island's mass, metres.
pub const UPLIFT_M: i32 = 384;
/// Height of a mountain of relief 1, metres.
pub const MOUNTAIN_M: i32 = 704;
/// log2 of the first fine octave's lattice cell in units (128 m); every further octave halves it
/// (last: 8 m).
pub const FIRST_CELL_BITS: u32 = 15;
/// log2 of the amplitude of the first fine octave in metres (16 m); every further octave halves it.
pub const FIRST_AMPLITUDE_BITS: u32 = 4;

/// Lattice shift of each fine octave in units, odd multiples of 1 m below the cell size.
///
/// Gradient noise is zero on its lattice points. Without the shift all octaves would vanish
/// together every 128 m, and vertices (multiples of 2 m) would sit on the zeros of the last
/// octaves; odd metres keep every vertex off every lattice line.
pub const OCTAVE_SHIFT: [(i32, i32); FINE_OCTAVES] =
    [(37 << 8, 93 << 8), (47 << 8, 29 << 8), (11 << 8, 19 << 8), (7 << 8, 5 << 8), (3 << 8, 1 << 8)];

/// Fraction bits inside a lattice cell, the same for all octaves (a finer octave is shifted up).
pub const FRACTION_BITS: u32 = 15;
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

/// log2 of the archipelago cell in units (8,192 m): each cell holds at most one island.
pub const ISLAND_CELL_BITS: u32 = 21;
/// Length that the lobes of the largest islands are shares of, metres.
pub const HOME_LOBE_M: i32 = 5000;

/// Half height of the beach shelf in metres: raw heights within it are flattened towards sea level.
/// A power of two; also the part of the raw height over which a cliff rises.
pub const BEACH_M: i32 = 8;
/// Rise of a fully exposed coast, metres.
pub const CLIFF_M: i32 = 34;
/// Depth below the sea where a cliff begins, metres.
pub const CLIFF_FOOT_M: i32 = 2;

/// Side of the grass density grid of a chunk.
pub const GRASS_GRID: usize = 16;
/// Cells along the side of one block of the grass density grid.
pub const BLOCK_CELLS: usize = CELLS / GRASS_GRID;
