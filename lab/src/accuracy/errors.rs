//! Errors of height functions: heights in metres, slopes as the angle between normals in degrees.

use crate::reference_f64::ReferenceF64;
use crate::stats::Figures;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::{Land, Octaves, Position};

/// Curves of height and slope errors, with their columns.
pub const HEIGHTS: [(&str, &str); 2] = [("largest found", "max, m"), ("99th percentile", "p99, m")];
/// See [`HEIGHTS`].
pub const SLOPES: [(&str, &str); 2] =
    [("largest found", "max, degrees"), ("99th percentile", "p99, degrees")];

/// Their columns.
pub const FIGURES: [&str; 4] = ["max, m", "p99, m", "max, degrees", "p99, degrees"];

/// The values of [`FIGURES`].
pub fn figures(height: &Figures, slope: &Figures) -> [f64; 4] {
    [height.max, height.p99, slope.max, slope.p99]
}

/// Distance of the neighbours of a central difference, units: one vertex (2 m) to either side.
pub const REACH: i32 = 1 << SPACING_BITS;

/// A height function: position (units) to metres.
pub trait Height: Fn(i32, i32) -> f64 + Sync {}

impl<F: Fn(i32, i32) -> f64 + Sync> Height for F {}

/// The integers with so many octaves, metres.
pub fn integers(land: Land, octaves: Octaves) -> impl Height {
    move |x, z| {
        let position = Position::new(x, z).expect("samples lie in the world");
        f64::from(land.height_keeping(position, octaves)) / f64::from(UNITS_PER_METRE)
    }
}

/// The reference with all octaves, metres.
pub fn exact(reference: ReferenceF64) -> impl Height {
    move |x, z| reference.height_m(x, z, Octaves::ALL)
}

/// Slope at a vertex by central differences over its neighbours: rise per metre east and south.
pub fn slope(height: &impl Height, (x, z): (i32, i32)) -> (f64, f64) {
    let run_m = f64::from(2 * REACH) / f64::from(UNITS_PER_METRE);
    let east = (height(x + REACH, z) - height(x - REACH, z)) / run_m;
    let south = (height(x, z + REACH) - height(x, z - REACH)) / run_m;
    (east, south)
}

/// Angle between the normals of two slopes, degrees: steepness and aspect together.
pub fn angle_deg((a_east, a_south): (f64, f64), (b_east, b_south): (f64, f64)) -> f64 {
    // |a x b| over a·b: precise for small angles, where the arc cosine is not.
    let cross = [a_south - b_south, a_east * b_south - a_south * b_east, a_east - b_east];
    let sine = cross.iter().map(|part| part * part).sum::<f64>().sqrt();
    sine.atan2(a_east * b_east + a_south * b_south + 1.0).to_degrees()
}

/// Height and slope errors of one height function against another over points.
pub fn compare(got: &impl Height, reference: &impl Height, points: &[(i32, i32)]) -> (Figures, Figures) {
    use rayon::prelude::*;
    let inner = WORLD_HALF - REACH;
    let errors: Vec<(f64, f64)> = points
        .par_iter()
        .filter(|(x, z)| x.abs() <= inner && z.abs() <= inner)
        .map(|point| {
            let height = (got(point.0, point.1) - reference(point.0, point.1)).abs();
            (height, angle_deg(slope(got, *point), slope(reference, *point)))
        })
        .collect();
    let (heights, slopes) = errors.into_iter().unzip();
    (Figures::of(heights), Figures::of(slopes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_between_slopes_are_those_of_their_normals() {
        for (a, b, degrees) in [
            ((0.0, 0.0), (0.0, 0.0), 0.0),
            ((0.0, 0.0), (1.0, 0.0), 45.0),
            ((1.0, 0.0), (-1.0, 0.0), 90.0),
            ((0.0, 1.0), (0.0, 1.0), 0.0),
            ((0.0, 0.0), (0.0, 0.001), 0.001f64.atan().to_degrees()),
        ] {
            assert!((angle_deg(a, b) - degrees).abs() < 1e-9, "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_tilted_plane_has_its_slope() {
        let plane = |x: i32, z: i32| f64::from(x) / 256.0 * 0.5 - f64::from(z) / 256.0;
        assert_eq!(slope(&plane, (5120, -1024)), (0.5, -1.0));
    }
}
