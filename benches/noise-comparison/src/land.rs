//! Contenders of the crate `terrain`, the only file that uses it.

use crate::rounds::{Contender, Corner};
use anyhow::{Context, Result, ensure};
use std::hint::black_box;
use terrain::constants::{SPACING_BITS, VERTEX_COUNT, VERTICES};
use terrain::land::SEA_FLOOR;
use terrain::noise::Fbm;
use terrain::pyramid::PYRAMID_LEVELS;
use terrain::simd::Kernel;
use terrain::{Grid, Land, Pyramid};

/// The world; its home island is timed.
const WORLD_SEED: u64 = 1;

/// Name of the contenders of a kernel.
pub fn name(kernel: Kernel) -> String {
    format!("ours {kernel}")
}

/// Every kernel of this machine.
pub fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::available()
}

/// The kernel that the bars are for.
///
/// # Errors
/// This CPU has no AVX2.
pub fn avx2() -> Result<Kernel> {
    Kernel::named("avx2").context("this CPU has no AVX2, which the bars are for; run this on another machine")
}

/// The noise alone: the five fine octaves that every vertex evaluates.
pub fn noise<'a>(name: impl Into<String>, kernel: Kernel, columns: usize, rows: usize) -> Contender<'a> {
    noise_repeated(name, kernel, columns, rows, 1)
}

/// The noise several times, for the control that must be slower.
pub fn noise_repeated<'a>(
    name: impl Into<String>,
    kernel: Kernel,
    columns: usize,
    rows: usize,
    times: usize,
) -> Contender<'a> {
    let fbm = Fbm::new(WORLD_SEED);
    Contender::new(name, columns * rows, move |corner, sums: &mut [i32]| {
        for _ in 0..times {
            fbm.grid_on(kernel, &black_box(grid(corner, columns, rows)), sums);
            black_box(&mut *sums);
        }
    })
}

/// A whole chunk: noise, base field, coasts and both pyramids.
pub fn chunk<'a>(name: impl Into<String>, kernel: Kernel) -> Contender<'a> {
    let land = Land::new(WORLD_SEED);
    Contender::new(name, VERTEX_COUNT, move |corner, heights: &mut [i32]| {
        land.heights_on(kernel, &grid(corner, VERTICES, VERTICES), heights);
        let heights: &[i32; VERTEX_COUNT] = (&*heights).try_into().expect("the length is fixed");
        black_box((Pyramid::of_maxima_on(kernel, heights), Pyramid::of_minima_on(kernel, heights)));
    })
}

/// One pyramid of a finished chunk.
pub fn pyramid<'a>(name: impl Into<String>, kernel: Kernel) -> Result<Contender<'a>> {
    let mut chunks = Finished::new()?;
    Ok(Contender::new(name, 4, move |_, peaks: &mut [i32]| {
        let pyramid = black_box(Pyramid::of_maxima_on(kernel, chunks.next()));
        peaks.copy_from_slice(pyramid.level(PYRAMID_LEVELS - 2));
    }))
}

/// A copy of the same heights.
pub fn copy<'a>(name: impl Into<String>) -> Result<Contender<'a>> {
    let mut chunks = Finished::new()?;
    Ok(Contender::new(name, VERTEX_COUNT, move |_, out: &mut [i32]| out.copy_from_slice(chunks.next())))
}

/// The heights of one chunk into a buffer, with everything that a server computes from them; for
/// several threads at once.
pub fn produce(kernel: Kernel, corner: Corner, heights: &mut [i32; VERTEX_COUNT]) {
    let land = Land::new(WORLD_SEED);
    land.heights_on(kernel, &grid(corner, VERTICES, VERTICES), heights);
    black_box((Pyramid::of_maxima_on(kernel, heights), Pyramid::of_minima_on(kernel, heights)));
}

/// Rejects corners over the sea, where the land is flat and costs almost nothing.
///
/// # Errors
/// A corner has a vertex on the open sea floor.
pub fn check_that_corners_are_on_land() -> Result<()> {
    for number in 0..Corner::COUNT {
        let corner = Corner::of(number);
        let mut heights = vec![0; VERTEX_COUNT];
        Land::new(WORLD_SEED).heights(&grid(corner, VERTICES, VERTICES), &mut heights);
        ensure!(!heights.contains(&SEA_FLOOR), "{corner:?} is at sea; choose another world for the timing");
    }
    Ok(())
}

fn grid(corner: Corner, columns: usize, rows: usize) -> Grid {
    let units = |samples: i32| samples << SPACING_BITS;
    Grid::new(units(corner.x), units(corner.z), 0, columns, rows).expect("corners lie around the origin")
}

/// Finished chunks, used in turn. Only two, because a server builds the pyramids of a chunk while
/// it is in a near cache.
struct Finished {
    chunks: Vec<Box<[i32; VERTEX_COUNT]>>,
    next: usize,
}

impl Finished {
    fn new() -> Result<Self> {
        let chunks = (0..2).map(|number| {
            let mut heights = vec![0; VERTEX_COUNT];
            Land::new(WORLD_SEED).heights(&grid(Corner::of(number), VERTICES, VERTICES), &mut heights);
            heights.into_boxed_slice().try_into().ok().context("a chunk of another size")
        });
        Ok(Self { chunks: chunks.collect::<Result<_>>()?, next: 0 })
    }

    fn next(&mut self) -> &[i32; VERTEX_COUNT] {
        self.next = (self.next + 1) % self.chunks.len();
        black_box(&self.chunks[self.next])
    }
}
