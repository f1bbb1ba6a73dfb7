//! The chunks that a benchmark requests: land, because chunks of open sea cost almost nothing.

use terrain::{ChunkKey, Land};

/// The seed of the world under measurement: the server's default.
pub const WORLD_SEED: u64 = 1;

/// `count` different chunks of a level that contain land, nearest to the origin first. Fewer if the
/// world has fewer.
pub fn land_keys(land: &Land, level: u8, count: usize) -> Vec<ChunkKey> {
    let mut keys = Vec::with_capacity(count);
    for ring in 0i32.. {
        let side = -ring..=ring;
        let on_ring = side.clone().flat_map(|x| side.clone().map(move |z| (x, z)));
        for (x, z) in on_ring.filter(|(x, z)| x.abs().max(z.abs()) == ring) {
            // The border of the world.
            let Ok(key) = ChunkKey::new(level, x, z) else { return keys };
            // Skips chunks below the sea; 10 microseconds a chunk.
            if land.chunk_heights(key).iter().all(|height| *height <= 0) {
                continue;
            }
            keys.push(key);
            if keys.len() == count {
                return keys;
            }
        }
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_different_and_all_have_land() {
        let land = Land::new(WORLD_SEED);
        for level in [0, 4] {
            let keys = land_keys(&land, level, 500);
            let unique: std::collections::HashSet<_> = keys.iter().collect();
            assert_eq!((keys.len(), unique.len()), (500, 500));
            assert!(keys.iter().all(|key| key.level() == level && land.chunk(*key).max() > 0));
        }
    }
}
