//! The keep-alive of sessions.

use crate::peer::{CLOSE, PING, PONG, Peer};
use protocol::CloseCode;
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};

fn server_state() -> Arc<ServerState> {
    Arc::new(ServerState::new(ServerConfig { threads: 1, ..ServerConfig::default() }).unwrap())
}

/// Reads to the close frame. Returns the seconds of each ping and of the close since `start`, and
/// the code.
async fn follow(peer: &mut Peer, start: Instant) -> (Vec<u64>, u64, u16) {
    let mut pings = Vec::new();
    loop {
        let (opcode, payload) = peer.next().await.expect("a close frame");
        let second = start.elapsed().as_secs_f64().round() as u64;
        match opcode {
            PING => pings.push(second),
            CLOSE => return (pings, second, u16::from_be_bytes([payload[0], payload[1]])),
            _ => {}
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_silent_session_is_closed_after_a_minute() {
    for delay_ms in [0, 50, 3000] {
        let mut peer = Peer::new(&server_state(), TokenBucket::default());
        // Time before the hello must not count as idle.
        sleep(Duration::from_millis(delay_ms)).await;
        let start = Instant::now();
        peer.hello().await;
        let (pings, end, code) = follow(&mut peer, start).await;
        assert_eq!((pings, end, code), (vec![20, 40], 60, CloseCode::Unresponsive.code()), "{delay_ms} ms");
    }
}

#[tokio::test(start_paused = true)]
async fn a_session_that_answers_pings_stays_open() {
    let (state, start) = (server_state(), Instant::now());
    let mut peer = Peer::connect(&state, TokenBucket::default()).await;
    let mut pings = 0;
    while start.elapsed() < Duration::from_secs(600) {
        let (opcode, payload) = peer.next().await.expect("a frame");
        assert_eq!(opcode, PING);
        pings += 1;
        sleep(Duration::from_secs(1)).await;
        peer.send(PONG, &payload).await;
    }
    // One every 21 seconds.
    assert_eq!(pings, 29);
    // The control: without answers the session is closed.
    assert_eq!(follow(&mut peer, start).await.2, CloseCode::Unresponsive.code());
}

#[tokio::test(start_paused = true)]
async fn a_session_without_hello_is_closed_sooner() {
    let start = Instant::now();
    let mut peer = Peer::new(&server_state(), TokenBucket::default());
    assert_eq!(follow(&mut peer, start).await, (vec![], 5, CloseCode::HandshakeTimeout.code()));
}
