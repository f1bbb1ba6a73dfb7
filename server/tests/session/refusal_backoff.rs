//! The refusal back-off of sessions.

use crate::peer::{ADDRESS, BINARY, PING, PONG, Peer};
use protocol::control;
use protocol::limits::MAX_KEYS;
use protocol::message::{ClientMessage, RefusalReason, ServerMessage, WireKey};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

fn server_state() -> Arc<ServerState> {
    server_with_limit(None)
}

/// A server with a rate limit in milliseconds per second.
fn server_with_limit(rate_limit_ms: Option<u64>) -> Arc<ServerState> {
    Arc::new(ServerState::new(ServerConfig { threads: 1, rate_limit_ms, ..ServerConfig::default() }).unwrap())
}

/// Sends requests that must all be rejected, and a ping behind them. Returns the time to the pong,
/// after all rejections have arrived.
async fn send_invalid_requests(peer: &mut Peer, requests: u32, keys: usize) -> Duration {
    let start = Instant::now();
    let outside = |z| WireKey { level: 0, x: i32::MAX, z };
    for id in 0..requests {
        peer.send_message(&ClientMessage::Request { id, keys: (0..keys as i32).map(outside).collect() })
            .await;
    }
    // Not in the same read as the requests.
    tokio::time::sleep(Duration::from_millis(1)).await;
    peer.send(PING, b"?").await;
    let (mut refusals, mut pong) = (0, None);
    while refusals < requests as usize * keys || pong.is_none() {
        match peer.next().await.expect("a frame") {
            (BINARY, payload) => {
                let message = control::decode(&payload).unwrap();
                let ServerMessage::Refused(refused) = message else { panic!("{message:?}") };
                assert_eq!(refused.reason, RefusalReason::OutsideWorld);
                refusals += 1;
            }
            (PONG, _) => pong = Some(start.elapsed()),
            (opcode, _) => panic!("a frame of opcode {opcode}"),
        }
    }
    pong.unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_session_with_many_rejections_pauses_and_others_do_not() {
    let state = server_state();
    let mut other = Peer::connect(&state, TokenBucket::default()).await;
    let mut flood = Peer::connect(&state, TokenBucket::default()).await;
    let took = send_invalid_requests(&mut flood, 40, MAX_KEYS).await;
    assert!((5..=200).contains(&took.as_millis()), "{took:?}");
    assert!(state.metrics.limits.refusal_backoffs.get() > 0);

    let before = state.metrics.limits.refusal_backoffs.get();
    let took = send_invalid_requests(&mut other, 1, 100).await;
    assert!(took.as_millis() < 5, "one request of a hundred keys causes no pause: {took:?}");
    assert_eq!(state.metrics.limits.refusal_backoffs.get(), before);

    tokio::time::sleep(Duration::from_millis(100)).await;
    let took = send_invalid_requests(&mut flood, 1, 100).await;
    assert!(took.as_millis() < 5, "the pause is over: {took:?}");
}

#[tokio::test(start_paused = true)]
async fn the_rate_limit_bounds_rejections_as_well() {
    for (rate_limit_ms, is_paused) in [(None, false), (Some(1), true)] {
        let state = server_with_limit(rate_limit_ms);
        let bucket = state.rate_limiter.bucket(Some("10.0.0.1".parse().unwrap()));
        let mut peer = Peer::connect(&state, bucket).await;
        let took = send_invalid_requests(&mut peer, 1, 100).await;
        assert_eq!(took.as_millis() >= 10, is_paused, "{rate_limit_ms:?}: {took:?}");
        assert_eq!(state.metrics.limits.refusal_backoffs.get() > 0, is_paused);
    }
}

/// One read of invalid keys costs more than a pause where many share a thread. What exceeds the
/// first pause follows in the next ones.
#[tokio::test(start_paused = true)]
async fn the_rejections_of_one_read_count_in_full() {
    // The rate of a thousandth of a thread counts as a thousand sharers.
    let state = server_with_limit(Some(1));
    let bucket = state.rate_limiter.bucket(Some("10.0.0.1".parse().unwrap()));
    let mut peer = Peer::connect(&state, bucket).await;
    // 500 rejections of 4 us by 1,000 are two seconds.
    send_invalid_requests(&mut peer, 1, 500).await;
    let before = Instant::now();
    for _ in 0..15 {
        peer.send(PING, b"?").await;
        assert_eq!(peer.next().await.unwrap().0, PONG);
    }
    let took = before.elapsed().as_millis();
    assert!((1300..=1900).contains(&took), "one message is read after each pause: {took} ms");
    tokio::time::sleep(Duration::from_secs(2)).await;
    let before = Instant::now();
    for _ in 0..15 {
        peer.send(PING, b"?").await;
        assert_eq!(peer.next().await.unwrap().0, PONG);
    }
    assert!(before.elapsed().as_millis() < 10, "the back-off is over");
}

#[tokio::test(start_paused = true)]
async fn a_client_that_does_not_stop_is_named_in_the_log() {
    for (requests, is_named) in [(2, false), (45, true)] {
        let state = server_with_limit(Some(1));
        let mut peer = Peer::connect(&state, state.rate_limiter.bucket(Some(ADDRESS))).await;
        // A pause of 0.1 s before each KiB of them.
        send_invalid_requests(&mut peer, requests, MAX_KEYS).await;
        // The first event of an address has its line at once and is not counted: one more shows
        // whether this is the first.
        let reason = "requests or views without end";
        state.peer_log.report(Some(ADDRESS), reason);
        let (lines, _) = state.peer_log.take();
        let named: Vec<_> = lines.iter().map(|line| (line.address, line.reason)).collect();
        let expected = [(ADDRESS, reason)];
        assert_eq!(named, if is_named { &expected[..] } else { &[] }, "{requests} requests");
    }
}
