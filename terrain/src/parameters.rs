//! The parameters of one world for a generator in another language.

use crate::constants::OCTAVES;
use crate::land::Land;

/// Everything derived from a 64-bit world seed: a GPU has no 64-bit integers to derive it itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// Seed of each octave, coarsest first.
    pub octave_seeds: [u32; OCTAVES],
    /// Seed of the archipelago.
    pub archipelago_seed: u32,
}

impl Land {
    /// The parameters of this world.
    #[must_use]
    pub const fn parameters(&self) -> Parameters {
        Parameters { octave_seeds: self.fbm().seeds, archipelago_seed: self.archipelago().seed() }
    }
}
