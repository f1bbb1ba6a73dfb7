//! Whether the floats compute the same land: otherwise their time would mean nothing.
//!
//! Wide octaves at every vertex have no counterpart among chunks of level 0, whose wide octaves are
//! splined. They are compared with the land of six octaves, which evaluates them at every point.

use crate::contenders::{Heights, WORLD_SEED, units};
use crate::floats::{FloatLand, Hash, Ours, Short};
use crate::rounds::Corner;
use anyhow::{Result, ensure};
use terrain::constants::{UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use terrain::{Grid, Land, Octaves};

/// Largest difference of two heights of the same land, m. A cliff multiplies differences by five.
pub const TOLERANCE_M: f64 = 0.031_25;

/// Largest differences of any vertex, m.
pub struct Agreement {
    /// Splined, all octaves.
    pub splined: f64,
    /// Wide octaves and two fine ones at every vertex.
    pub direct: f64,
    /// Splined, without the last fine octave.
    pub splined_control: f64,
    /// At every vertex, without the last of the two.
    pub direct_control: f64,
}

/// Compares all chunks that are timed.
///
/// # Errors
/// This CPU lacks what floats need, or the short hash makes no even gradients.
pub fn compare() -> Result<Agreement> {
    let (land, floats) = (Land::new(WORLD_SEED), FloatLand::new(WORLD_SEED)?);
    let six = Octaves::new(6)?;
    let mut found = Agreement { splined: 0.0, direct: 0.0, splined_control: 0.0, direct_control: 0.0 };
    let (mut roughness, mut short_roughness) = (0.0, 0.0);
    for corner in (0..Corner::COUNT).map(|number| units(Corner::of(number))) {
        let ours = land_chunk(&land, corner, Octaves::ALL)?;
        let splined = chunk::<Ours, 5, true>(&floats, corner);
        found.splined = found.splined.max(farthest(&ours, &splined));
        let without = chunk::<Ours, 4, true>(&floats, corner);
        found.splined_control = found.splined_control.max(farthest(&ours, &without));
        let ours = land_chunk(&land, corner, six)?;
        found.direct = found.direct.max(farthest(&ours, &chunk::<Ours, 2, false>(&floats, corner)));
        let without = chunk::<Ours, 1, false>(&floats, corner);
        found.direct_control = found.direct_control.max(farthest(&ours, &without));
        roughness += bends(&splined);
        short_roughness += bends(&chunk::<Short, 5, true>(&floats, corner));
    }
    let ratio = short_roughness / roughness;
    ensure!((0.8..1.25).contains(&ratio), "the short hash makes another land: {ratio:.3} of its roughness");
    Ok(found)
}

fn chunk<H: Hash, const FINE: usize, const SPLINED: bool>(
    floats: &FloatLand,
    corner: (i32, i32),
) -> Box<Heights> {
    let mut heights = Box::new([0; VERTEX_COUNT]);
    floats.heights::<H, FINE, SPLINED>(corner, &mut heights);
    heights
}

/// The land's heights with some octaves: with six, wide octaves are evaluated at every vertex.
fn land_chunk(land: &Land, (x, z): (i32, i32), octaves: Octaves) -> Result<Box<Heights>> {
    let mut heights = Box::new([0; VERTEX_COUNT]);
    land.heights(&Grid::new(x, z, 0, VERTICES, VERTICES)?.keeping(octaves), &mut heights[..]);
    Ok(heights)
}

/// Largest difference, m.
fn farthest(one: &Heights, other: &Heights) -> f64 {
    let largest = one.iter().zip(other).map(|(one, other)| one.abs_diff(*other)).max().unwrap_or(0);
    f64::from(largest) / f64::from(UNITS_PER_METRE)
}

/// Sum of all second differences along x.
fn bends(heights: &Heights) -> f64 {
    let bend = |h: &[i32]| f64::from((h[0] - 2 * h[1] + h[2]).abs());
    heights.chunks_exact(VERTICES).flat_map(|row| row.windows(3).map(bend)).sum()
}
