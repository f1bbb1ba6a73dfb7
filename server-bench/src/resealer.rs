//! Digests that fit corrupted chunks, as a hostile server writes them: a receiver decodes these
//! chunks.

use protocol::chunk_codec::{self, MAGIC, refined};
use protocol::control;
use protocol::message::ServerMessage;
use std::collections::HashMap;
use terrain::constants::VERTEX_COUNT;
use terrain::{ChunkKey, WorldDigest};

/// What digests of a session's chunks depend on.
#[derive(Default)]
pub struct Resealer {
    /// None before the server's welcome.
    world: Option<WorldDigest>,
    /// Of the chunks that the receiver has, for those refined from them.
    heights: HashMap<ChunkKey, Box<[i32; VERTEX_COUNT]>>,
}

impl Resealer {
    /// Reads the payload of a message before it is corrupted.
    pub fn read(&mut self, payload: &[u8]) {
        let Some(world) = self.world else {
            if let Ok(ServerMessage::Welcome(welcome)) = control::decode(payload) {
                self.world = Some(WorldDigest(welcome.digest));
            }
            return;
        };
        let decoded = match self.parent(payload) {
            Some(parent) => refined::decode_over(payload, &world, parent),
            None => chunk_codec::decode(payload, &world),
        };
        if let Ok(chunk) = decoded.or_else(|_| chunk_codec::decode(payload, &world)) {
            self.heights.insert(chunk.key, chunk.heights);
        }
    }

    /// Gives a corrupted chunk the digest of its bytes. Another message stays as it is.
    pub fn reseal(&self, payload: &mut [u8]) {
        if let Some(world) = self.world.filter(|_| payload.starts_with(&MAGIC)) {
            chunk_codec::rewrite_digest(payload, &world, self.parent(payload));
        }
    }

    fn parent(&self, payload: &[u8]) -> Option<&[i32; VERTEX_COUNT]> {
        let (_, key) = chunk_codec::kind_and_key(payload).ok()?;
        self.heights.get(&key.parent()?).map(|heights| &**heights)
    }
}
