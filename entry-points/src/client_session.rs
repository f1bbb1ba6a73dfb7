//! Frames of a server, by the client's session machine.

use crate::world::{DELIVERIES, WORLD, frame, key};
use crate::{control, frames, join};
use protocol::DataFrame;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_CREDITS;

/// Passes frames to a session until it ends. The first byte selects the delivery.
///
/// # Panics
/// More credit is outstanding than a session may grant, or a chunk came without any.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let Some((first, rest)) = bytes.split_first() else { return false };
    let mut session = ClientSession::new(ClientConfig {
        digest: Some(WORLD.digest),
        delivery: DELIVERIES[usize::from(first % 4)],
        token: None,
        software: "entry points".into(),
        window: 2,
    });
    let mut is_accepted = false;
    for frame in frames(rest) {
        while session.poll_transmit().is_some() {}
        let before = session.credits();
        assert!(before <= MAX_CREDITS);
        match session.receive(DataFrame::Binary(frame)) {
            Ok(event) => {
                let is_chunk = matches!(event, Event::Chunk { .. });
                assert_eq!(session.credits() + u32::from(is_chunk), before);
                is_accepted = true;
            }
            Err(fault) => {
                let _ = fault.close_code();
                break;
            }
        }
    }
    is_accepted
}

/// A session of each delivery.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let messages = control::server_messages();
    let messages: Vec<_> =
        messages.iter().filter_map(|message| protocol::control::encode(message).ok()).collect();
    (0..4u8)
        .map(|choice| {
            let delivery = DELIVERIES[usize::from(choice)];
            let chunks =
                [(1, 0, 0), (0, 0, 0), (0, 1, 0)].map(|(level, x, z)| frame(key(level, x, z), delivery));
            let [welcome, settled, refused, draining, ..] = &messages[..] else { return vec![choice] };
            let session = [welcome, &chunks[0], &chunks[1], settled, refused, &chunks[2], draining];
            [vec![choice], join(session.map(|frame| &frame[..]))].concat()
        })
        .collect()
}
