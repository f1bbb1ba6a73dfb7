//! Frames of a client, by the server's session machine.

use crate::world::{self, WORLD};
use crate::{control, frames, join};
use bytes::Bytes;
use protocol::DataFrame;
use protocol::limits::{MAX_CREDITS, MAX_PENDING_REQUESTS, SEED_ONLY_FRAME};
use protocol::message::ServerMessage;
use protocol::server::ServerSession;
use terrain::lod;

/// Stands for every chunk: the session does not look into it.
const CHUNK: Bytes = Bytes::from_static(&[0; SEED_ONLY_FRAME]);

/// Estimated chunks of the largest view that is selected. The largest that a server accepts takes
/// minutes here, and has nothing that a smaller one lacks.
const LARGEST_VIEW: u64 = 4096;

/// Chunks delivered after each frame.
const CHUNKS: u32 = 8;

/// Passes frames to a session until it ends, and delivers chunks while there is credit.
///
/// # Panics
/// A queue exceeds its limit, more is delivered than was granted, or a message cannot be decoded.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let mut session = ServerSession::new(world::offer(), 1);
    let mut is_accepted = false;
    for frame in frames(bytes) {
        match session.receive(DataFrame::Binary(frame)) {
            Ok(()) => is_accepted = true,
            Err(fault) => {
                let _ = fault.close_code();
                break;
            }
        }
        while let Some(mut selection) = session.take_view() {
            if lod::estimated_chunks(&selection.view().viewer()) > LARGEST_VIEW {
                session.fail_view("it is not selected here");
                continue;
            }
            while !selection.step(&WORLD.land, 1024) {}
            session.apply_view(selection);
        }
        for number in 0..CHUNKS {
            let before = session.credits();
            let Some((request, _)) = session.next_chunk() else { break };
            assert_eq!(session.credits() + 1, before);
            match number % 3 {
                0 | 1 => session.deliver(request, CHUNK),
                _ => session.withdraw(request),
            }
        }
        assert!(session.waiting_requests() <= MAX_PENDING_REQUESTS);
        assert!(session.credits() <= MAX_CREDITS);
        while let Some(sent) = session.poll_transmit() {
            assert!(sent == CHUNK || protocol::control::decode::<ServerMessage>(&sent).is_ok());
        }
    }
    is_accepted
}

/// A session with every message.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let messages = control::client_messages();
    let frames: Vec<_> =
        messages.iter().filter_map(|message| protocol::control::encode(message).ok()).collect();
    vec![join(frames.iter().map(|frame| &frame[..])), join(frames.iter().take(4).map(|frame| &frame[..]))]
}
