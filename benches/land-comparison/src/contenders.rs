//! What is timed: heights and whole chunks of level 0 by both versions of the land and by floats.

use crate::floats::{FloatLand, Hash};
use crate::rounds::{Contender, Corner};
use anyhow::{Context, Result, ensure};
use std::hint::black_box;
use terrain::constants::{SPACING_BITS, VERTEX_COUNT};
use terrain::{Kernel, Pyramid};

/// The world; its home island is timed.
pub const WORLD_SEED: u64 = 1;

/// Heights of one chunk, units.
pub type Heights = [i32; VERTEX_COUNT];

/// Contenders of one version of the land, by the crate that defines it.
macro_rules! version {
    ($(#[$doc:meta])* $name:ident, $krate:ident) => {
        $(#[$doc])*
        pub mod $name {
            use super::*;
            use $krate::constants::VERTICES;
            use $krate::land::SEA_FLOOR;
            use $krate::{Grid, Kernel, Land, Pyramid};

            /// The kernel that the bars are for.
            ///
            /// # Errors
            /// This CPU has no AVX2.
            pub fn avx2() -> Result<Kernel> {
                Kernel::named("avx2")
                    .context("this CPU has no AVX2, which the bars are for; run this on another machine")
            }

            /// The heights alone.
            pub fn heights<'a>(name: &str) -> Result<Contender<'a>> {
                let (land, kernel) = (Land::new(WORLD_SEED), avx2()?);
                Ok(Contender::new(name, VERTEX_COUNT, move |corner, heights: &mut [i32]| {
                    land.heights_on(kernel, &grid(corner), heights);
                }))
            }

            /// Heights and both pyramids, as often as is said: more than once for a control.
            pub fn whole<'a>(name: &str, times: usize) -> Result<Contender<'a>> {
                let (land, kernel) = (Land::new(WORLD_SEED), avx2()?);
                Ok(Contender::new(name, VERTEX_COUNT, move |corner, heights: &mut [i32]| {
                    for _ in 0..times {
                        land.heights_on(kernel, &black_box(grid(corner)), heights);
                        let heights: &Heights = (&*heights).try_into().expect("a chunk");
                        black_box((
                            Pyramid::of_maxima_on(kernel, heights),
                            Pyramid::of_minima_on(kernel, heights),
                        ));
                    }
                }))
            }

            /// Rejects corners at sea, where the land is flat and costs almost nothing.
            ///
            /// # Errors
            /// A corner has a vertex on the open sea floor.
            pub fn check_that_corners_are_on_land() -> Result<()> {
                let mut heights = Box::new([0; VERTEX_COUNT]);
                for corner in (0..Corner::COUNT).map(Corner::of) {
                    Land::new(WORLD_SEED).heights(&grid(corner), &mut heights[..]);
                    ensure!(
                        !heights.contains(&SEA_FLOOR),
                        "{corner:?} of {} is at sea; choose another world for the timing",
                        stringify!($name)
                    );
                }
                Ok(())
            }

            fn grid(corner: Corner) -> Grid {
                let (x, z) = units(corner);
                Grid::new(x, z, 0, VERTICES, VERTICES).expect("corners lie around the origin")
            }
        }
    };
}

version! {
    /// The land as it is.
    ours, terrain
}

version! {
    /// The land before islands had lobes.
    version_3, terrain_3
}

/// Heights in floats.
pub fn float_heights<'a, H: Hash, const SPLINED: bool>(name: &str) -> Result<Contender<'a>> {
    let land = FloatLand::new(WORLD_SEED)?;
    Ok(Contender::new(name, VERTEX_COUNT, move |corner, heights: &mut [i32]| {
        let heights = heights.try_into().expect("a chunk");
        land.heights::<H, 5, SPLINED>(units(corner), heights);
    }))
}

/// Heights in floats, and both pyramids as for ours.
pub fn float_whole<'a, H: Hash, const SPLINED: bool>(name: &str) -> Result<Contender<'a>> {
    let (land, kernel): (_, Kernel) = (FloatLand::new(WORLD_SEED)?, ours::avx2()?);
    Ok(Contender::new(name, VERTEX_COUNT, move |corner, heights: &mut [i32]| {
        let heights: &mut Heights = heights.try_into().expect("a chunk");
        land.heights::<H, 5, SPLINED>(units(corner), heights);
        black_box((Pyramid::of_maxima_on(kernel, heights), Pyramid::of_minima_on(kernel, heights)));
    }))
}

/// Low corner of a chunk, units.
pub fn units(corner: Corner) -> (i32, i32) {
    (corner.x << SPACING_BITS, corner.z << SPACING_BITS)
}
