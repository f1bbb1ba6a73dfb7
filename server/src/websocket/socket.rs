//! Batched IO of WebSocket messages: many messages per vectored write, many per read.
//!
//! Payloads are shared, not copied: a cached chunk goes from the cache to the kernel. Reading uses
//! one buffer per thread, so an idle connection holds no read buffer. The bench `framing` compares
//! this with a library that copies each payload and reserves buffers per connection: it needs more
//! memory than the rest of a session, and more CPU for answers to small requests, but not for
//! messages that are pushed in batches.
//!
//! Extensions are not supported. Messages over the limit are rejected.

use crate::websocket::close;
use crate::websocket::frame::{FrameError, Opcode, ServerHeader};
use crate::websocket::inbox::{Inbox, Message};
use bytes::Bytes;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::io::{self, ErrorKind, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Bytes per read: about 400 requests of one key. Their answers are written before more is read.
const READ_BUFFER: usize = 16 * 1024;

/// Slices per write: header and payload of 64 messages, about 300 KiB of exact chunks. Linux
/// accepts up to 1,024.
const MAX_SLICES: usize = 128;

thread_local! {
    /// Never held across an await, so one per thread serves all its connections.
    static READ_SCRATCH: RefCell<Vec<u8>> = RefCell::new(vec![0; READ_BUFFER]);
}

/// A connection after its upgrade.
#[derive(Debug)]
pub struct WebSocket<S> {
    stream: S,
    inbox: Inbox,
    /// Bounded by the caller, which flushes before it queues more.
    outbox: VecDeque<(ServerHeader, Bytes)>,
    /// Bytes of the first message in the outbox that are written already.
    written: usize,
    /// Whether a Close frame is queued or written: no frame may follow it.
    is_closed: bool,
}

impl<S: AsyncRead + AsyncWrite + Unpin> WebSocket<S> {
    /// A WebSocket after its handshake; `early` are the bytes behind the upgrade request. Messages
    /// longer than `limit` bytes are rejected.
    #[must_use]
    pub fn new(stream: S, early: &[u8], limit: usize) -> Self {
        let mut inbox = Inbox::new(limit);
        inbox.extend(early);
        Self { stream, inbox, outbox: VecDeque::new(), written: 0, is_closed: false }
    }

    /// The stream of the connection. Queued frames are lost.
    pub fn into_stream(self) -> S {
        self.stream
    }

    /// Waits for bytes; [`WebSocket::next_message`] returns their messages. Cancel safe.
    ///
    /// # Errors
    /// The connection failed; its end is [`ErrorKind::UnexpectedEof`].
    pub async fn read(&mut self) -> io::Result<()> {
        self.read_at_most(READ_BUFFER).await
    }

    /// As [`WebSocket::read`], but at most `limit` bytes, at least one.
    ///
    /// # Errors
    /// As [`WebSocket::read`].
    pub async fn read_at_most(&mut self, limit: usize) -> io::Result<()> {
        poll_fn(|context| self.poll_read(limit.clamp(1, READ_BUFFER), context)).await
    }

    fn poll_read(&mut self, limit: usize, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        READ_SCRATCH.with_borrow_mut(|scratch| {
            let mut buffer = ReadBuf::new(&mut scratch[..limit]);
            ready!(Pin::new(&mut self.stream).poll_read(context, &mut buffer))?;
            Poll::Ready(match buffer.filled() {
                [] => Err(ErrorKind::UnexpectedEof.into()),
                bytes => {
                    self.inbox.extend(bytes);
                    Ok(())
                }
            })
        })
    }

    /// The next message of the bytes read; none if it is incomplete.
    ///
    /// # Errors
    /// The client broke RFC 6455.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, FrameError> {
        self.inbox.next_message()
    }

    /// Whether the bytes read end within a message, once [`WebSocket::next_message`] has returned
    /// none.
    #[must_use]
    pub const fn is_in_message(&self) -> bool {
        self.inbox.is_in_message()
    }

    /// Whether some fragments of a message have come, and not its last one.
    #[must_use]
    pub const fn is_fragmented(&self) -> bool {
        self.inbox.is_fragmented()
    }

    /// Queues a binary message for the next flush.
    pub fn queue(&mut self, payload: Bytes) {
        self.queue_as(Opcode::Binary, payload);
    }

    /// Queues a frame of another kind. A control frame's payload must have at most 125 bytes.
    /// Behind a Close frame nothing is queued.
    pub fn queue_as(&mut self, opcode: Opcode, payload: Bytes) {
        if !self.is_closed {
            self.is_closed = opcode == Opcode::Close;
            self.outbox.push_back((ServerHeader::new(opcode, payload.len()), payload));
        }
    }

    /// Whether messages are queued.
    #[must_use]
    pub fn has_queued(&self) -> bool {
        !self.outbox.is_empty()
    }

    /// Writes all queued messages. After a cancellation, a later call resumes at the same byte.
    ///
    /// # Errors
    /// The connection failed.
    pub async fn flush(&mut self) -> io::Result<()> {
        self.flush_part(usize::MAX).await.map(drop)
    }

    /// As [`WebSocket::flush`], until at least `least` bytes are written; whether all are.
    ///
    /// # Errors
    /// As [`WebSocket::flush`].
    pub async fn flush_part(&mut self, least: usize) -> io::Result<bool> {
        let mut written = 0;
        while !self.outbox.is_empty() {
            if written >= least {
                // TLS takes bytes before the peer does.
                self.flush_stream().await?;
                return Ok(false);
            }
            let count = poll_fn(|context| self.poll_write(context)).await?;
            if count == 0 {
                return Err(ErrorKind::WriteZero.into());
            }
            self.advance(count);
            written += count;
        }
        // TLS may hold the last bytes back.
        self.flush_stream().await?;
        // Releases the memory of a burst.
        if self.outbox.capacity() > 4 * MAX_SLICES {
            self.outbox = VecDeque::new();
        }
        Ok(true)
    }

    async fn flush_stream(&mut self) -> io::Result<()> {
        poll_fn(|context| Pin::new(&mut self.stream).poll_flush(context)).await
    }

    /// Removes queued messages, except one that is written in part.
    pub fn drop_unwritten(&mut self) {
        self.outbox.truncate(usize::from(self.written > 0));
    }

    fn poll_write(&mut self, context: &mut Context<'_>) -> Poll<io::Result<usize>> {
        let mut slices = [IoSlice::new(&[]); MAX_SLICES];
        let mut count = 0;
        let mut skip = self.written;
        for (header, payload) in &self.outbox {
            if count + 2 > MAX_SLICES {
                break;
            }
            for slice in [header.as_bytes(), payload] {
                let rest = &slice[skip.min(slice.len())..];
                skip -= slice.len() - rest.len();
                if !rest.is_empty() {
                    slices[count] = IoSlice::new(rest);
                    count += 1;
                }
            }
        }
        Pin::new(&mut self.stream).poll_write_vectored(context, &slices[..count])
    }

    /// Removes written bytes from the outbox.
    fn advance(&mut self, count: usize) {
        self.written += count;
        while let Some((header, payload)) = self.outbox.front() {
            let length = header.as_bytes().len() + payload.len();
            if self.written < length {
                break;
            }
            self.written -= length;
            self.outbox.pop_front();
        }
    }

    /// Queues a Close frame, the last frame of this side. A reason beyond 123 bytes is cut.
    pub fn queue_close(&mut self, code: u16, reason: &str) {
        self.queue_as(Opcode::Close, close::payload(code, reason));
    }

    /// Ends a connection whose Close frame is written. RFC 6455, section 7.1.1: it ends after both
    /// Close frames, or after a violation. Then everything is read and discarded until the peer
    /// ends its side: closing with unread input would reset the connection, which discards what the
    /// peer has not read, our Close frame included. The caller has the deadline.
    pub async fn end(&mut self) {
        // A proxy ends the client's side as soon as this side ends, with whatever it has not yet
        // delivered.
        while !self.inbox.has_ended() {
            let is_empty = matches!(self.inbox.next_message(), Ok(None));
            if is_empty && self.read().await.is_err() {
                return;
            }
        }
        self.shut_down().await;
        while self.read().await.is_ok() {}
    }

    /// Closes the sending half.
    async fn shut_down(&mut self) {
        let _ = poll_fn(|context| Pin::new(&mut self.stream).poll_shutdown(context)).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio_tungstenite::WebSocketStream;
    use tokio_tungstenite::tungstenite::Message as PeerMessage;
    use tokio_tungstenite::tungstenite::protocol::Role;

    /// A stream that writes up to 7 bytes at a time and is never ready twice in a row.
    struct PartialStream {
        written: Vec<u8>,
        ready: bool,
    }

    impl AsyncRead for PartialStream {
        fn poll_read(self: Pin<&mut Self>, _: &mut Context<'_>, _: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    impl AsyncWrite for PartialStream {
        fn poll_write(
            mut self: Pin<&mut Self>,
            context: &mut Context<'_>,
            bytes: &[u8],
        ) -> Poll<io::Result<usize>> {
            self.ready = !self.ready;
            if !self.ready {
                context.waker().wake_by_ref();
                return Poll::Pending;
            }
            let count = bytes.len().min(7);
            self.written.extend_from_slice(&bytes[..count]);
            Poll::Ready(Ok(count))
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    #[tokio::test]
    async fn messages_survive_partial_writes() {
        let mut socket = WebSocket::new(PartialStream { written: Vec::new(), ready: false }, &[], 100);
        let mut expected = Vec::new();
        for length in [0usize, 1, 5, 125, 126, 300].repeat(40) {
            let payload = Bytes::from(vec![length as u8; length]);
            expected.extend_from_slice(ServerHeader::new(Opcode::Binary, length).as_bytes());
            expected.extend_from_slice(&payload);
            socket.queue(payload);
        }
        socket.flush().await.unwrap();
        assert!(!socket.has_queued());
        assert!(socket.stream.written == expected);
        assert_eq!(socket.read().await.unwrap_err().kind(), ErrorKind::UnexpectedEof);
    }

    #[tokio::test]
    async fn it_interoperates_with_tungstenite() {
        use futures_util::{SinkExt, StreamExt};
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (near, far) = tokio::join!(tokio::net::TcpStream::connect(address), listener.accept());
        let mut theirs = WebSocketStream::from_raw_socket(near.unwrap(), Role::Client, None).await;
        let mut ours = WebSocket::new(far.unwrap().0, &[], 1 << 20);
        let payloads: Vec<Bytes> = [0usize, 1, 125, 126, 5000, 65_535, 65_536, 200_000]
            .map(|length| Bytes::from(vec![length as u8; length]))
            .into();
        for payload in &payloads {
            ours.queue(payload.clone());
        }
        let (flushed, ()) = tokio::join!(ours.flush(), async {
            for payload in &payloads {
                assert_eq!(theirs.next().await.unwrap().unwrap(), PeerMessage::Binary(payload.clone()));
            }
        });
        flushed.unwrap();
        for payload in &payloads {
            let (sent, ()) = tokio::join!(theirs.send(PeerMessage::Binary(payload.clone())), async {
                loop {
                    if let Some(message) = ours.next_message().unwrap() {
                        assert_eq!(message, Message::Binary(payload));
                        return;
                    }
                    ours.read().await.unwrap();
                }
            });
            sent.unwrap();
        }
    }
}
