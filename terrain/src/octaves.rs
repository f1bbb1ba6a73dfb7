//! The number of octaves of the land.

use crate::constants::{BASE_CELL_BITS, BASE_OCTAVES, FIRST_CELL_BITS, OCTAVE_SHIFT, OCTAVES, SPACING_BITS};
use crate::spline;
use std::fmt;

/// The number of octaves kept, widest first: 0 (bare islands) to [`OCTAVES`] (the land).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Octaves(u8);

impl Octaves {
    /// All of them: the land itself.
    pub const ALL: Self = Self(OCTAVES as u8);

    /// A number of octaves; refused above [`OCTAVES`]. Zero is allowed and leaves the bare islands.
    pub fn new(count: usize) -> Result<Self, TooManyOctaves> {
        if count <= OCTAVES { Ok(Self(count as u8)) } else { Err(TooManyOctaves(count)) }
    }

    /// Octaves of the grid of a level: those whose cell is at least the vertex spacing.
    ///
    /// A finer octave would put every vertex into a cell of its own and so add white noise, which
    /// shimmers, costs two lattice columns per vertex and moves the drawn triangles away from the
    /// land (docs/heightfield.md, section 9). Levels 0 to 2 keep all octaves.
    #[must_use]
    pub const fn at_level(level: u8) -> Self {
        let spacing = 1u64 << (SPACING_BITS + level as u32);
        let (mut carried, mut octave) = (0, 0);
        while octave < OCTAVES as u32 {
            let carries = if octave < BASE_OCTAVES as u32 {
                // A turned cell is a fifth of its bits.
                1 << (BASE_CELL_BITS - octave) >= 5 * spacing
            } else {
                1 << (FIRST_CELL_BITS + BASE_OCTAVES as u32 - octave) >= spacing
            };
            carried += carries as u8;
            octave += 1;
        }
        Self(carried)
    }

    /// How many.
    #[must_use]
    pub const fn count(self) -> usize {
        self.0 as usize
    }

    /// How many of the base field.
    #[must_use]
    pub const fn base(self) -> usize {
        if self.count() < BASE_OCTAVES { self.count() } else { BASE_OCTAVES }
    }

    /// How many fine ones.
    #[must_use]
    pub const fn fine(self) -> usize {
        self.count() - self.base()
    }

    /// Whether the base field is a spline of its nodes, or evaluated at the vertex itself: a grid
    /// whose spacing exceeds a cell of the base lattice would share no node.
    #[must_use]
    pub const fn splined(self) -> bool {
        self.fine() + spline::CELL_BITS as usize > FIRST_CELL_BITS as usize
    }

    /// The fine octaves kept, with the shift of each one's lattice.
    pub(crate) fn shifts(self) -> impl Iterator<Item = (usize, (i32, i32))> {
        OCTAVE_SHIFT.into_iter().enumerate().take(self.fine())
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

    #[test]
    fn levels_keep_octaves_whose_cell_is_at_least_their_spacing() {
        let kept: Vec<_> = (0..=16).map(|level| Octaves::at_level(level).count()).collect();
        assert_eq!(kept, [9, 9, 9, 8, 7, 6, 5, 3, 2, 1, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn grids_of_at_most_a_base_cell_are_splined() {
        let splined: Vec<_> = (0..=16).map(|level| Octaves::at_level(level).splined()).collect();
        assert_eq!(splined, (0..=16).map(|level| level <= 4).collect::<Vec<_>>());
    }

    #[test]
    fn more_octaves_than_the_land_has_are_refused_and_none_is_allowed() {
        assert_eq!(Octaves::new(10), Err(TooManyOctaves(10)));
        assert_eq!(TooManyOctaves(10).to_string(), "10 octaves requested: the land has at most 9");
        assert_eq!(Octaves::new(9), Ok(Octaves::ALL));
        assert_eq!(Octaves::new(0).map(Octaves::count), Ok(0));
    }
}
