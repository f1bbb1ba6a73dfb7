//! Positions: i32 pairs in units of 1/256 m, inside the world.

use crate::constants::WORLD_HALF;
use std::fmt;

/// A point of the world plane. `x` is east, `z` is south, both in units of 2^-8 m and within
/// ±[`WORLD_HALF`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Position {
    x: i32,
    z: i32,
}

impl Position {
    /// A position from units; rejected outside the world, never wrapped or clamped.
    pub fn new(x: i32, z: i32) -> Result<Self, OutsideWorld> {
        let inside = |v: i32| (-WORLD_HALF..=WORLD_HALF).contains(&v);
        if inside(x) && inside(z) { Ok(Self { x, z }) } else { Err(OutsideWorld { x, z }) }
    }

    /// Units east of the origin.
    #[must_use]
    pub const fn x(self) -> i32 {
        self.x
    }

    /// Units south of the origin.
    #[must_use]
    pub const fn z(self) -> i32 {
        self.z
    }
}

/// A coordinate beyond ±[`WORLD_HALF`] units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutsideWorld {
    /// The rejected x, units.
    pub x: i32,
    /// The rejected z, units.
    pub z: i32,
}

impl fmt::Display for OutsideWorld {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x, z } = self;
        write!(f, "position ({x}, {z}) is outside the world: each axis must lie within ±{WORLD_HALF} units")
    }
}

impl std::error::Error for OutsideWorld {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_belongs_to_the_world_and_one_unit_beyond_does_not() {
        for edge in [-WORLD_HALF, WORLD_HALF] {
            assert!(Position::new(edge, 0).is_ok() && Position::new(0, edge).is_ok());
            let beyond = edge + edge.signum();
            assert_eq!(Position::new(beyond, 7), Err(OutsideWorld { x: beyond, z: 7 }));
            assert_eq!(Position::new(7, beyond), Err(OutsideWorld { x: 7, z: beyond }));
        }
        assert!(Position::new(i32::MIN, i32::MAX).is_err());
        let text = OutsideWorld { x: 7, z: -(1 << 30) - 1 }.to_string();
        assert!(text.contains("(7, -1073741825)") && text.contains("±1073741824"), "{text}");
    }
}
