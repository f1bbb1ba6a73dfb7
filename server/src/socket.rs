//! One client: a socket around the sans-IO session.
//!
//! The loop does three things in turn: asks the session what to make and hands that to the generation service, writes what the
//! session has to say in one flush, and waits for whatever comes first. It reads nothing while a write is under way, so a
//! client that does not read cannot make it collect answers; a write that takes too long ends the session.

use crate::generation::GenerationError;
use crate::listener::Shared;
use crate::metrics::{DeliveryLabel, Reason};
use axum::extract::ws::{CloseFrame, Message};
use bytes::Bytes;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;
use futures_util::{FutureExt, Sink, SinkExt, Stream, StreamExt};
use protocol::limits::MAX_CONTROL_FRAME;
use protocol::message::RefusalReason;
use protocol::server::{ServerSession, SessionCounts, Wanted};
use protocol::{CloseCode, Incoming};
use std::time::Duration;
use tokio::time::{Instant, timeout};

/// Chunks of one session that may be in generation at once. More would let one client fill the queue and would order
/// its chunks by an old view.
const JOB_WINDOW: usize = 16;

/// Chunks collected before they are written out: about 256 KiB of exact frames, one flush.
const BATCH: usize = 48;

/// Chunks in generation, each with the asking that it answers.
type Jobs = FuturesUnordered<BoxFuture<'static, (Wanted, Result<Bytes, GenerationError>)>>;

/// Why a session ended, and what its peer is told.
#[derive(Clone, Debug, PartialEq, Eq)]
struct End {
    /// Label in the metrics and logs.
    reason: &'static str,
    /// Close frame to send, if the socket may still take one.
    close: Option<(CloseCode, String)>,
}

/// Drives one session to its end and counts it.
pub async fn serve<S, E>(socket: S, shared: &Shared, number: u64)
where
    S: Stream<Item = Result<Message, E>> + Sink<Message, Error = E> + Unpin,
    E: std::fmt::Display,
{
    shared.metrics.sessions.inc();
    tracing::debug!(session = number, "session opened");
    let mut driver = Driver {
        socket,
        shared,
        number,
        session: ServerSession::new(shared.offer.clone(), number),
        counted: SessionCounts::default(),
    };
    let end = driver.run().await;
    tracing::debug!(session = number, reason = end.reason, "session ended");
    if let Some((code, text)) = end.close {
        driver.close(code, &text).await;
    }
    shared.metrics.session_ends.get_or_create(&Reason { reason: end.reason }).inc();
    shared.metrics.sessions.dec();
}

struct Driver<'a, S> {
    socket: S,
    shared: &'a Shared,
    number: u64,
    session: ServerSession,
    /// What of the session's counts is in the metrics already.
    counted: SessionCounts,
}

impl<S, E> Driver<'_, S>
where
    S: Stream<Item = Result<Message, E>> + Sink<Message, Error = E> + Unpin,
    E: std::fmt::Display,
{
    async fn run(&mut self) -> End {
        let config = &self.shared.config;
        let handshake_by = Instant::now() + config.handshake_timeout;
        let mut heard = Instant::now();
        let mut ping = tokio::time::interval(config.ping_interval);
        ping.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        ping.tick().await;
        // At most JOB_WINDOW; the session asks for no more while it is full.
        let mut jobs = Jobs::new();
        loop {
            loop {
                let more = self.start_jobs(&mut jobs);
                if let Err(end) = self.flush().await {
                    return end;
                }
                if !more {
                    break;
                }
            }
            tokio::select! {
                frame = self.socket.next() => {
                    heard = Instant::now();
                    if let Err(end) = self.receive(frame) {
                        // A last message may explain the close.
                        let _ = self.flush().await;
                        return end;
                    }
                }
                Some((wanted, result)) = jobs.next(), if !jobs.is_empty() => {
                    self.finish(wanted, result);
                    while let Some(Some((wanted, result))) = jobs.next().now_or_never() {
                        self.finish(wanted, result);
                    }
                }
                () = self.shared.draining.cancelled() => return self.drain().await,
                () = tokio::time::sleep_until(handshake_by), if !self.session.is_welcomed() => {
                    return End::tell("handshake timeout", CloseCode::HandshakeTimeout);
                }
                _ = ping.tick() => {
                    if heard.elapsed() >= 3 * config.ping_interval {
                        return End::tell("silent", CloseCode::Unresponsive);
                    }
                    if heard.elapsed() >= config.ping_interval
                        && let Err(end) = self.write(Message::Ping(Bytes::new())).await
                    {
                        return end;
                    }
                }
            }
        }
    }

    /// Hands wanted chunks to the generation service, and cached ones straight back to the session. True if it stopped
    /// only to let a full batch be written.
    fn start_jobs(&mut self, jobs: &mut Jobs) -> bool {
        let (mut batch, delivery) = (0, self.session.delivery());
        while jobs.len() < JOB_WINDOW {
            if batch == BATCH {
                return true;
            }
            let Some(wanted) = self.session.next_chunk() else { return false };
            if let Some(frame) = self.shared.generation.cached(wanted.key, delivery) {
                self.session.deliver(wanted, frame);
                batch += 1;
                continue;
            }
            let generation = self.shared.generation.clone();
            let make = async move {
                let frame = generation.frame(wanted.key, delivery, wanted.priority).await;
                (wanted, frame)
            };
            jobs.push(make.boxed());
        }
        false
    }

    fn receive(&mut self, frame: Option<Result<Message, E>>) -> Result<(), End> {
        let result = match frame {
            Some(Ok(Message::Binary(bytes))) if bytes.len() > MAX_CONTROL_FRAME => {
                return Err(End::tell("too large", CloseCode::TooLarge));
            }
            Some(Ok(Message::Binary(bytes))) => self.session.receive(Incoming::Binary(&bytes)),
            Some(Ok(Message::Text(_))) => self.session.receive(Incoming::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => Ok(()),
            Some(Ok(Message::Close(_))) | None => return Err(End { reason: "closed", close: None }),
            // Not a WebSocket frame, one beyond the read limit, or a broken connection; the close frame may not arrive.
            Some(Err(error)) => {
                return Err(End {
                    reason: "read failed",
                    close: Some((CloseCode::Malformed, error.to_string())),
                });
            }
        };
        result.map_err(|fault| {
            let code = fault.close_code();
            End { reason: reason(code), close: Some((code, fault.to_string())) }
        })
    }

    fn finish(&mut self, wanted: Wanted, result: Result<Bytes, GenerationError>) {
        match result {
            Ok(frame) => self.session.deliver(wanted, frame),
            Err(GenerationError::Overloaded) => {
                self.session.fail(wanted, RefusalReason::Overloaded, GenerationError::Overloaded.to_string());
            }
            Err(GenerationError::Failed) => {
                self.session.fail(wanted, RefusalReason::Failed, GenerationError::Failed.to_string());
            }
        }
    }

    /// Writes everything that the session has to say, in one flush.
    async fn flush(&mut self) -> Result<(), End> {
        let Some(first) = self.session.poll_transmit() else { return Ok(()) };
        let (socket, session) = (&mut self.socket, &mut self.session);
        let mut bytes = 0;
        let write = async {
            let mut next = Some(first);
            while let Some(frame) = next {
                bytes += frame.len() as u64;
                socket.feed(Message::Binary(frame)).await?;
                next = session.poll_transmit();
            }
            socket.flush().await
        };
        let result = within(self.shared.config.write_timeout, write).await;
        self.shared.metrics.bytes_sent.inc_by(bytes);
        self.count();
        result
    }

    async fn write(&mut self, message: Message) -> Result<(), End> {
        within(self.shared.config.write_timeout, self.socket.send(message)).await
    }

    /// Says goodbye: when to come back, spread so that not all clients return at once.
    async fn drain(&mut self) -> End {
        let jitter = terrain::hash::mix(self.number as u32) % 1500;
        self.session.drain(500 + jitter);
        let _ = self.flush().await;
        End::tell("drained", CloseCode::GoingAway)
    }

    /// Sends the close frame and waits briefly for the peer's, so that what was written before it arrives.
    async fn close(&mut self, code: CloseCode, text: &str) {
        // RFC 6455, section 5.5: a control frame holds 125 bytes, two of them the code.
        let text = &text[..text.floor_char_boundary(123)];
        let frame = Message::Close(Some(CloseFrame { code: code.code(), reason: text.into() }));
        if self.write(frame).await.is_err() {
            return;
        }
        let peer_closes = async { while let Some(Ok(_)) = self.socket.next().await {} };
        let _ = timeout(Duration::from_secs(1), peer_closes).await;
    }

    /// Carries the session's counts into the server's metrics.
    fn count(&mut self) {
        let (now, before, metrics) = (self.session.counts(), self.counted, &self.shared.metrics);
        metrics.chunks_sent.inc_by(now.chunks - before.chunks);
        if now.chunks > before.chunks {
            let label = DeliveryLabel { delivery: self.session.delivery().name() };
            metrics.chunks_delivered.get_or_create(&label).inc_by(now.chunks - before.chunks);
            metrics.chunk_bytes_delivered.get_or_create(&label).inc_by(now.chunk_bytes - before.chunk_bytes);
        }
        metrics.refusals.inc_by(now.refusals - before.refusals);
        metrics.views.inc_by(now.views - before.views);
        self.counted = now;
    }
}

impl End {
    fn tell(reason: &'static str, code: CloseCode) -> Self {
        Self { reason, close: Some((code, code.to_string())) }
    }
}

/// Runs a write under the deadline. A peer that does not read in time is not told: it would not read that either.
async fn within<E>(deadline: Duration, write: impl Future<Output = Result<(), E>>) -> Result<(), End> {
    match timeout(deadline, write).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(End { reason: "write failed", close: None }),
        Err(_) => Err(End { reason: "not reading", close: None }),
    }
}

const fn reason(code: CloseCode) -> &'static str {
    match code {
        CloseCode::Malformed => "malformed",
        CloseCode::TextFrame => "text frame",
        CloseCode::TooLarge => "too large",
        CloseCode::OutOfOrder => "out of order",
        CloseCode::WrongVersion => "wrong version",
        CloseCode::WrongWorld => "wrong world",
        CloseCode::Unauthorised => "unauthorised",
        _ => "other fault",
    }
}
