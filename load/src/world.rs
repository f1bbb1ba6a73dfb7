//! The world that the servers of a run announce: checked by every session, computed once.

use crate::verify::Mismatch;
use std::sync::OnceLock;
use terrain::constants::GENERATOR_VERSION;
use terrain::{Land, Start, WorldDigest};

/// What the clients of one run share. The digest of a world takes some 30 ms, its start longer: for
/// each of 500 sessions that would be most of the load test's time.
#[derive(Debug, Default)]
pub struct FirstWorld {
    /// The world that was announced first, with its digest as computed here.
    digest: OnceLock<(Land, WorldDigest)>,
    start: OnceLock<Start>,
}

impl FirstWorld {
    /// The land of a seed, if the announced version and digest are right.
    ///
    /// # Errors
    /// [`Mismatch::Generator`] or [`Mismatch::World`].
    pub fn check(&self, seed: u64, version: u32, announced: WorldDigest) -> Result<Land, Mismatch> {
        if version != GENERATOR_VERSION {
            return Err(Mismatch::Generator { theirs: version });
        }
        let computed = || {
            let land = Land::new(seed);
            (land, land.digest())
        };
        let (mut land, mut ours) = *self.digest.get_or_init(computed);
        if land.world_seed() != seed {
            (land, ours) = computed();
        }
        if announced != ours {
            return Err(Mismatch::World { announced, seed, ours });
        }
        Ok(land)
    }

    /// The start of the world that was announced first.
    pub fn start(&self, land: &Land) -> Start {
        *self.start.get_or_init(|| land.start())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_digest_of_another_seed_is_an_error_with_both_digests() {
        let digests = [1, 2].map(|seed| Land::new(seed).digest());
        // The same whichever world was announced first.
        for first in [1, 2] {
            let world = FirstWorld::default();
            let _ = world.check(first, GENERATOR_VERSION, digests[0]);
            for (seed, digest) in [(1, digests[0]), (2, digests[1])] {
                let land = world.check(seed, GENERATOR_VERSION, digest);
                assert_eq!(land.map(|land| land.world_seed()), Ok(seed));
            }
            let text = world.check(2, GENERATOR_VERSION, digests[0]).unwrap_err().to_string();
            let has = |part: &str| text.contains(part);
            assert!(has(&digests[0].to_string()) && has(&digests[1].to_string()) && has("seed 2"), "{text}");
            let newer = world.check(1, 99, digests[0]).unwrap_err();
            assert_eq!(newer, Mismatch::Generator { theirs: 99 });
        }
    }
}
