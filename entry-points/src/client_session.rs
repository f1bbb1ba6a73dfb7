//! Frames of a server, by the client's session machine.

use crate::chunk::is_read;
use crate::world::{DELIVERIES, WORLD, frame, key};
use crate::{control, frames, join};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_CREDITS;
use protocol::{ChunkError, DataFrame, Delivery, PeerFault, chunk_codec};
use std::collections::HashMap;
use terrain::constants::VERTEX_COUNT;

/// The bit of the first byte with which chunk frames get the digest of their bytes, as a hostile
/// server would write it. Without it, changed frames end at their digests.
const RESEALS: u8 = 4;

/// Passes frames to a session until it ends. The first byte selects the delivery and `RESEALS`.
///
/// # Panics
/// More credit is outstanding than a session may grant, or a chunk came without any.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let reseals = bytes.first().is_some_and(|first| first & RESEALS != 0);
    pass(bytes, reseals, |_, _| {})
}

/// The chunk frames of a session that are decoded behind their digests, with `RESEALS` or
/// without. For tests of what [`run`] covers.
#[must_use]
pub fn read(bytes: &[u8], reseals: bool) -> Vec<Vec<u8>> {
    let mut read = Vec::new();
    pass(bytes, reseals, |frame, parent| {
        if is_read(frame, parent) {
            read.push(frame.to_vec());
        }
    });
    read
}

/// Passes frames; calls `see` for each chunk frame that the session decodes by its kind, with the
/// heights of the parent.
fn pass(bytes: &[u8], reseals: bool, mut see: impl FnMut(&[u8], &[i32; VERTEX_COUNT])) -> bool {
    let Some((first, rest)) = bytes.split_first() else { return false };
    let mut session = ClientSession::new(ClientConfig {
        digest: Some(WORLD.digest),
        delivery: DELIVERIES[usize::from(first % 4)],
        token: None,
        software: "entry points".into(),
        window: 2,
    });
    let mut is_accepted = false;
    // The heights that refined frames of this session may refer to.
    let mut heights = HashMap::new();
    for frame in frames(rest) {
        while session.poll_transmit().is_some() {}
        let before = session.credits();
        assert!(before <= MAX_CREDITS);
        let mut frame = frame.to_vec();
        let named = chunk_codec::kind_and_key(&frame).ok();
        let parent = named.and_then(|(_, key)| heights.get(&key.parent()?).cloned());
        if reseals && frame.starts_with(&chunk_codec::MAGIC) {
            chunk_codec::rewrite_digest(&mut frame, &WORLD.digest, parent.as_deref());
        }
        let received = session.receive(DataFrame::Binary(&frame));
        let is_chunk = matches!(received, Ok(Event::Chunk { .. }) | Err(PeerFault::Chunk(_)));
        assert_eq!(session.credits() + u32::from(is_chunk), before);
        let is_taken = match received {
            Ok(event) => {
                is_accepted = true;
                if let Event::Chunk { chunk, .. } = event {
                    // The session keeps the first, too.
                    heights.entry(chunk.key).or_insert(chunk.heights);
                }
                is_chunk
            }
            // The session goes on, as that of the viewer.
            Err(PeerFault::Chunk(fault)) => {
                !matches!(fault, ChunkError::UnknownKind(_) | ChunkError::Parent(_))
            }
            Err(fault) => {
                let _ = fault.close_code();
                break;
            }
        };
        if is_taken {
            // Other kinds have no use for the heights.
            see(&frame, parent.as_deref().unwrap_or(&WORLD.parent.heights));
        }
    }
    is_accepted
}

/// A session of each delivery, with `RESEALS` and without.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let messages = control::server_messages();
    let messages: Vec<_> =
        messages.iter().filter_map(|message| protocol::control::encode(message).ok()).collect();
    (0..2 * RESEALS)
        .map(|choice| {
            let chunks = [(1, 0, 0), (0, 0, 0), (0, 1, 0)].map(|(level, x, z)| {
                let delivery = match DELIVERIES[usize::from(choice % 4)] {
                    // Its own parent is not sent.
                    Delivery::Refined if level > 0 => Delivery::Exact,
                    delivery => delivery,
                };
                frame(key(level, x, z), delivery)
            });
            let [welcome, settled, refused, draining, ..] = &messages[..] else { return vec![choice] };
            let session = [welcome, &chunks[0], &chunks[1], settled, refused, &chunks[2], draining];
            [vec![choice], join(session.map(|frame| &frame[..]))].concat()
        })
        .collect()
}
