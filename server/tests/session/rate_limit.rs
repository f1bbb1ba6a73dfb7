//! The rate limit per address, in sessions.

use crate::peer::{BINARY, PING, PONG, Peer, view};
use protocol::message::{ClientMessage, RefusalReason, ServerMessage};
use protocol::server::ChunkRequest;
use protocol::{Delivery, control};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::sync::Arc;
use std::time::Duration;
use terrain::{ChunkKey, lod};
use tokio::time::{Instant, sleep};

/// A server with a rate limit of one millisecond per second, which pays for 1 MiB.
fn server_state() -> Arc<ServerState> {
    state_with_rate(1)
}

fn state_with_rate(ms: u64) -> Arc<ServerState> {
    let config = ServerConfig { threads: 1, rate_limit_ms: Some(ms), ..ServerConfig::default() };
    Arc::new(ServerState::new(config).unwrap())
}

fn bucket(state: &ServerState, address: &str) -> TokenBucket {
    state.rate_limiter.bucket(Some(address.parse().unwrap()))
}

/// Generates chunks without a charge, so that sessions take no real time.
async fn generate(state: &ServerState, keys: &[ChunkKey]) -> usize {
    let mut bytes = 0;
    for key in keys {
        let chunk = ChunkRequest { key: *key, request: None, priority: 0 };
        bytes += state.generation.flow().frame(chunk, Delivery::Exact).await.unwrap().len();
    }
    bytes
}

/// Receives as many chunks and refusals as are expected.
async fn receive(peer: &mut Peer, expected: usize) -> (usize, Vec<RefusalReason>) {
    let (mut chunks, mut refusals) = (0, Vec::new());
    while chunks + refusals.len() < expected {
        let (opcode, payload) = peer.next().await.expect("a frame");
        match opcode {
            PING => peer.send(PONG, &payload).await,
            BINARY => match control::decode(&payload) {
                Ok(ServerMessage::Refused(refused)) => refusals.push(refused.reason),
                Ok(_) => {}
                Err(_) => chunks += 1,
            },
            other => panic!("a frame of opcode {other}"),
        }
    }
    (chunks, refusals)
}

#[tokio::test(start_paused = true)]
async fn requests_over_the_rate_limit_are_rejected_at_once() {
    let state = server_state();
    let keys: Vec<ChunkKey> = (0..20).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
    generate(&state, &keys).await;
    let [empty, full] = ["10.0.0.1", "10.0.0.2"].map(|address| bucket(&state, address));
    let mut throttled = Peer::connect(&state, empty.clone()).await;
    let mut free = Peer::connect(&state, full).await;
    // Another session of the address spends the bucket and five seconds of refill more.
    empty.charge_chunk(15_000, Instant::now());
    let request = ClientMessage::Request { id: 7, keys: keys.iter().map(|key| (*key).into()).collect() };
    let credit = ClientMessage::Credit { chunks: 1000 };
    for peer in [&mut throttled, &mut free] {
        peer.send_message(&credit).await;
        peer.send_message(&request).await;
    }
    let requested = Instant::now();
    assert_eq!(receive(&mut throttled, keys.len()).await, (0, vec![RefusalReason::Overloaded; keys.len()]));
    assert!(requested.elapsed() < Duration::from_secs(1), "{:?}", requested.elapsed());
    assert_eq!(receive(&mut free, keys.len()).await, (keys.len(), vec![]));
    assert_eq!(state.metrics.limits.rate_limit_rejections.get(), keys.len() as u64);

    sleep(Duration::from_secs(6)).await;
    throttled.send_message(&request).await;
    assert_eq!(receive(&mut throttled, keys.len()).await, (keys.len(), vec![]));
}

#[tokio::test(start_paused = true)]
async fn requests_that_the_bucket_pays_for_within_the_deadline_are_not_rejected() {
    let state = server_state();
    let keys: Vec<ChunkKey> = (0..20).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
    generate(&state, &keys).await;
    let bucket = bucket(&state, "10.0.0.1");
    let mut peer = Peer::connect(&state, bucket.clone()).await;
    // The bucket is empty. Half a second of refill pays for ten at the recent cost.
    for _ in 0..200 {
        bucket.charge_chunk(50, Instant::now());
    }
    peer.send_message(&ClientMessage::Credit { chunks: 1000 }).await;
    let keys = keys.into_iter().map(ChunkKey::into).collect();
    peer.send_message(&ClientMessage::Request { id: 7, keys }).await;
    assert_eq!(receive(&mut peer, 20).await, (10, vec![RefusalReason::Overloaded; 10]));
    assert_eq!(state.metrics.limits.rate_limit_rejections.get(), 10);
}

/// On the real clock: a view is selected on a thread, and a paused clock would run away meanwhile.
#[tokio::test]
async fn a_view_is_delayed_by_the_rate_limit_and_never_rejected() {
    // A full bucket holds a second of work.
    let state = state_with_rate(100);
    let view = view(1);
    let keys: Vec<_> =
        lod::select(&state.offer.land, &view.viewer(), 10_000).iter().map(|needed| needed.key).collect();
    generate(&state, &keys).await;
    assert!(keys.len() > 50);
    // The control has a full bucket. The other lacks half a second of work, which takes 5 s: longer
    // than it takes to open a session, on a busy machine too.
    for (address, charge_us, is_delayed) in [("10.0.0.1", 0, false), ("10.0.0.2", 1_500_000, true)] {
        let bucket = bucket(&state, address);
        let start = Instant::now();
        bucket.charge_chunk(charge_us, start);
        let mut peer = Peer::connect(&state, bucket.clone()).await;
        peer.send_message(&ClientMessage::Credit { chunks: 4096 }).await;
        peer.send_message(&ClientMessage::View(view)).await;
        assert_eq!(receive(&mut peer, keys.len()).await, (keys.len(), vec![]));
        assert_eq!(state.metrics.limits.rate_limit_delays.get() > 0, is_delayed);
    }
    assert_eq!(state.metrics.limits.rate_limit_rejections.get(), 0);
}

#[tokio::test(start_paused = true)]
async fn an_idle_session_is_not_delayed_by_the_rate_limit() {
    let state = server_state();
    let key = ChunkKey::new(0, 1, 0).unwrap();
    generate(&state, &[key]).await;
    let bucket = bucket(&state, "10.0.0.1");
    let mut peer = Peer::connect(&state, bucket.clone()).await;
    peer.send_message(&ClientMessage::Credit { chunks: 10 }).await;
    // What other sessions of the address spend.
    let spend = || bucket.charge_work(10_200, Instant::now());
    spend();
    // The driver wakes and finds the bucket empty.
    peer.send(PING, b"?").await;
    assert_eq!(peer.next().await.unwrap().0, PONG);
    sleep(Duration::from_secs(5)).await;
    assert_eq!(state.metrics.limits.rate_limit_delays.get(), 0);
    // The control: a request waits for less than the deadline, and is counted.
    spend();
    let missing = bucket.delay(Instant::now()).unwrap() - Duration::from_millis(300);
    sleep(missing).await;
    peer.send_message(&ClientMessage::Request { id: 7, keys: vec![key.into()] }).await;
    assert_eq!(receive(&mut peer, 1).await, (1, vec![]));
    assert_eq!(state.metrics.limits.rate_limit_delays.get(), 1);
}
