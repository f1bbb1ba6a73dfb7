//! Many cached chunks for one client, which are written in batches.

use crate::peer::{BINARY, CLOSE, PING, PONG, Peer};
use protocol::control;
use protocol::limits::MAX_KEYS;
use protocol::message::{ClientMessage, ServerMessage, WireKey};
use protocol::server::ChunkRequest;
use protocol::{CloseCode, Delivery};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::sync::Arc;
use std::time::Duration;
use terrain::{ChunkKey, Land};
use tokio::time::Instant;

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
    downloading_over(1 << 20, (0..REQUESTED as i32).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect()).await
}

/// As [`downloading`], of other chunks over a pipe that holds so many bytes.
async fn downloading_over(pipe: usize, keys: Vec<ChunkKey>) -> (Arc<ServerState>, Peer) {
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    for key in &keys {
        let chunk = ChunkRequest { key: *key, request: None, priority: 0 };
        state.generation.flow().frame(chunk, Delivery::Exact).await.unwrap();
    }
    let mut peer = Peer::over_pipe(&state, TokenBucket::default(), pipe);
    peer.hello().await;
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
    let (state, mut peer) = downloading().await;
    peer.send(PING, b"").await;
    let (before, pong) = chunks_before(&mut peer).await;
    assert_eq!(pong, Received::Pong);
    assert!(before < ON_THE_WAY, "{before} chunks came first");
    for _ in READ + before..REQUESTED {
        assert_eq!(receive(&mut peer).await, Received::Chunk);
    }
    // Behind the end of the last write.
    peer.send(PING, b"").await;
    assert_eq!(receive(&mut peer).await, Received::Pong);
    let latencies: u64 = state.metrics.sessions.latency.counts().iter().sum();
    assert_eq!(latencies, REQUESTED as u64, "one of each chunk");
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

/// Chunks of the land, whose frames are longer than those of the sea.
fn around_the_start() -> Vec<ChunkKey> {
    let start = Land::new(1).start();
    let corner = ChunkKey::containing(0, start.x, start.z);
    let around = (0..REQUESTED as i32).map(|n| ChunkKey::new(0, corner.x() + n % 32, corner.z() + n / 32));
    around.map(Result::unwrap).collect()
}

/// A batch of cached chunks takes longer at this rate than the timeout of a write.
#[tokio::test(start_paused = true)]
async fn a_slow_reader_keeps_its_session_whatever_the_length_of_a_batch() {
    let (_state, mut peer) = downloading_over(4096, around_the_start()).await;
    let (mut chunks, mut bytes, mut total) = (READ, 0, 0);
    while chunks < REQUESTED {
        let (opcode, payload) = peer.next().await.expect("the session goes on");
        if opcode == BINARY && control::decode::<ServerMessage>(&payload).is_err() {
            chunks += 1;
        }
        if opcode == PING {
            peer.send(PONG, &payload).await;
        }
        bytes += payload.len();
        total += payload.len();
        if bytes > 64 * 1024 {
            tokio::time::sleep(Duration::from_secs(8)).await;
            bytes = 0;
        }
    }
    assert!(total > 1000 * REQUESTED, "{total} bytes");
}

/// The control: 40 KiB in the timeout of a write, and not 64.
#[tokio::test(start_paused = true)]
async fn a_slower_reader_loses_its_session() {
    let (state, mut peer) = downloading_over(4096, around_the_start()).await;
    let mut bytes = 0;
    while let Some((_, payload)) = peer.next().await {
        bytes += payload.len();
        if bytes > 8 * 1024 {
            tokio::time::sleep(Duration::from_secs(2)).await;
            bytes = 0;
        }
    }
    assert_eq!(state.metrics.sessions.ended_for("write_timeout"), 1);
}

/// Answers that the peer does not read have one timeout, also where a violation ends the session.
#[tokio::test(start_paused = true)]
async fn a_session_with_a_violation_ends_in_one_timeout_of_a_write() {
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let write_timeout = config.write_timeout;
    let state = Arc::new(ServerState::new(config).unwrap());
    let mut peer = Peer::over_pipe(&state, TokenBucket::default(), 16 * 1024);
    peer.hello().await;
    let outside = WireKey { level: 200, x: 0, z: 0 };
    for id in 0..2 {
        peer.send_message(&ClientMessage::Request { id, keys: vec![outside; MAX_KEYS] }).await;
    }
    peer.send(1, b"text").await;
    let start = Instant::now();
    while state.metrics.sessions.open.get() > 0 {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let took = start.elapsed();
    assert!((write_timeout..write_timeout + Duration::from_secs(1)).contains(&took), "{took:?}");
    let ended = state.metrics.sessions.ended_for("write_timeout");
    assert_eq!(ended, 1);
}
