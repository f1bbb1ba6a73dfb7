//! A client whose next message is always there.

use crate::peer::{BINARY, PING, Peer, frame, hello, view};
use protocol::control;
use protocol::message::{ClientMessage, ServerMessage};
use protocol::view::View;
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::io::Cursor;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, duplex, join, repeat};

/// Longest time until the test fails instead of waiting for ever.
const GIVE_UP: Duration = Duration::from_secs(60);

/// Bytes of a Ping without end: opcode, mask and length, four bytes of the mask and nine of the
/// payload are all the same.
const PINGS: u8 = 0x80 | PING;

/// Its selection and its chunks are finished while the session reads.
#[tokio::test]
async fn a_client_that_sends_without_end_has_its_view() {
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    let view = View { tolerance_q4: 4000, ..view(1) };
    let messages =
        [hello(state.offer.digest.0), ClientMessage::Credit { chunks: 4096 }, ClientMessage::View(view)];
    let first: Vec<u8> =
        messages.iter().flat_map(|message| frame(BINARY, &control::encode(message).unwrap())).collect();
    let (io, theirs) = duplex(1 << 20);
    let stream = join(Cursor::new(first).chain(repeat(PINGS)), theirs);
    let mut peer = Peer::over(&state, TokenBucket::default(), io, stream);
    let settled = async {
        let mut chunks = 0;
        loop {
            let (opcode, payload) = peer.next().await.expect("the session goes on");
            match control::decode::<ServerMessage>(&payload) {
                _ if opcode != BINARY => {}
                Ok(ServerMessage::Settled(settled)) => return (chunks, settled),
                Ok(_) => {}
                Err(_) => chunks += 1,
            }
        }
    };
    let (chunks, settled) = tokio::time::timeout(GIVE_UP, settled).await.expect("the view is settled");
    assert!(chunks > 0 && settled.view == 1, "{chunks} chunks before {settled:?}");
}
