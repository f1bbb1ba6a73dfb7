//! What an address that has spent its share gets.

use crate::peer::{BINARY, PING, PONG, Peer};
use protocol::message::{ClientMessage, RefusalReason, ServerMessage};
use protocol::server::Wanted;
use protocol::view::View;
use protocol::{Delivery, control};
use server::ServerConfig;
use server::listener::Shared;
use server::purse::Purse;
use std::sync::Arc;
use std::time::Duration;
use terrain::{ChunkKey, lod};
use tokio::time::{Instant, sleep};

/// A server that grants an address a millisecond of work a second, and with it 1 MiB.
fn shared() -> Arc<Shared> {
    let config = ServerConfig { threads: 1, cost_per_second: Some(1), ..ServerConfig::default() };
    Arc::new(Shared::new(config).unwrap())
}

fn purse(shared: &Shared, address: &str) -> Purse {
    shared.purses.of(Some(address.parse().unwrap()))
}

/// Makes chunks at nobody's cost, so that sessions take no real time.
async fn make(shared: &Shared, keys: &[ChunkKey]) -> usize {
    let mut bytes = 0;
    for key in keys {
        let wanted = Wanted { key: *key, request: None, priority: 0 };
        bytes += shared.generation.flow().frame(wanted, Delivery::Exact).await.unwrap().len();
    }
    bytes
}

/// What came of a session: chunks and refusals, up to as many as are expected.
async fn outcome(peer: &mut Peer, expected: usize) -> (usize, Vec<RefusalReason>) {
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
async fn requests_that_cannot_be_paid_in_time_are_refused_at_once_and_others_are_not() {
    let shared = shared();
    let keys: Vec<ChunkKey> = (0..20).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
    make(&shared, &keys).await;
    let [broke, other] = ["10.0.0.1", "10.0.0.2"].map(|address| purse(&shared, address));
    let mut poor = Peer::welcome(&shared, broke.clone()).await;
    let mut rich = Peer::welcome(&shared, other).await;
    // Another session of the address: what is in a purse, and five seconds' worth more.
    broke.pay_work(15_000, Instant::now());
    let request = ClientMessage::Request { id: 7, keys: keys.iter().map(|key| (*key).into()).collect() };
    let credit = ClientMessage::Credit { chunks: 1000 };
    for peer in [&mut poor, &mut rich] {
        peer.say(&credit).await;
        peer.say(&request).await;
    }
    let asked = Instant::now();
    assert_eq!(outcome(&mut poor, keys.len()).await, (0, vec![RefusalReason::Overloaded; keys.len()]));
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
    assert_eq!(outcome(&mut rich, keys.len()).await, (keys.len(), vec![]));
    assert_eq!(shared.metrics.cost_refusals.get(), keys.len() as u64);

    sleep(Duration::from_secs(6)).await;
    poor.say(&request).await;
    assert_eq!(outcome(&mut poor, keys.len()).await, (keys.len(), vec![]));
}

#[tokio::test(start_paused = true)]
async fn a_view_waits_until_it_is_paid_for_and_is_refused_nothing() {
    let shared = shared();
    let view = View {
        id: 1,
        eye: [0, 60 * 256, 0],
        velocity: [0; 3],
        yaw_mdeg: 0,
        pitch_mdeg: 0,
        fov_mdeg: 60_000,
        viewport: [640, 360],
        tolerance_q4: 16,
        distance_m: 1000,
    };
    let keys: Vec<_> =
        lod::select(&shared.offer.land, &view.viewer(), 10_000).iter().map(|needed| needed.key).collect();
    let bytes = make(&shared, &keys).await;
    assert!(keys.len() > 50);
    let mut took = Vec::new();
    for (address, debt_us) in [("10.0.0.1", 0), ("10.0.0.2", 40_000)] {
        let purse = purse(&shared, address);
        let start = Instant::now();
        purse.pay_work(debt_us, start);
        let mut peer = Peer::welcome(&shared, purse.clone()).await;
        peer.say(&ClientMessage::Credit { chunks: 4096 }).await;
        peer.say(&ClientMessage::View(view)).await;
        assert_eq!(outcome(&mut peer, keys.len()).await, (keys.len(), vec![]));
        took.push(start.elapsed());
        assert!(purse.wait(Instant::now()) < Some(Duration::from_secs(1)), "it overdraws by little");
    }
    assert!(took[0] < Duration::from_secs(1), "the control, with enough in its purse: {took:?}");
    // Thirty seconds for the debt beyond a full purse, and the frames but the last by a MiB a
    // second.
    let least =
        Duration::from_secs(30) + Duration::from_secs_f64((bytes - 30_000) as f64 / f64::from(1 << 20));
    assert!(took[1] >= least && took[1] < least * 2, "{took:?}, at least {least:?}");
    assert!(shared.metrics.cost_waits.get() > 0);
    assert_eq!(shared.metrics.cost_refusals.get(), 0);
}
