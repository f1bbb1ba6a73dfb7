//! Messages that are begun and not finished.

use crate::peer::{BINARY, CLOSE, PING, PONG, Peer};
use protocol::message::ClientMessage;
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
    // The control: each piece ends a message and begins the next.
    let mut peer = connected().await;
    let message = frame(0x80 | BINARY, &credit());
    let (head, tail) = message.split_at(3);
    let pieces = std::iter::once(head.to_vec()).chain((0..60).map(|_| [tail, head].concat()));
    assert_eq!(closed(&mut peer, pieces).await, None);
    // Whole messages and control frames.
    let mut peer = connected().await;
    let pieces = (0..60).map(|n| if n % 2 == 0 { message.clone() } else { frame(0x80 | PONG, b"") });
    assert_eq!(closed(&mut peer, pieces).await, None);
}
