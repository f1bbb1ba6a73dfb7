//! A pack of the store.

use crate::world::{DELIVERIES, WORLD, frame, key};
use server::store::pack;
use server::store::tile::{CHUNKS, PackTile};

/// Reads index and digest of a pack. Frames of a valid one lie inside it.
///
/// # Panics
/// One does not.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let tile = PackTile::of(key(0, 0, 0)).0;
    let _ = pack::index(tile, bytes);
    let Ok(index) = pack::verify(&WORLD.digest, tile, bytes) else { return false };
    for frame in (0..CHUNKS).filter_map(|number| index.frame(number)) {
        assert!(frame.start <= frame.end && frame.end <= bytes.len() as u64);
    }
    assert!(index.frame(CHUNKS).is_none());
    true
}

/// An empty pack and one with two frames.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let (tile, first) = PackTile::of(key(0, 0, 0));
    let mut frames = vec![None; CHUNKS];
    let empty = pack::encode(&WORLD.digest, tile, &frames).to_vec();
    let second = PackTile::of(key(0, 1, 0)).1;
    frames[first] = Some(frame(key(0, 0, 0), DELIVERIES[0]));
    frames[second] = Some(frame(key(0, 1, 0), DELIVERIES[0]));
    vec![empty, pack::encode(&WORLD.digest, tile, &frames).to_vec()]
}
