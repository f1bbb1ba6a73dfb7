//! Many cached chunks for one client, which are written in batches.

use crate::peer::{BINARY, CLOSE, PING, PONG, Peer};
use protocol::control;
use protocol::limits::MAX_KEYS;
use protocol::message::{ClientMessage, ServerMessage};
use protocol::server::ChunkRequest;
use protocol::{CloseCode, Delivery};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::sync::Arc;
use terrain::ChunkKey;

/// Chunks that are requested: several times what the pipe to the client holds.
const REQUESTED: usize = 1024;

/// Chunks that may be on their way when something happens: 1 MiB in the pipe, and two batches.
const ON_THE_WAY: usize = 500;

/// Chunks that are read before something happens.
const READ: usize = 64;

/// What a client receives.
#[derive(Debug, PartialEq)]
enum Received {
    Chunk,
    Message(ServerMessage),
    Pong,
    Close(u16),
}

/// A client that has requested cached chunks, a server with them, and the first chunks read.
async fn downloading() -> (Arc<ServerState>, Peer) {
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    let keys: Vec<ChunkKey> = (0..REQUESTED as i32).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
    for key in &keys {
        let chunk = ChunkRequest { key: *key, request: None, priority: 0 };
        state.generation.flow().frame(chunk, Delivery::Exact).await.unwrap();
    }
    let mut peer = Peer::connect(&state, TokenBucket::default()).await;
    peer.send_message(&ClientMessage::Credit { chunks: 4096 }).await;
    for (id, keys) in (0..).zip(keys.chunks(MAX_KEYS)) {
        let keys = keys.iter().map(|key| (*key).into()).collect();
        peer.send_message(&ClientMessage::Request { id, keys }).await;
    }
    for _ in 0..READ {
        assert_eq!(receive(&mut peer).await, Received::Chunk);
    }
    (state, peer)
}

async fn receive(peer: &mut Peer) -> Received {
    let (opcode, payload) = peer.next().await.expect("a frame");
    match opcode {
        PONG => Received::Pong,
        CLOSE => Received::Close(u16::from_be_bytes([payload[0], payload[1]])),
        BINARY => control::decode(&payload).map_or(Received::Chunk, Received::Message),
        other => panic!("a frame of opcode {other}"),
    }
}

/// Chunks until something else arrives, and that.
async fn chunks_before(peer: &mut Peer) -> (usize, Received) {
    for chunks in 0.. {
        match receive(peer).await {
            Received::Chunk => {}
            other => return (chunks, other),
        }
    }
    unreachable!("counting has no end")
}

#[tokio::test(start_paused = true)]
async fn a_message_is_read_between_two_batches() {
    let (_state, mut peer) = downloading().await;
    peer.send(PING, b"").await;
    let (before, pong) = chunks_before(&mut peer).await;
    assert_eq!(pong, Received::Pong);
    assert!(before < ON_THE_WAY, "{before} chunks came first");
    for _ in READ + before..REQUESTED {
        assert_eq!(receive(&mut peer).await, Received::Chunk);
    }
}

#[tokio::test(start_paused = true)]
async fn a_shutdown_is_announced_between_two_batches() {
    let (state, mut peer) = downloading().await;
    state.draining.cancel();
    let (before, message) = chunks_before(&mut peer).await;
    assert!(matches!(message, Received::Message(ServerMessage::Draining { .. })), "{message:?}");
    assert!(before < ON_THE_WAY, "{before} chunks came first");
    assert_eq!(receive(&mut peer).await, Received::Close(CloseCode::GoingAway.code()));
}
