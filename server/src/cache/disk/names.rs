//! File names: `SHARD/WORLD.FORMAT.DELIVERY.LEVEL.X.Z`, with `.EDITION` behind it unless it is the
//! base.
//!
//! The name contains everything that decides the content, so a frame of another world or of an
//! older format is never opened; it ages and is evicted. All worlds share the shards, so that one
//! budget applies to the whole folder.

use crate::chunk_id::ChunkId;
use protocol::Delivery;
use protocol::chunk_codec::VERSION;
use std::path::{Path, PathBuf};
use terrain::WorldDigest;

/// Number of folders. The largest budget gives some hundred thousand files per folder, the smallest
/// some thirty.
pub const SHARDS: usize = 256;

/// File names of one world's frames.
#[derive(Debug)]
pub struct FrameNames {
    /// The first half of the digest. Names need not resist an attack: a file is verified with the
    /// whole digest.
    world: String,
}

impl FrameNames {
    /// The names of a world's frames.
    pub fn new(world: &WorldDigest) -> Self {
        Self { world: world.0[..16].iter().map(|byte| format!("{byte:02x}")).collect() }
    }

    /// The path of a frame, relative to the folder.
    pub fn path(&self, id: ChunkId, delivery: Delivery) -> PathBuf {
        let tolerance = match delivery {
            Delivery::Quantised(tolerance) => tolerance.units().to_string(),
            Delivery::Exact | Delivery::SeedOnly | Delivery::Refined => String::new(),
        };
        let edition = if id.edition.is_base() { String::new() } else { format!(".{}", id.edition) };
        let (world, delivery, key) = (&self.world, delivery.name(), id.key);
        let (level, x, z) = (key.level(), key.x(), key.z());
        let name = format!("{world}.{VERSION}.{delivery}{tolerance}.{level}.{x}.{z}{edition}");
        let shard = shard_name(usize::from(blake3::hash(name.as_bytes()).as_bytes()[0]));
        Path::new(&shard).join(name)
    }
}

/// The folder of a shard.
pub fn shard_name(shard: usize) -> String {
    format!("{shard:02x}")
}

/// The shard of a file whose path came from [`FrameNames::path`]; 0 for any other.
pub fn shard_of(path: &Path) -> usize {
    let folder = path.parent().and_then(Path::to_str);
    folder.and_then(|name| usize::from_str_radix(name, 16).ok()).filter(|shard| *shard < SHARDS).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk_id::Edition;
    use protocol::delivery::Tolerance;
    use std::collections::BTreeSet;
    use terrain::ChunkKey;

    #[test]
    fn names_are_unique_and_spread_evenly_over_the_shards() {
        let deliveries = || {
            let quantised = Tolerance::all().map(Delivery::Quantised);
            [Delivery::Exact, Delivery::SeedOnly].into_iter().chain(quantised)
        };
        let mut paths = BTreeSet::new();
        let mut counts = [0; SHARDS];
        for world in [WorldDigest([1; 32]), WorldDigest([2; 32])] {
            let names = FrameNames::new(&world);
            for (level, x, z) in (0..16).flat_map(|i| (0..16).map(move |j| (2 + (i & 1), i - 8, j - 8))) {
                let key = ChunkKey::new(level as u8, x, z).unwrap();
                for delivery in deliveries() {
                    let path = names.path(ChunkId::base(key), delivery);
                    counts[shard_of(&path)] += 1;
                    assert!(paths.insert(path));
                }
                for hash in [[0; 16], [1; 16]] {
                    let id = ChunkId { key, edition: Edition::changed(hash) };
                    assert!(paths.insert(names.path(id, Delivery::Exact)));
                }
            }
        }
        // 20 per shard; 50 would be more than six standard deviations away.
        assert!(counts.iter().all(|count| (1..50).contains(count)), "{counts:?}");
        // A path that is of no shard belongs to the first one.
        for (path, shard) in [("ff/a", 255), ("100/a", 0), ("fg/a", 0), ("a", 0), ("", 0)] {
            assert_eq!(shard_of(Path::new(path)), shard, "{path}");
        }
    }
}
