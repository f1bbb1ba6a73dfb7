//! Deliveries: the forms in which a client can receive chunks.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use terrain::constants::UNITS_PER_METRE;

/// How far a quantised height may be from the exact one: a power of two from 1 unit (2^-8 m) to 128
/// units (0.5 m).
///
/// Few values, so that a chunk has few possible frames. Heights are rounded to multiples of twice
/// the tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u16", into = "u16")]
pub struct Tolerance(u16);

impl Tolerance {
    /// The finest: 1 unit.
    pub const FINEST: Self = Self(1);
    /// The coarsest: 128 units.
    pub const COARSEST: Self = Self(128);

    /// A tolerance in units; none unless it is a power of two from 1 to 128.
    #[must_use]
    pub fn new(units: u16) -> Option<Self> {
        (units.is_power_of_two() && units <= Self::COARSEST.0).then_some(Self(units))
    }

    /// The largest tolerance that does not exceed a distance in metres; none below 2^-8 m.
    #[must_use]
    pub fn within_m(metres: f64) -> Option<Self> {
        Self::all().rev().find(|tolerance| tolerance.metres() <= metres)
    }

    /// Every tolerance, the finest first.
    pub fn all() -> impl DoubleEndedIterator<Item = Self> {
        (0..8).map(|bits| Self(1 << bits))
    }

    /// Units, 1 to 128.
    #[must_use]
    pub const fn units(self) -> u16 {
        self.0
    }

    /// Metres.
    #[must_use]
    pub fn metres(self) -> f64 {
        f64::from(self.0) / f64::from(UNITS_PER_METRE)
    }

    /// Bits that a height loses.
    pub(crate) const fn shift(self) -> u32 {
        self.0.trailing_zeros() + 1
    }
}

impl TryFrom<u16> for Tolerance {
    type Error = &'static str;

    fn try_from(units: u16) -> Result<Self, Self::Error> {
        Self::new(units).ok_or("a tolerance is a power of two from 1 to 128 units")
    }
}

impl From<Tolerance> for u16 {
    fn from(tolerance: Tolerance) -> Self {
        tolerance.0
    }
}

/// The client's choice for a whole session, made in its Hello.
///
/// It states which frames the client accepts in addition to exact ones. Every delivery accepts
/// exact frames, so that a server can send chunks that no seed generates. The order of the variants
/// is their index on the wire. New ones are appended; a server that does not know one rejects the
/// Hello as malformed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Delivery {
    /// All heights, compressed without loss: about 2.6 KB a chunk of level 0 with land, up to 5 KB
    /// a coarser one.
    #[default]
    Exact,
    /// Key, error and a digest, 36 bytes a chunk: the client generates the chunk from the world's
    /// seed and verifies the digest. For clients with the server's generator.
    SeedOnly,
    /// All heights, none farther from the exact one than the tolerance: half to a fifth of the
    /// bytes.
    Quantised(Tolerance),
    /// All heights, exact. A chunk whose parent is in the reference window
    /// ([`crate::reference_window`]) carries only the heights that the parent lacks: a sixth to a
    /// quarter fewer bytes over a whole view.
    Refined,
}

impl Delivery {
    /// Its name in records and metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::SeedOnly => "seed",
            Self::Quantised(_) => "quantised",
            Self::Refined => "refined",
        }
    }
}

/// The syntax of options: `exact`, `refined`, `seed`, or `quantised:METRES`.
impl fmt::Display for Delivery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        match self {
            Self::Quantised(tolerance) => write!(f, ":{}", tolerance.metres()),
            Self::Exact | Self::SeedOnly | Self::Refined => Ok(()),
        }
    }
}

impl FromStr for Delivery {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let expected =
            "expected exact, refined, seed or quantised:METRES, METRES at least 0.00390625 (1/256)";
        if let Some(metres) = text.strip_prefix("quantised:") {
            let tolerance = metres.parse().ok().filter(|metres: &f64| metres.is_finite());
            return tolerance.and_then(Tolerance::within_m).map(Self::Quantised).ok_or(expected);
        }
        [Self::Exact, Self::Refined, Self::SeedOnly]
            .into_iter()
            .find(|delivery| delivery.name() == text)
            .ok_or(expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deliveries_are_read_by_the_text_that_they_print() {
        let quantised = Tolerance::all().map(Delivery::Quantised);
        for delivery in [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly].into_iter().chain(quantised)
        {
            assert_eq!(delivery.to_string().parse(), Ok(delivery));
        }
        for unknown in [
            "",
            "Exact",
            "seed-only",
            "quantised",
            "quantised:",
            "quantised:0",
            "quantised:-1",
            "quantised:NaN",
            "quantised:inf",
            "quantised:0.003",
            "quantised:1 m",
        ] {
            assert!(unknown.parse::<Delivery>().is_err(), "{unknown}");
        }
    }

    #[test]
    fn a_tolerance_is_the_largest_step_within_the_distance() {
        let units = |text: &str| match text.parse() {
            Ok(Delivery::Quantised(tolerance)) => tolerance.units(),
            other => panic!("{text}: {other:?}"),
        };
        assert_eq!(units("quantised:0.00390625"), 1);
        assert_eq!(units("quantised:0.0624"), 8);
        assert_eq!(units("quantised:0.0625"), 16);
        assert_eq!(units("quantised:7"), 128);
        assert!(
            (0..=u16::MAX).filter(|units| Tolerance::new(*units).is_some()).eq([1, 2, 4, 8, 16, 32, 64, 128])
        );
    }
}
