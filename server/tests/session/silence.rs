//! When a peer that says nothing is ended.

use crate::peer::{CLOSE, PING, PONG, Peer};
use protocol::CloseCode;
use server::ServerConfig;
use server::listener::Shared;
use server::purse::Purse;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};

fn shared() -> Arc<Shared> {
    Arc::new(Shared::new(ServerConfig { threads: 1, ..ServerConfig::default() }).unwrap())
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
async fn whoever_says_nothing_after_its_hello_is_ended_after_a_minute() {
    for delay_ms in [0, 50, 3000] {
        let mut peer = Peer::new(&shared(), Purse::default());
        // Some way into the session, which must not count as silence.
        sleep(Duration::from_millis(delay_ms)).await;
        let start = Instant::now();
        peer.hello().await;
        let (pings, end, code) = follow(&mut peer, start).await;
        assert_eq!((pings, end, code), (vec![20, 40], 60, CloseCode::Unresponsive.code()), "{delay_ms} ms");
    }
}

#[tokio::test(start_paused = true)]
async fn whoever_answers_pings_stays() {
    let (shared, start) = (shared(), Instant::now());
    let mut peer = Peer::welcome(&shared, Purse::default()).await;
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
    // The control: it stops answering.
    assert_eq!(follow(&mut peer, start).await.2, CloseCode::Unresponsive.code());
}

#[tokio::test(start_paused = true)]
async fn whoever_does_not_even_say_hello_is_ended_sooner() {
    let start = Instant::now();
    let mut peer = Peer::new(&shared(), Purse::default());
    assert_eq!(follow(&mut peer, start).await, (vec![], 5, CloseCode::HandshakeTimeout.code()));
}
