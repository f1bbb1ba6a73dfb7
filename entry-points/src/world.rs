//! The world of all entry points, and some of its chunks.

use bytes::Bytes;
use protocol::server::ServerOffer;
use protocol::{Delivery, Tolerance, chunk_codec};
use std::sync::LazyLock;
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

/// What a server offers.
pub fn offer() -> ServerOffer {
    ServerOffer { land: WORLD.land, digest: WORLD.digest, token: None, software: "entry points".into() }
}
