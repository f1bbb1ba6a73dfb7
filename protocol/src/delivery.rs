//! How chunks come: what a client trades bandwidth for.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The client's choice for a whole session, made in its Hello.
///
/// It says which frames the client can use besides exact ones; an exact frame may come in every delivery, so that a server
/// can send what no seed makes. The order of the variants is their index on the wire. New ones go to the end (next: heights
/// quantised to a tolerance, with that tolerance as a field); a server that does not know one refuses the Hello as malformed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Delivery {
    /// All heights, compressed without loss: about 5 KiB a chunk.
    #[default]
    Exact,
    /// Key, error and a digest, 36 bytes a chunk: the client generates the chunk from the world's seed and verifies the
    /// digest. For clients whose generator makes the server's world.
    SeedOnly,
}

impl Delivery {
    /// The word for it in options, records and metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::SeedOnly => "seed",
        }
    }
}

impl fmt::Display for Delivery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Delivery {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        [Self::Exact, Self::SeedOnly]
            .into_iter()
            .find(|delivery| delivery.name() == text)
            .ok_or("expected exact or seed")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deliveries_are_read_by_the_word_that_they_print() {
        for delivery in [Delivery::Exact, Delivery::SeedOnly] {
            assert_eq!(delivery.to_string().parse(), Ok(delivery));
        }
        for stranger in ["", "Exact", "seed-only", "quantised"] {
            assert!(stranger.parse::<Delivery>().is_err(), "{stranger}");
        }
    }
}
