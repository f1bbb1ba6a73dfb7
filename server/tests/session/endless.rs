//! A client whose next message is always there.

use crate::peer::{ADDRESS, BINARY, PING, view};
use protocol::message::{ClientMessage, Hello, ServerMessage};
use protocol::{Delivery, control};
use server::ServerConfig;
use server::limits::rate_limit::TokenBucket;
use server::session::driver::{self, READ_LIMIT};
use server::state::ServerState;
use server::websocket::socket::WebSocket;
use std::collections::VecDeque;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::mpsc;

/// Longest time until the test fails instead of waiting for ever.
const GIVE_UP: Duration = Duration::from_secs(60);

/// The server's end of the connection: reads some messages and then pings without end, one at a
/// time, and never waits.
struct Endless {
    first: VecDeque<u8>,
    written: Vec<u8>,
    /// Binary frames of the server.
    frames: mpsc::UnboundedSender<Vec<u8>>,
}

/// A frame of a client, masked by zeros.
fn frame(opcode: u8, payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len()).unwrap();
    let length = match u8::try_from(length) {
        Ok(short @ 0..126) => vec![0x80 | short],
        _ => [&[0x80 | 126][..], &length.to_be_bytes()].concat(),
    };
    [&[0x80 | opcode], &length[..], &[0; 4], payload].concat()
}

impl AsyncRead for Endless {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.first.is_empty() {
            self.first.extend(frame(PING, b""));
        }
        let count = self.first.len().min(buffer.remaining());
        let bytes: Vec<u8> = self.first.drain(..count).collect();
        buffer.put_slice(&bytes);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Endless {
    fn poll_write(mut self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.written.extend_from_slice(bytes);
        while let Some((opcode, payload)) = take_frame(&mut self.written) {
            if opcode == BINARY {
                let _ = self.frames.send(payload);
            }
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

/// The first frame of the server, if it is whole.
fn take_frame(written: &mut Vec<u8>) -> Option<(u8, Vec<u8>)> {
    let (start, length) = match *written.get(1)? {
        126 => (4, usize::from(u16::from_be_bytes(*written.get(2..)?.first_chunk()?))),
        127 => (10, u64::from_be_bytes(*written.get(2..)?.first_chunk()?) as usize),
        short => (2, usize::from(short)),
    };
    let payload = written.get(start..start + length)?.to_vec();
    let opcode = written[0] & 15;
    written.drain(..start + length);
    Some((opcode, payload))
}

/// Its selection and its chunks are finished while the session reads.
#[tokio::test]
async fn a_client_that_sends_without_end_has_its_view() {
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: "test".into() };
    let view = protocol::view::View { tolerance_q4: 4000, ..view(1) };
    let messages =
        [ClientMessage::Hello(hello), ClientMessage::Credit { chunks: 4096 }, ClientMessage::View(view)];
    let first = messages.iter().flat_map(|message| frame(BINARY, &control::encode(message).unwrap()));
    let (frames, mut received) = mpsc::unbounded_channel();
    let stream = Endless { first: first.collect(), written: Vec::new(), frames };
    let server = Arc::clone(&state);
    tokio::spawn(async move {
        let socket = WebSocket::new(stream, &[], READ_LIMIT);
        let open = server.open_sessions.register(1, Some(ADDRESS));
        driver::serve(socket, &server, server.offer.clone(), open, TokenBucket::default(), None).await;
    });
    let settled = async {
        let mut chunks = 0;
        loop {
            let frame = received.recv().await.expect("the session goes on");
            match control::decode::<ServerMessage>(&frame) {
                Ok(ServerMessage::Settled(settled)) => return (chunks, settled.view),
                Ok(_) => {}
                Err(_) => chunks += 1,
            }
        }
    };
    let (chunks, view) = tokio::time::timeout(GIVE_UP, settled).await.expect("the view is settled");
    assert!(chunks > 0 && view == 1, "{chunks} chunks of view {view}");
}
