//! Messages that are begun and not finished.

use crate::peer::{BINARY, CLOSE, PING, PONG, Peer};
use protocol::message::{ClientMessage, WireKey};
use protocol::{CloseCode, control};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::state::ServerState;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};

const SECOND: Duration = Duration::from_secs(1);

async fn connected() -> Peer {
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    Peer::connect(&Arc::new(ServerState::new(config).unwrap()), TokenBucket::default()).await
}

fn credit() -> Vec<u8> {
    control::encode(&ClientMessage::Credit { chunks: 1 }).unwrap().to_vec()
}

/// A masked frame; bit 7 of `first` says that it is the last of its message.
fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let length = u8::try_from(payload.len()).unwrap();
    [&[first, 0x80 | length, 0, 0, 0, 0], payload].concat()
}

/// The code of the Close frame and its second, while pieces are sent one second apart.
async fn closed(peer: &mut Peer, pieces: impl Iterator<Item = Vec<u8>>) -> Option<(u16, u64)> {
    let start = Instant::now();
    for piece in pieces {
        if peer.write(&piece).await.is_err() {
            break;
        }
        sleep(SECOND).await;
        while let Some((opcode, payload)) = peer.next_within(Duration::ZERO).await {
            if opcode == CLOSE {
                return Some((u16::from_be_bytes([payload[0], payload[1]]), start.elapsed().as_secs()));
            }
        }
    }
    None
}

#[tokio::test(start_paused = true)]
async fn a_message_that_comes_byte_by_byte_is_closed_after_five_seconds() {
    let mut peer = connected().await;
    let bytes = frame(0x80 | BINARY, &[0; 100]);
    let end = closed(&mut peer, bytes.iter().map(|byte| vec![*byte])).await;
    assert!(matches!(end, Some((code, 5..=7)) if code == CloseCode::Unresponsive.code()), "{end:?}");
}

#[tokio::test(start_paused = true)]
async fn pings_between_fragments_finish_no_message() {
    let mut peer = connected().await;
    let fragments = std::iter::once(frame(BINARY, &[0]));
    let end = closed(&mut peer, fragments.chain((0..60).map(|_| frame(0x80 | PING, b"?")))).await;
    assert!(matches!(end, Some((code, 5..=7)) if code == CloseCode::Unresponsive.code()), "{end:?}");
}

#[tokio::test(start_paused = true)]
async fn empty_continuation_frames_finish_no_message() {
    let mut peer = connected().await;
    // A hundred of them each second, so that there is never a pause of the frames.
    let pieces = std::iter::once(frame(BINARY, &[0])).chain((0..60).map(|_| frame(0, b"").repeat(100)));
    let end = closed(&mut peer, pieces).await;
    assert!(matches!(end, Some((code, 5..=7)) if code == CloseCode::Unresponsive.code()), "{end:?}");
    // Of a message that has no byte at all.
    let mut peer = connected().await;
    let pieces = std::iter::once(frame(BINARY, b"")).chain((0..60).map(|_| frame(0, b"")));
    let end = closed(&mut peer, pieces).await;
    assert!(matches!(end, Some((code, 5..=7)) if code == CloseCode::Unresponsive.code()), "{end:?}");
    // The control: a last frame ends the message, which is a valid one in fragments.
    let mut peer = connected().await;
    let message = [frame(BINARY, &credit()), frame(0, b"").repeat(100), frame(0x80, b"")].concat();
    assert_eq!(closed(&mut peer, (0..60).map(|_| message.clone())).await, None);
}

#[tokio::test(start_paused = true)]
async fn messages_that_end_in_time_go_on_without_end() {
    let message = frame(0x80 | BINARY, &credit());
    // The control: each piece ends a message or a control frame and begins the next.
    for repeated in [&message, &frame(0x80 | PONG, b"")] {
        let mut peer = connected().await;
        let (head, tail) = repeated.split_at(3);
        let pieces = std::iter::once(head.to_vec()).chain((0..60).map(|_| [tail, head].concat()));
        assert_eq!(closed(&mut peer, pieces).await, None);
    }
    // Whole messages and control frames.
    let mut peer = connected().await;
    let pieces = (0..60).map(|n| if n % 2 == 0 { message.clone() } else { frame(0x80 | PONG, b"") });
    assert_eq!(closed(&mut peer, pieces).await, None);
}

/// A session does not read while it writes: what arrives until the end of a write is in time.
#[tokio::test(start_paused = true)]
async fn a_message_whose_rest_comes_during_a_long_write_is_in_time() {
    const REFUSALS: usize = 128;
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    let mut peer = Peer::over_pipe(&state, TokenBucket::default(), 4096);
    peer.hello().await;
    // More refusals than the pipe holds, and the head of the next message.
    let keys = vec![WireKey { level: 200, x: 0, z: 0 }; REFUSALS];
    let request = control::encode(&ClientMessage::Request { id: 1, keys }).unwrap();
    let length = u16::try_from(request.len()).unwrap().to_be_bytes();
    let credit = frame(0x80 | BINARY, &credit());
    let (head, tail) = credit.split_at(3);
    let begun = [&[0x80 | BINARY, 0x80 | 126], &length[..], &[0; 4], &request, head].concat();
    // The rest and the end of its time are seen at once; which of them comes first is random.
    for round in 0..100 {
        peer.write(&begun).await.unwrap();
        sleep(6 * SECOND).await;
        peer.write(tail).await.unwrap();
        for _ in 0..REFUSALS {
            assert_eq!(peer.next().await.map(|(opcode, _)| opcode), Some(BINARY), "round {round}");
        }
    }
    peer.send(PING, b"?").await;
    assert_eq!(peer.next().await.map(|(opcode, _)| opcode), Some(PONG));
}
