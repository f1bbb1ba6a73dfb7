//! The parameters of one world for a generator in another language.

use crate::base::LATTICES;
use crate::constants::FINE_OCTAVES;
use crate::land::Land;

/// Everything derived from a 64-bit world seed: a GPU has no 64-bit integers to derive it itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// Seed of each fine octave, widest first.
    pub fine_seeds: [u32; FINE_OCTAVES],
    /// Seeds of the noises of the base field: octaves, warp, exposure.
    pub lattice_seeds: [u32; LATTICES],
    /// Seed of the archipelago.
    pub archipelago_seed: u32,
}

impl Land {
    /// The parameters of this world.
    #[must_use]
    pub fn parameters(&self) -> Parameters {
        Parameters {
            fine_seeds: self.fbm().seeds,
            lattice_seeds: self.base().seeds(),
            archipelago_seed: self.archipelago().seed(),
        }
    }
}
