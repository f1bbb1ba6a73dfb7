//! Why and how sessions end.

use crate::peer::{BINARY, CLOSE, PING, PONG, Peer};
use protocol::limits::MAX_CONTROL_FRAME;
use protocol::message::ServerMessage;
use protocol::{CloseCode, control};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::open_sessions::Shed;
use server::state::ServerState;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::time::sleep;

/// An empty text message, which is a violation.
const TEXT: [u8; 6] = [0x81, 0x80, 0, 0, 0, 0];

/// The end of one session for lack of memory.
const ONE: Shed = Shed { count: 1, is_critical: false };

fn server_state() -> Arc<ServerState> {
    Arc::new(ServerState::new(ServerConfig { threads: 1, ..ServerConfig::default() }).unwrap())
}

#[tokio::test(start_paused = true)]
async fn a_message_over_the_limit_of_the_protocol_is_read_and_rejected() {
    let state = server_state();
    for (bytes, code) in [
        (MAX_CONTROL_FRAME, CloseCode::Malformed),
        (MAX_CONTROL_FRAME + 1, CloseCode::TooLarge),
        (2 * MAX_CONTROL_FRAME, CloseCode::TooLarge),
    ] {
        let mut peer = Peer::connect(&state, TokenBucket::default()).await;
        peer.send(BINARY, &vec![0; bytes]).await;
        let (opcode, payload) = peer.next().await.expect("a close frame");
        assert_eq!((opcode, &payload[..2]), (CLOSE, &code.code().to_be_bytes()[..]), "{bytes} bytes");
        // A frame that is not read at all has another reason.
        let has_own_reason = payload[2..] == *code.to_string().as_bytes();
        assert_eq!(has_own_reason, code == CloseCode::TooLarge, "{bytes} bytes");
    }
}

#[tokio::test(start_paused = true)]
async fn the_reason_of_an_end_is_the_violation_where_the_answers_before_it_cannot_be_written() {
    let state = server_state();
    let mut peer = Peer::connect(&state, TokenBucket::default()).await;
    let frames = [[0x80 | PING, 0x80, 0, 0, 0, 0], TEXT];
    peer.write(&frames.concat()).await.unwrap();
    drop(peer);
    while state.metrics.sessions.open.get() > 0 {
        sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(state.metrics.sessions.ended_for("text_frame"), 1);
}

#[tokio::test(start_paused = true)]
async fn the_first_reason_of_an_end_stays_where_the_server_cuts_the_end_short() {
    for is_shed in [true, false] {
        let state = server_state();
        let _older = Peer::connect(&state, TokenBucket::default()).await;
        let mut peer = Peer::connect(&state, TokenBucket::default()).await;
        peer.write(&TEXT).await.unwrap();
        // Now the server waits for the Close frame of the peer.
        assert_eq!(peer.next().await.expect("a close frame").0, CLOSE);
        let other = Some(IpAddr::from([10, 0, 0, 1]));
        if is_shed {
            assert_eq!(state.open_sessions.shed(ONE), 1);
        } else {
            assert!(state.open_sessions.displace_for(other, Instant::now()));
        }
        let cut = tokio::time::Instant::now();
        while state.metrics.sessions.open.get() > 1 {
            sleep(Duration::from_millis(1)).await;
        }
        // Paused time: the server does not wait for the Close frame of the peer.
        assert!(cut.elapsed() < Duration::from_secs(1));
        assert_eq!(state.metrics.sessions.ended_for("text_frame"), 1);
    }
}

#[tokio::test(start_paused = true)]
async fn the_first_reason_of_an_end_stays_where_memory_lacks_before_the_answers_are_written() {
    let state = server_state();
    let mut peer = Peer::over_pipe(&state, TokenBucket::default(), 4096);
    peer.hello().await;
    // The pipe holds the answers of the first batch, and a part of those of the second one.
    let ping = [&[0x80 | PING, 0x80 | 125, 0, 0, 0, 0][..], &[0; 125]].concat();
    let pings = ping.repeat(20);
    for batch in [&pings, &[&pings[..], &TEXT].concat()] {
        peer.write(batch).await.unwrap();
        sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(state.open_sessions.shed(ONE), 1);
    while state.metrics.sessions.open.get() > 0 {
        sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(state.metrics.sessions.ended_for("text_frame"), 1);
    while let Some((opcode, _)) = peer.next().await {
        assert_eq!(opcode, PONG, "no Close frame");
    }
}

/// Random, so that clients do not all return at once.
#[tokio::test(start_paused = true)]
async fn each_session_gets_its_own_time_to_return_when_the_server_ends() {
    let state = server_state();
    let mut peers = Vec::new();
    for _ in 0..20 {
        peers.push(Peer::connect(&state, TokenBucket::default()).await);
    }
    state.draining.cancel();
    let mut delays = Vec::new();
    for peer in &mut peers {
        let (opcode, message) = peer.next().await.expect("a message");
        match (opcode, control::decode(&message)) {
            (BINARY, Ok(ServerMessage::Draining { reconnect_after_ms })) => delays.push(reconnect_after_ms),
            other => panic!("{other:?}"),
        }
    }
    delays.sort_unstable();
    assert!((500..1000).contains(&delays[0]) && (1500..2000).contains(&delays[19]), "{delays:?}");
}
