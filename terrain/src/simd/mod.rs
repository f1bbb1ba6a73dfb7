//! Whole grids at once, on the vectors of this machine.
//!
//! One algorithm (`strip`, `curves`, `base`, `field`, `shape`, `pyramid`, `slope`) over one small
//! set of vector operations (`lanes`), implemented for single integers and for each instruction set
//! that is measurably faster. All kernels yield the same bits.
//!
//! The only unsafe code of this crate: vector instructions may only run on CPUs that have them, and
//! vectors are loaded through pointers. A [`Kernel`] that needs a feature exists only where that
//! feature was detected.
#![expect(unsafe_code, reason = "vector instructions; every block states what it relies on")]

mod base;
mod curves;
mod density;
mod distance;
mod field;
mod kernel;
mod lanes;
mod nodes_apart;
mod pyramid;
mod shape;
mod slope;
mod strip;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod wasm;
#[cfg(target_arch = "x86_64")]
mod x86;

use crate::base::Base;
use crate::constants::{BASE_OCTAVES, CELLS, GRASS_GRID, VERTEX_COUNT};
use crate::grid::Grid;
use crate::island::Lobe;
use crate::land::Land;
use crate::noise::Fbm;
use crate::octaves::Octaves;
use crate::ring::mul_hi;
use crate::shape::coast;
use crate::spline;
use crate::texels::Texels;
use kernel::Set;
use lanes::Lanes;
use std::mem::MaybeUninit;
use strip::{Columns, Sink, Strip, strips};

pub(crate) use distance::Window;
pub use kernel::Kernel;
pub(crate) use nodes_apart::{Corners, NodesApart};

/// Defines an entry point: a safe function that runs a generic body under the instruction set of a
/// kernel.
macro_rules! entry {
    ($(#[$doc:meta])* $name:ident($($argument:ident: $type:ty),*) => $body:ident) => {
        $(#[$doc])*
        pub(crate) fn $name(kernel: Kernel, $($argument: $type),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "sse4.1,ssse3")]
            fn sse41($($argument: $type),*) {
                // SAFETY: this function has the features of its lanes.
                unsafe { $body::<x86::Sse41>($($argument),*) }
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2($($argument: $type),*) {
                // SAFETY: as above.
                unsafe { $body::<x86::Avx2>($($argument),*) }
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512bw")]
            fn avx512($($argument: $type),*) {
                // SAFETY: as above.
                unsafe { $body::<x86::Avx512>($($argument),*) }
            }
            // SAFETY: a kernel exists only where its features were detected.
            unsafe {
                match kernel.0 {
                    Set::Scalar => $body::<i32>($($argument),*),
                    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
                    Set::Simd128 => $body::<wasm::Simd128>($($argument),*),
                    #[cfg(target_arch = "x86_64")]
                    Set::Sse41 => sse41($($argument),*),
                    #[cfg(target_arch = "x86_64")]
                    Set::Avx2 => avx2($($argument),*),
                    #[cfg(target_arch = "x86_64")]
                    Set::Avx512 => avx512($($argument),*),
                }
            }
        }
    };
}

entry! {
    /// The fractal sum of the fine octaves over a grid, 2^-16 m, row by row. `out` holds the grid's
    /// vertices.
    noise(fbm: &Fbm, grid: &Grid, out: &mut [i32]) => noise_on
}

entry! {
    /// The heights of a grid, units, row by row. `out` holds the grid's vertices.
    heights(land: &Land, grid: &Grid, out: &mut [i32]) => heights_on
}

entry! {
    /// The base field with all octaves at a rectangle of nodes, `columns` wide, row by row from a
    /// first cell on: heights (2^-16 m), and roughness with exposure above it (16 bits each).
    nodes(land: &Land, first: (i32, i32), columns: usize, heights: &mut [i32], shares: &mut [i32]) => nodes_on
}

entry! {
    /// The base field with this many octaves at any places near a list of lobes, without a spline:
    /// heights (2^-16 m), and roughness with exposure above it (16 bits each).
    nodes_at(
        base: &Base,
        lobes: &[Lobe],
        octaves: usize,
        places: &[(i32, i32)],
        heights: &mut [i32],
        shares: &mut [i32]
    ) => nodes_at_on
}

entry! {
    /// Largest distance between triangles and a finer grid; see [`distance::farthest`].
    farthest_into(level: u8, heights: &[i32], fine: &Window, worst: &mut i32) => farthest_on
}

entry! {
    /// Adds the nodes of a vertex cell with 2, 4 or 8 along its side; see
    /// [`nodes_apart::nodes_apart`].
    nodes_apart(
        corners: Corners,
        side: usize,
        heights: &[i32],
        shares: &[i32],
        stride: usize,
        apart: &mut NodesApart
    ) => nodes_apart_on
}

entry! {
    /// The texels of the pyramid of upper bounds of a chunk, all of them.
    maxima_into(heights: &[i32; VERTEX_COUNT], texels: &mut UninitTexels) => maxima_on
}

entry! {
    /// The texels of the pyramid of lower bounds of a chunk, all of them.
    minima_into(heights: &[i32; VERTEX_COUNT], texels: &mut UninitTexels) => minima_on
}

entry! {
    /// Largest sum of squares of a triangle's two legs, units squared; see [`slope::steepest`].
    steepest_into(heights: &[i32; VERTEX_COUNT], worst: &mut i32) => steepest_on
}

entry! {
    /// See [`slope::longest_leg`].
    longest_leg_into(heights: &[i32; VERTEX_COUNT], longest: &mut i32) => longest_leg_on
}

entry! {
    /// See [`density::densities`].
    densities(
        heights: &[i32; VERTEX_COUNT],
        side_bits: u32,
        density: &mut [u8; GRASS_GRID * GRASS_GRID]
    ) => densities_on
}

/// Largest difference of two neighbours in a row or a column, units.
pub(crate) fn longest_leg(kernel: Kernel, heights: &[i32; VERTEX_COUNT]) -> i32 {
    let mut longest = 0;
    longest_leg_into(kernel, heights, &mut longest);
    longest
}

/// Largest sum of squares of a triangle's two legs, units squared, of heights whose neighbours in
/// rows and columns lie within 2^15 of each other.
pub(crate) fn steepest(kernel: Kernel, heights: &[i32; VERTEX_COUNT]) -> i32 {
    let mut worst = 0;
    steepest_into(kernel, heights, &mut worst);
    worst
}

/// Memory for a pyramid. Not cleared first, because clearing costs as much as the reduction.
type UninitTexels = MaybeUninit<Texels>;

impl Fbm {
    /// The sums of a grid, row by row, by a given kernel: equal to [`Fbm::at`] bit for bit. 2^-16
    /// m.
    ///
    /// # Panics
    /// If `out` does not hold exactly the grid's vertices.
    pub fn grid_on(&self, kernel: Kernel, grid: &Grid, out: &mut [i32]) {
        noise(kernel, self, grid, out);
    }
}

impl Land {
    /// Heights of a grid, units, row by row, with the fastest kernel of this machine.
    ///
    /// # Panics
    /// If `out` does not hold exactly the grid's vertices.
    pub fn heights(&self, grid: &Grid, out: &mut [i32]) {
        self.heights_on(Kernel::best(), grid, out);
    }

    /// Heights of a grid by a given kernel: every kernel and [`Land::height_keeping`] agree bit for
    /// bit.
    ///
    /// # Panics
    /// If `out` does not hold exactly the grid's vertices.
    pub fn heights_on(&self, kernel: Kernel, grid: &Grid, out: &mut [i32]) {
        assert_eq!(out.len(), grid.vertex_count(), "`out` must hold every vertex of the grid");
        heights(kernel, self, grid, out);
    }

    /// [`Land::height_keeping`] of places in the world, units, with octaves that are not splined.
    /// Fast where all lie within some kilometres.
    pub(crate) fn heights_along(&self, octaves: Octaves, places: &[(i32, i32)], heights: &mut [i32]) {
        assert!(!octaves.splined() && places.len() == heights.len());
        let range = |of: fn(&(i32, i32)) -> i32| {
            let values = || places.iter().map(of);
            (values().min().unwrap_or(0), values().max().unwrap_or(0))
        };
        let ((west, east), (north, south)) = (range(|place| place.0), range(|place| place.1));
        let lobes =
            self.archipelago().lobes_near(west, north, east.abs_diff(west).max(south.abs_diff(north)));
        let mut shares = vec![0; places.len()];
        nodes_at(Kernel::best(), self.base(), &lobes, octaves.base(), places, heights, &mut shares);
        for (((x, z), height), shares) in places.iter().zip(heights).zip(shares) {
            let (roughness, exposure) = (shares & 0xffff, shares >> 16);
            let fine = if roughness == 0 { 0 } else { self.fbm().at(*x, *z, octaves) };
            *height = coast(*height + mul_hi(fine << 9, roughness << 8), exposure);
        }
    }
}

/// The pyramid of upper (or lower) bounds of a chunk.
pub(crate) fn pyramid(kernel: Kernel, heights: &[i32; VERTEX_COUNT], max: bool) -> Box<Texels> {
    let mut texels = Box::<Texels>::new_uninit();
    let kernel = kernel.for_short_rows();
    if max {
        maxima_into(kernel, heights, &mut texels);
    } else {
        minima_into(kernel, heights, &mut texels);
    }
    // SAFETY: a reduction writes every texel of every level.
    unsafe { texels.assume_init() }
}

/// Writes the noise of one strip into the grid's sums.
struct Noise<'a> {
    grid: &'a Grid,
    columns: Columns,
    out: *mut i32,
}

impl<L: Lanes> Sink<L> for Noise<'_> {
    #[inline(always)]
    unsafe fn begin_row(&mut self, _: usize) -> bool {
        true
    }

    #[inline(always)]
    unsafe fn put(&mut self, row: usize, column: usize, fine: L) {
        let index = row * self.grid.columns + self.columns.first + column;
        // SAFETY: the caller guarantees the CPU features; the rest of the strip's row lies in the
        // sums.
        unsafe { lanes::store_some(fine, self.out.add(index), self.columns.count - column) };
    }
}

/// # Safety
/// The CPU has the features of `L`; so for all of them.
#[inline(always)]
unsafe fn noise_on<L: Lanes>(fbm: &Fbm, grid: &Grid, out: &mut [i32]) {
    assert_eq!(out.len(), grid.vertex_count());
    let mut strip = Strip::new();
    for columns in strips(grid.columns) {
        let mut sink = Noise { grid, columns, out: out.as_mut_ptr() };
        // SAFETY: guaranteed by the caller; strips are at most 65 wide.
        unsafe { strip.run::<L>(fbm, grid, columns, &mut sink) };
    }
}

/// Rows of a band: bounds the memory for its nodes to 0.5 MB.
const BAND_ROWS: usize = 513;

#[inline(always)]
unsafe fn heights_on<L: Lanes>(land: &Land, grid: &Grid, out: &mut [i32]) {
    let mut strip = Strip::new();
    let bands = (0..grid.rows).step_by(BAND_ROWS).zip(out.chunks_mut(BAND_ROWS * grid.columns.max(1)));
    for (row, out) in bands {
        let band = grid.band(row, BAND_ROWS);
        for columns in strips(band.columns) {
            // SAFETY: see `noise_on`.
            unsafe {
                let field = field::Field::new::<L>(land.base(), land.archipelago(), &band, columns);
                let mut sink = shape::Shaper::new(field, &band, columns, out);
                strip.run::<L>(land.fbm(), &band, columns, &mut sink);
            }
        }
    }
}

#[inline(always)]
unsafe fn nodes_on<L: Lanes>(
    land: &Land,
    first: (i32, i32),
    columns: usize,
    heights: &mut [i32],
    shares: &mut [i32],
) {
    let rows = heights.len() / columns.max(1);
    let side = (columns.max(rows) as u32) << spline::CELL_BITS;
    let (x, z) = (spline::node(first.0), spline::node(first.1));
    let lobes = land.archipelago().lobes_near(x, z, side);
    // SAFETY: guaranteed by the caller.
    unsafe { field::evaluate_nodes::<L>(land.base(), &lobes, BASE_OCTAVES, first, columns, heights, shares) };
}

#[inline(always)]
unsafe fn nodes_at_on<L: Lanes>(
    base: &Base,
    lobes: &[Lobe],
    octaves: usize,
    places: &[(i32, i32)],
    heights: &mut [i32],
    shares: &mut [i32],
) {
    // SAFETY: guaranteed by the caller.
    unsafe { field::evaluate_places::<L>(base, lobes, octaves, places.iter().copied(), heights, shares) };
}

/// The compiler vectorises this body, once per instruction set; so the densities.
#[inline(always)]
unsafe fn farthest_on<L: Lanes>(level: u8, heights: &[i32], fine: &Window, worst: &mut i32) {
    *worst = match level {
        1 => distance::farthest::<1, CELLS>(heights, fine),
        2 => distance::farthest::<2, { CELLS / 2 }>(heights, fine),
        _ => distance::farthest::<3, { CELLS / 4 }>(heights, fine),
    };
}

/// The compiler vectorises this body, once per instruction set.
#[inline(always)]
unsafe fn nodes_apart_on<L: Lanes>(
    corners: Corners,
    side: usize,
    heights: &[i32],
    shares: &[i32],
    stride: usize,
    apart: &mut NodesApart,
) {
    match side {
        2 => nodes_apart::nodes_apart::<2>(corners, heights, shares, stride, apart),
        4 => nodes_apart::nodes_apart::<4>(corners, heights, shares, stride, apart),
        _ => nodes_apart::nodes_apart::<8>(corners, heights, shares, stride, apart),
    }
}

/// Largest distance between the drawn surface of a level (1 to 3) and a window of level 0, units,
/// rounded up. `heights` are the vertices of the level in the window, row by row.
pub(crate) fn farthest(level: u8, heights: &[i32], fine: &Window) -> u32 {
    debug_assert!((1..=3).contains(&level));
    let mut worst = 0;
    farthest_into(Kernel::best(), level, heights, fine, &mut worst);
    worst.unsigned_abs().div_ceil(1 << level)
}

#[inline(always)]
unsafe fn steepest_on<L: Lanes>(heights: &[i32; VERTEX_COUNT], worst: &mut i32) {
    // SAFETY: guaranteed by the caller.
    unsafe { slope::steepest::<L>(heights, worst) }
}

#[inline(always)]
unsafe fn longest_leg_on<L: Lanes>(heights: &[i32; VERTEX_COUNT], longest: &mut i32) {
    // SAFETY: guaranteed by the caller.
    unsafe { slope::longest_leg::<L>(heights, longest) }
}

/// The compiler vectorises this body, once per instruction set; the lane type selects the set only.
#[inline(always)]
unsafe fn densities_on<L: Lanes>(
    heights: &[i32; VERTEX_COUNT],
    side_bits: u32,
    density: &mut [u8; GRASS_GRID * GRASS_GRID],
) {
    density::densities(heights, side_bits, density);
}

#[inline(always)]
unsafe fn maxima_on<L: Lanes>(heights: &[i32; VERTEX_COUNT], texels: &mut UninitTexels) {
    // SAFETY: guaranteed by the caller.
    unsafe { pyramid::reduce::<L, true>(heights, texels) }
}

#[inline(always)]
unsafe fn minima_on<L: Lanes>(heights: &[i32; VERTEX_COUNT], texels: &mut UninitTexels) {
    // SAFETY: guaranteed by the caller.
    unsafe { pyramid::reduce::<L, false>(heights, texels) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::{FIRST_CELL_BITS, SPACING_BITS, TOP_LEVEL, WORLD_HALF};
    use crate::octaves::Octaves;
    use crate::position::Position;
    use proptest::prelude::*;

    /// Every kernel against the definition, vertex by vertex.
    fn check(land: &Land, grid: &Grid) {
        let count = grid.vertex_count();
        for kernel in Kernel::available() {
            let (mut heights, mut fine) = (vec![1; count], vec![1; count]);
            land.heights_on(kernel, grid, &mut heights);
            land.fbm().grid_on(kernel, grid, &mut fine);
            for index in 0..count {
                let (x, z) = grid.position(index % grid.columns, index / grid.columns);
                let place = format!("{kernel} at ({x}, {z}), vertex {index} of {grid:?}");
                assert_eq!(fine[index], land.fbm().at(x, z, grid.octaves), "noise by {place}");
                let position = Position::new(x, z).unwrap();
                assert_eq!(heights[index], land.height_keeping(position, grid.octaves), "height by {place}");
            }
        }
    }

    fn grid(x: i32, z: i32, level: u8, columns: usize, rows: usize) -> Grid {
        Grid::new(x, z, level, columns, rows).unwrap()
    }

    #[test]
    fn heights_along_a_line_equal_points() {
        for seed in 0..20 {
            let land = Land::new(seed);
            let places: Vec<_> = (0..97).map(|n| (n * 14_000 + 77, -9_001 * n)).collect();
            for octaves in [0, 3, 5].map(|count| Octaves::new(count).unwrap()) {
                let mut heights = vec![1; places.len()];
                land.heights_along(octaves, &places, &mut heights);
                for ((x, z), height) in places.iter().zip(heights) {
                    let position = Position::new(*x, *z).unwrap();
                    assert_eq!(height, land.height_keeping(position, octaves), "({x}, {z})");
                }
            }
        }
    }

    #[test]
    fn this_machine_has_the_scalar_kernel_and_the_best_is_available() {
        assert_eq!(Kernel::available().next(), Some(Kernel::SCALAR));
        assert!(Kernel::available().any(|kernel| kernel == Kernel::best()));
        assert_eq!(Kernel::named("scalar"), Some(Kernel::SCALAR));
        assert_eq!(Kernel::named("abacus"), None);
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn kernels_are_those_whose_features_this_cpu_has() {
        let sse41 = is_x86_feature_detected!("sse4.1") && is_x86_feature_detected!("ssse3");
        let avx2 = is_x86_feature_detected!("avx2");
        let avx512 = avx2 && is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw");
        let names = [("scalar", true), ("sse4.1", sse41), ("avx2", avx2), ("avx512", avx512)];
        let names: Vec<_> = names.iter().filter(|(_, runs)| *runs).map(|(name, _)| *name).collect();
        let available: Vec<_> = Kernel::available().collect();
        assert_eq!(available.iter().map(Kernel::to_string).collect::<Vec<_>>(), names);
        assert_eq!(Some(&Kernel::best()), available.last());
        for kernel in available {
            let short = kernel.for_short_rows().to_string();
            assert!(short == kernel.to_string() || (short == "avx2" && kernel.to_string() == "avx512"));
            assert_ne!(short, "avx512");
        }
    }

    #[test]
    fn kernels_equal_points_at_every_level_and_world_corner() {
        let land = Land::new(7);
        for level in 0..=TOP_LEVEL {
            let spacing = 1i64 << (SPACING_BITS + u32::from(level));
            let span = ((64 * spacing).min(2 * i64::from(WORLD_HALF)) / spacing) as usize + 1;
            let low = -WORLD_HALF;
            let high = (i64::from(WORLD_HALF) - (span as i64 - 1) * spacing) as i32;
            let near_home = (-(span as i64 / 2) * spacing) as i32;
            for (x, z) in [(low, low), (low, high), (high, low), (high, high), (near_home, near_home)] {
                check(&land, &grid(x, z, level, span, 3));
            }
        }
    }

    #[test]
    fn kernels_equal_points_across_every_lattice_line_of_both_signs() {
        let land = Land::new(8);
        for (octave, shift) in Octaves::ALL.shifts() {
            let cell = 1 << (FIRST_CELL_BITS - octave as u32);
            for line in [-3, -1, 0, 1, 5].map(|n| n * cell) {
                for around in [-1, 0, 1] {
                    let (x, z) = (line - shift.0, line - shift.1 + around);
                    check(&land, &grid(x + around - 9 * 512, z - 512, 0, 19, 3));
                }
            }
        }
    }

    #[test]
    fn kernels_equal_points_on_wide_and_narrow_grids() {
        let land = Land::new(9);
        for columns in [1, 2, 7, 8, 15, 16, 17, 63, 64, 65, 66, 127, 128, 129, 130, 200] {
            check(&land, &grid(-60_000, 25_000, 1, columns, 2));
        }
        check(&land, &grid(5, 7, 0, 0, 4));
        check(&land, &grid(5, 7, 0, 4, 0));
        // Rows that leave the island and come back: the noise is skipped between.
        check(&land, &grid(1_600_000, -1_800_000, 4, 5, 400));
    }

    #[test]
    fn fewer_octaves_are_the_first_of_them() {
        let land = Land::new(10);
        for kept in 0..=9 {
            let grid = grid(-90_000, 4_000, 0, 65, 5).keeping(Octaves::new(kept).unwrap());
            assert_eq!(grid.octaves().count(), kept);
            check(&land, &grid);
        }
    }

    proptest! {
        #[test]
        fn kernels_equal_points_anywhere(
            seed: u64, x in -WORLD_HALF..WORLD_HALF - (32 << 18), z in -WORLD_HALF..WORLD_HALF - (4 << 18),
            near_home: bool, level in 0u8..10, columns in 1usize..33, rows in 1usize..5,
        ) {
            let (x, z) = if near_home { (x >> 10, z >> 10) } else { (x, z) };
            check(&Land::new(seed), &grid(x, z, level, columns, rows));
        }
    }
}
