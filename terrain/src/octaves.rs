//! The number of octaves of the fractal sum.

use crate::constants::{
    FIRST_AMPLITUDE_BITS, FIRST_CELL_BITS, OCTAVE_SHIFT, OCTAVES, RIDGE_M, SPACING_BITS, UNIT_BITS,
};
use std::fmt;
use std::ops::Range;

/// The number of octaves kept, coarsest first: 0 (bare domes) to [`OCTAVES`] (the land).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Octaves(u8);

impl Octaves {
    /// All of them: the land itself.
    pub const ALL: Self = Self(OCTAVES as u8);

    /// A number of octaves; refused above [`OCTAVES`]. Zero is allowed and leaves the bare domes.
    pub fn new(count: usize) -> Result<Self, TooManyOctaves> {
        if count <= OCTAVES { Ok(Self(count as u8)) } else { Err(TooManyOctaves(count)) }
    }

    /// What a grid of a level can carry: octaves whose cell is at least the vertex spacing.
    ///
    /// A finer octave would put every vertex into a cell of its own and so add white noise, which
    /// shimmers, costs two lattice columns per vertex and moves the drawn triangles away from the
    /// land (docs/heightfield.md, section 6). Levels 0 to 2 keep all octaves.
    #[must_use]
    pub const fn at_level(level: u8) -> Self {
        let carried = (FIRST_CELL_BITS - SPACING_BITS + 1).saturating_sub(level as u32);
        if carried < OCTAVES as u32 { Self(carried as u8) } else { Self::ALL }
    }

    /// How many.
    #[must_use]
    pub const fn count(self) -> usize {
        self.0 as usize
    }

    /// The octaves kept, with the shift of each one's lattice.
    pub(crate) fn shifts(self) -> impl Iterator<Item = (usize, (i32, i32))> {
        OCTAVE_SHIFT.into_iter().enumerate().take(self.count())
    }

    /// Upper bound, in units, of the height that the octaves beyond these can add or take anywhere.
    ///
    /// Proof. One octave of amplitude `a` stays below `0.7072 a`: its gradients are unit vectors,
    /// so it is at most the mean of the four distances to the corners, weighted by the steps, which
    /// is largest (`√½`) in the middle of a cell. The falloff scales hills and ridges by at most 1.
    /// A ridge is `64 m (1 - |folds| / 64 m)²`, so it changes by at most 64 m and twice the change
    /// of the folds (octaves 1 and 2). The beach multiplies a difference by at most 1.64, its
    /// greatest slope (at `r² = 0.6`). One unit covers the two roundings.
    #[must_use]
    pub fn dropped_bound(self) -> u32 {
        let amplitude_m = |octave: usize| (1u32 << FIRST_AMPLITUDE_BITS) >> octave;
        let dropped =
            |octaves: Range<usize>| octaves.skip_while(|o| *o < self.count()).map(amplitude_m).sum::<u32>();
        let hills_mm = dropped(0..OCTAVES) * 7072 / 10;
        let ridge_mm = (dropped(1..3) * 14_144 / 10).min(RIDGE_M as u32 * 1000);
        let bound_um = u64::from(hills_mm + ridge_mm + 1) * 1640;
        if self == Self::ALL { 0 } else { (bound_um << UNIT_BITS).div_ceil(1_000_000) as u32 + 1 }
    }
}

/// More octaves than the land has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyOctaves(
    /// The refused number.
    pub usize,
);

impl fmt::Display for TooManyOctaves {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} octaves requested: the land has at most {OCTAVES}", self.0)
    }
}

impl std::error::Error for TooManyOctaves {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;
    use crate::land::Land;
    use crate::position::Position;

    #[test]
    fn levels_keep_octaves_whose_cell_is_at_least_their_spacing() {
        let kept: Vec<_> = (0..=16).map(|level| Octaves::at_level(level).count()).collect();
        assert_eq!(kept, [8, 8, 8, 7, 6, 5, 4, 3, 2, 1, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn more_octaves_than_the_land_has_are_refused_and_none_is_allowed() {
        assert_eq!(Octaves::new(9), Err(TooManyOctaves(9)));
        assert_eq!(Octaves::new(8), Ok(Octaves::ALL));
        assert_eq!(Octaves::new(0).map(Octaves::count), Ok(0));
    }

    /// Brute force against the proof, and the proof must not be empty: the worst found has to come
    /// near it.
    #[test]
    fn dropped_octaves_stay_below_the_proved_bound() {
        for kept in (0..=OCTAVES).map(|count| Octaves::new(count).unwrap()) {
            let worst = (0..40_000u32)
                .map(|n| {
                    let (land, h) = (Land::new(u64::from(n % 5)), mix(n));
                    let position = Position::new(mix(h) as i32 >> 10, mix(!h) as i32 >> 10).unwrap();
                    land.height_at(position).abs_diff(land.height_keeping(position, kept))
                })
                .max()
                .unwrap();
            let bound = kept.dropped_bound();
            assert!(worst <= bound, "{kept:?}: {worst} beyond {bound}");
            assert!(worst * 5 >= bound, "{kept:?}: {worst} says little about {bound}");
        }
    }

    /// The largest value of one octave, on which the proof rests: distances to the corners under
    /// the step weights.
    #[test]
    fn an_octave_is_largest_in_the_middle_of_a_cell() {
        let step = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let value = |x: f64, z: f64| {
            let corner = |dx: f64, dz: f64| {
                let weight = |t: f64, d: f64| if d == 0.0 { 1.0 - step(t) } else { step(t) };
                weight(x, dx) * weight(z, dz) * (x - dx).hypot(z - dz)
            };
            corner(0.0, 0.0) + corner(1.0, 0.0) + corner(0.0, 1.0) + corner(1.0, 1.0)
        };
        for i in 0..=500 {
            for j in 0..=500 {
                assert!(value(f64::from(i) / 500.0, f64::from(j) / 500.0) <= 0.5f64.sqrt() + 1e-12);
            }
        }
        assert!((value(0.5, 0.5) - 0.5f64.sqrt()).abs() < 1e-12);
    }
}
