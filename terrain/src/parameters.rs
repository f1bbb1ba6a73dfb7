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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::stream_seed;

    /// The streams of docs/heightfield.md: fine octaves from 0, noises of the base field from 16.
    #[test]
    fn the_seeds_of_a_world_are_those_of_its_streams() {
        let parameters = Land::new(5).parameters();
        assert_eq!(parameters.fine_seeds, [0, 1, 2, 3, 4].map(|stream| stream_seed(5, stream)));
        let base = [16, 17, 18, 19, 20, 21, 22, 23, 24];
        assert_eq!(parameters.lattice_seeds, base.map(|stream| stream_seed(5, stream)));
        assert_eq!(parameters.archipelago_seed, 0x0dcd_47a5);
    }
}
