//! Which chunks a benchmark asks for: land of level 0, because the open sea costs nothing to make
//! and little to send.

use terrain::{ChunkKey, Land};

/// The seed of the world under measurement: the server's default.
pub const WORLD_SEED: u64 = 1;

/// So many different chunks with land in them, nearest to the origin first.
#[must_use]
pub fn land_keys(land: &Land, count: usize) -> Vec<ChunkKey> {
    let mut keys = Vec::with_capacity(count);
    for ring in 0i32.. {
        let side = -ring..=ring;
        let on_ring = side.clone().flat_map(|x| side.clone().map(move |z| (x, z)));
        for (x, z) in on_ring.filter(|(x, z)| x.abs().max(z.abs()) == ring) {
            // The world ends after rings that no count of this program reaches.
            let Ok(key) = ChunkKey::new(0, x, z) else { return keys };
            // Above the sea somewhere; 10 microseconds a chunk.
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
        let keys = land_keys(&land, 500);
        let unique: std::collections::HashSet<_> = keys.iter().collect();
        assert_eq!((keys.len(), unique.len()), (500, 500));
        assert!(keys.iter().all(|key| land.chunk(*key).max() > 0));
    }
}
