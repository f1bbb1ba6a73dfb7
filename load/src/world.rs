//! The world that the servers of a run announce: checked by every session, computed once, the same
//! from the first session to the last.

use crate::verify::Mismatch;
use std::sync::OnceLock;
use terrain::constants::GENERATOR_VERSION;
use terrain::{Land, Start, WorldDigest};

/// The state that the clients of one run share. The digest of a world takes some 30 ms, its start
/// longer: for each of 500 sessions that would be most of the load test's time.
#[derive(Debug, Default)]
pub struct FirstWorld {
    /// The world that was announced first, with its digest as computed here.
    digest: OnceLock<(Land, WorldDigest)>,
    start: OnceLock<Start>,
    /// The first digest that was announced and right.
    accepted: OnceLock<WorldDigest>,
}

impl FirstWorld {
    /// The land of a seed, if the announced version and digest are right and those of the run.
    ///
    /// # Errors
    /// [`Mismatch::Generator`], [`Mismatch::World`] or [`Mismatch::OtherWorld`].
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
        let first = *self.accepted.get_or_init(|| announced);
        if announced != first {
            return Err(Mismatch::OtherWorld { first, now: announced });
        }
        Ok(land)
    }

    /// Whether a session of this run was admitted to a world.
    #[must_use]
    pub fn is_known(&self) -> bool {
        self.accepted.get().is_some()
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
        // The same whichever seed was announced first.
        for first in [1, 2] {
            let world = FirstWorld::default();
            let is_right = world.check(first, GENERATOR_VERSION, digests[0]).is_ok();
            assert_eq!((is_right, world.is_known()), (first == 1, first == 1));
            let land = world.check(1, GENERATOR_VERSION, digests[0]);
            assert_eq!(land.map(|land| land.world_seed()), Ok(1));
            let text = world.check(2, GENERATOR_VERSION, digests[0]).unwrap_err().to_string();
            let has = |part: &str| text.contains(part);
            assert!(has(&digests[0].to_string()) && has(&digests[1].to_string()) && has("seed 2"), "{text}");
            let newer = world.check(1, 99, digests[0]).unwrap_err();
            assert_eq!(newer, Mismatch::Generator { theirs: 99 });
        }
    }

    #[test]
    fn another_world_after_the_first_is_an_error_with_both_digests() {
        let [first, now] = [1, 2].map(|seed| Land::new(seed).digest());
        let world = FirstWorld::default();
        for _ in 0..2 {
            assert!(world.check(1, GENERATOR_VERSION, first).is_ok());
            assert_eq!(
                world.check(2, GENERATOR_VERSION, now).unwrap_err(),
                Mismatch::OtherWorld { first, now }
            );
        }
        assert!(FirstWorld::default().check(2, GENERATOR_VERSION, now).is_ok(), "the control");
    }
}
