//! The world of all entry points, and some of its chunks.

use bytes::Bytes;
use protocol::server::ServerOffer;
use protocol::{Delivery, Tolerance, chunk_codec};
use std::sync::LazyLock;
use terrain::constants::VERTICES;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// The world, its digest, and the parent of refined frames.
pub struct World {
    pub land: Land,
    pub digest: WorldDigest,
    pub parent: Chunk,
}

/// Computed once.
pub static WORLD: LazyLock<World> = LazyLock::new(|| {
    let land = Land::new(42);
    World { land, digest: land.digest(), parent: land.chunk(key(1, 0, 0)) }
});

/// The deliveries of sessions.
pub const DELIVERIES: [Delivery; 4] =
    [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly, Delivery::Quantised(Tolerance::COARSEST)];

/// A key that exists.
pub fn key(level: u8, x: i32, z: i32) -> ChunkKey {
    ChunkKey::new(level, x, z).expect("a key of the world")
}

/// A frame of one of the world's chunks.
pub fn frame(key: ChunkKey, delivery: Delivery) -> Bytes {
    chunk_codec::encode_for(delivery, &WORLD.land.chunk(key), &WORLD.digest)
}

/// The child of [`World::parent`] at the origin with one vertex of its own far above the others, so
/// that residuals take every byte plane, and with grass densities that no rule gives.
pub fn rough() -> Chunk {
    let land = WORLD.land.chunk(key(0, 0, 0));
    let (mut heights, mut grass) = (land.heights, land.grass);
    heights[33 * VERTICES + 33] += 1 << 22;
    for (index, density) in grass.density.iter_mut().enumerate() {
        *density = (index * 7) as u8;
    }
    Chunk::from_parts(land.key, heights, land.error, grass)
}

/// The offer of a server.
pub fn offer() -> ServerOffer {
    ServerOffer { land: WORLD.land, digest: WORLD.digest, token: None, software: "entry points".into() }
}
