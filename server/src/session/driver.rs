//! The loop of one session. Its steps are in the files of this folder: `chunks` requests and
//! collects chunks, `receive` reads messages, `transmit` writes them, `counts` counts.
//!
//! Each round requests chunks from the generation service, writes all pending messages in one
//! flush, and waits for the next event. Nothing is read during a write, so a client that does not
//! read cannot make the server collect answers; a write that takes too long ends the session.

mod chunks;
mod counts;
mod receive;
mod transmit;

use crate::generation::{Flow, FlowEvent};
use crate::limits::rate_limit::TokenBucket;
use crate::open_sessions::{Eviction, OpenSession};
use crate::session::chunk_traces::ChunkTraces;
use crate::session::end::{EndReason, SessionEnd};
use crate::session::keepalive::{Keepalive, KeepaliveAction};
use crate::session::message_deadline::MessageDeadline;
use crate::session::refusal_backoff::RefusalBackoff;
use crate::state::ServerState;
use crate::traces::Parent;
use crate::websocket::frame::Opcode;
use crate::websocket::socket::WebSocket;
use bytes::Bytes;
use protocol::CloseCode;
use protocol::limits::MAX_CONTROL_FRAME;
use protocol::server::{ServerOffer, ServerSession, SessionCounts};
use std::time::Duration;
use terrain::ChunkKey;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::task::yield_now;
use tokio::time::{Instant, timeout};

/// The longest message that is read. Above the protocol's limit, so that the protocol rejects a
/// message slightly over its limit.
pub const READ_LIMIT: usize = 8 * MAX_CONTROL_FRAME;

/// Time for the Close frame, the peer's answer and the end of the connection. A peer that is
/// still sending then is cut off.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// A closed session.
#[derive(Debug)]
pub struct ClosedSession<S> {
    /// Why: the first reason.
    pub reason: EndReason,
    /// Why the server ended it, or cut its end short; none if it did neither.
    pub eviction: Option<Eviction>,
    /// The stream, not yet dropped.
    pub stream: S,
    /// When its refusal back-off ends, which may be after the session.
    pub backoff_until: Instant,
}

/// Runs one session to its end and counts it. Its work is charged to `bucket`; its chunks belong to
/// the trace of `parent`.
pub async fn serve<S>(
    socket: WebSocket<S>,
    state: &ServerState,
    offer: ServerOffer,
    stats: OpenSession,
    bucket: TokenBucket,
    parent: Option<Parent>,
) -> ClosedSession<S>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    state.metrics.sessions.open.inc();
    let number = stats.number();
    tracing::debug!(session = number, "session opened");
    // Boxed, and a block: so the future of an idle session stays small.
    let mut rest = Box::new({
        let mut driver = Driver {
            socket,
            state,
            session: ServerSession::new(offer, number),
            flow: state.generation.session(stats.site(), bucket),
            message_deadline: MessageDeadline::default(),
            delay: None,
            backoff: RefusalBackoff::new(Instant::now()),
            counted: SessionCounts::default(),
            stats,
            traces: ChunkTraces::new(parent),
            in_generation: Vec::new(),
            unwritten: Vec::new(),
            batch: 0,
            is_draining: false,
        };
        let end = driver.run().await;
        driver.update_metrics();
        let Driver { socket, stats, backoff, .. } = driver;
        Remaining { socket, stats, end, backoff_until: backoff.until() }
    });
    let Remaining { socket, stats, end, .. } = &mut *rest;
    tracing::debug!(session = number, reason = end.reason.name(), "session ended");
    if let Some((code, text)) = &end.close {
        socket.queue_close(*code, text);
        tokio::select! {
            biased;
            // At once. The first reason stays.
            _ = stats.evicted() => {}
            _ = timeout(CLOSE_TIMEOUT, close(socket)) => {}
        }
    }
    state.metrics.sessions.ended(end.reason.name());
    state.metrics.sessions.open.dec();
    let Remaining { socket, stats, end, backoff_until } = *rest;
    ClosedSession {
        reason: end.reason,
        eviction: stats.eviction(),
        stream: socket.into_stream(),
        backoff_until,
    }
}

/// The remaining state of a session while its peer answers the Close frame: all else is free
/// already.
struct Remaining<S> {
    socket: WebSocket<S>,
    stats: OpenSession,
    end: SessionEnd,
    backoff_until: Instant,
}

/// Sends a Close frame and waits for the peer to end the connection, so that what was written
/// arrives.
async fn close<S: AsyncRead + AsyncWrite + Unpin>(socket: &mut WebSocket<S>) {
    if socket.flush().await.is_ok() {
        socket.end().await;
    }
}

/// The condition that a session waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Delay {
    /// Until its token bucket is no longer empty.
    RateLimit,
    /// Until it looks again whether there is memory.
    Memory,
}

struct Driver<'a, S> {
    socket: WebSocket<S>,
    state: &'a ServerState,
    session: ServerSession,
    /// Chunks in generation, at most [`chunks::JOB_WINDOW`]; nothing more is requested while it is
    /// full.
    flow: Flow,
    /// Until when a view or a chunk waits, if one does, and for what.
    delay: Option<(Instant, Delay)>,
    /// Limits when the session is read.
    backoff: RefusalBackoff,
    /// When an unfinished message must be complete.
    message_deadline: MessageDeadline,
    /// The part of the session's counts that the metrics contain.
    counted: SessionCounts,
    /// Figures for the page.
    stats: OpenSession,
    /// Spans of the traced chunks.
    traces: ChunkTraces,
    /// Start times of the chunks in generation. At most [`chunks::JOB_WINDOW`].
    in_generation: Vec<(ChunkKey, Instant)>,
    /// Start times and numbers of the chunks in the next flush. At most [`chunks::JOB_WINDOW`] and
    /// one batch.
    unwritten: Vec<(Instant, u64)>,
    /// Cached chunks in the next flush, at most [`chunks::BATCH`].
    batch: u32,
    /// Whether the end of the server is announced to the peer.
    is_draining: bool,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Driver<'_, S> {
    async fn run(&mut self) -> SessionEnd {
        let config = &self.state.config;
        let handshake_by = Instant::now() + config.handshake_timeout;
        let mut keepalive = Keepalive::new(config.ping_interval, Instant::now());
        // Reset only when it fires: activity must not cost a timer each time.
        let check = tokio::time::sleep_until(keepalive.check(Instant::now()).1);
        tokio::pin!(check);
        // Bytes behind the upgrade request are in the inbox already.
        if let Err(end) = self.read_ended(Ok(())).await {
            return end;
        }
        loop {
            // In each round, because reading goes first below: a client that sends without end must
            // not keep finished work waiting.
            while let Some(event) = self.flow.try_event() {
                self.handle(event);
            }
            let more = self.request_chunks();
            if let Err(end) = self.flush().await {
                return end;
            }
            let pause = self.backoff.paused_until(Instant::now());
            self.flow.set_paused(pause.is_some());
            let read_size = self.backoff.read_size(Instant::now());
            // In order, so that a seed of the simulation is one run: ends, timers, and then what a
            // client can cause without end. Reading goes before finished work, which comes without
            // end while a slow write lasts.
            tokio::select! {
                biased;
                () = self.state.draining.cancelled() => return self.drain().await,
                eviction = self.stats.evicted() => return SessionEnd::by_server(eviction),
                () = tokio::time::sleep_until(handshake_by), if !self.session.is_welcomed() => {
                    return SessionEnd::with_code(EndReason::HandshakeTimeout, CloseCode::HandshakeTimeout);
                }
                () = sleep_until(self.message_deadline.by()), if pause.is_none() => {
                    if let Err(end) = self.enforce_message_deadline().await {
                        return end;
                    }
                }
                () = &mut check => {
                    // Received bytes count: a long write may have kept this session from reading.
                    if keepalive.check(Instant::now()).0 == KeepaliveAction::Close
                        && let Some(read) = self.read_now().await
                    {
                        keepalive.on_activity(Instant::now());
                        if let Err(end) = self.read_ended(read).await {
                            return end;
                        }
                    }
                    let (action, next) = keepalive.check(Instant::now());
                    match action {
                        KeepaliveAction::None => {}
                        // Written by the following flush.
                        KeepaliveAction::Ping => {
                            self.socket.queue_as(Opcode::Ping, Bytes::new());
                            keepalive.on_ping();
                        }
                        KeepaliveAction::Close => {
                            let code = CloseCode::Unresponsive;
                            return SessionEnd::with_code(EndReason::KeepaliveTimeout, code);
                        }
                    }
                    check.as_mut().reset(next);
                }
                () = sleep_until(pause), if pause.is_some() => {}
                // One timer: each takes memory of an idle session.
                () = sleep_until(self.delay.map(|(until, _)| until)), if self.delay.is_some() => {
                    let is_by_rate = self.delay.is_some_and(|(_, delay)| delay == Delay::RateLimit);
                    self.state.metrics.limits.rate_limit_delays.inc_by(u64::from(is_by_rate));
                }
                read = self.socket.read_at_most(read_size), if pause.is_none() => {
                    keepalive.on_activity(Instant::now());
                    if let Err(end) = self.read_ended(read).await {
                        return end;
                    }
                    let begins = self.backoff.pause(Instant::now());
                    self.count_pause(begins);
                }
                event = self.flow.next_event() => self.handle(event),
                // A client that reads cached chunks at full speed must not starve others; between
                // two batches it is read, and a shutdown ends it.
                () = yield_now(), if more => {}
            }
        }
    }

    /// Handles finished work of the generation service.
    fn handle(&mut self, event: FlowEvent) {
        match event {
            FlowEvent::View(selection) => self.apply_view(*selection),
            FlowEvent::ViewFailed => self.session.fail_view("the selection of the view failed"),
            FlowEvent::Chunks(done) => done.into_iter().for_each(|done| self.finish(done)),
        }
    }
}

/// Waits until a moment; forever if there is none.
async fn sleep_until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment).await,
        None => std::future::pending().await,
    }
}
