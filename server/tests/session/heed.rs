//! How long a session that is refused much is not listened to.

use crate::peer::{BINARY, PING, PONG, Peer};
use protocol::control;
use protocol::limits::MAX_KEYS;
use protocol::message::{ClientMessage, RefusalReason, ServerMessage, WireKey};
use server::ServerConfig;
use server::listener::Shared;
use server::purse::Purse;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

fn shared() -> Arc<Shared> {
    shared_at(None)
}

/// A server that grants an address so many milliseconds of work a second.
fn shared_at(cost_per_second: Option<u64>) -> Arc<Shared> {
    Arc::new(Shared::new(ServerConfig { threads: 1, cost_per_second, ..ServerConfig::default() }).unwrap())
}

/// Says a number of requests that must all be refused, and a ping behind them. Returns after what
/// time the pong came; by then, or right behind it, everything must be refused.
async fn ask_for_nothing(peer: &mut Peer, requests: u32, keys: usize) -> Duration {
    let start = Instant::now();
    let nowhere = |z| WireKey { level: 0, x: i32::MAX, z };
    for id in 0..requests {
        peer.say(&ClientMessage::Request { id, keys: (0..keys as i32).map(nowhere).collect() }).await;
    }
    // Behind what is read in one go with the requests.
    tokio::time::sleep(Duration::from_millis(1)).await;
    peer.send(PING, b"?").await;
    let (mut refusals, mut answered) = (0, None);
    while refusals < requests as usize * keys || answered.is_none() {
        match peer.next().await.expect("a frame") {
            (BINARY, payload) => {
                let message = control::decode(&payload).unwrap();
                let ServerMessage::Refused(refused) = message else { panic!("{message:?}") };
                assert_eq!(refused.reason, RefusalReason::OutsideWorld);
                refusals += 1;
            }
            (PONG, _) => answered = Some(start.elapsed()),
            (opcode, _) => panic!("a frame of opcode {opcode}"),
        }
    }
    answered.unwrap()
}

#[tokio::test(start_paused = true)]
async fn whoever_is_refused_much_is_heard_again_after_a_while_and_others_at_once() {
    let shared = shared();
    let mut other = Peer::welcome(&shared, Purse::default()).await;
    let mut flood = Peer::welcome(&shared, Purse::default()).await;
    let took = ask_for_nothing(&mut flood, 40, MAX_KEYS).await;
    assert!((5..=200).contains(&took.as_millis()), "{took:?}");
    assert!(shared.metrics.refusal_pauses.get() > 0);

    let before = shared.metrics.refusal_pauses.get();
    let took = ask_for_nothing(&mut other, 1, 100).await;
    assert!(took.as_millis() < 5, "one request of a hundred is nothing: {took:?}");
    assert_eq!(shared.metrics.refusal_pauses.get(), before);

    tokio::time::sleep(Duration::from_millis(100)).await;
    let took = ask_for_nothing(&mut flood, 1, 100).await;
    assert!(took.as_millis() < 5, "it is forgiven: {took:?}");
}

#[tokio::test(start_paused = true)]
async fn what_is_refused_is_bounded_by_the_purse_as_well() {
    for (cost_per_second, is_paused) in [(None, false), (Some(1), true)] {
        let shared = shared_at(cost_per_second);
        let purse = shared.purses.of(Some("10.0.0.1".parse().unwrap()));
        let mut peer = Peer::welcome(&shared, purse).await;
        let took = ask_for_nothing(&mut peer, 1, 100).await;
        assert_eq!(took.as_millis() >= 10, is_paused, "{cost_per_second:?}: {took:?}");
        assert_eq!(shared.metrics.refusal_pauses.get() > 0, is_paused);
    }
}
