//! The loop of one session.
//!
//! Each round requests chunks from the generation service, writes all pending messages in one
//! flush, and waits for the next event. Nothing is read during a write, so a client that does not
//! read cannot make the server collect answers; a write that takes too long ends the session.

use crate::generation::{Completion, Flow, FlowEvent, GenerationError};
use crate::limits::rate_limit::TokenBucket;
use crate::mechanism::Mechanism;
use crate::open_sessions::{Ending, OpenSession};
use crate::session::chunk_traces::ChunkTraces;
use crate::session::end::{EndReason, SessionEnd, write_within};
use crate::session::keepalive::{Keepalive, KeepaliveAction};
use crate::session::message_deadline::MessageDeadline;
use crate::session::refusal_backoff::{PauseCount, RefusalBackoff, Rejections};
use crate::state::ServerState;
use crate::traces::Parent;
use crate::websocket::frame::Opcode;
use crate::websocket::inbox::Message;
use crate::websocket::socket::WebSocket;
use bytes::Bytes;
use protocol::limits::MAX_CONTROL_FRAME;
use protocol::message::RefusalReason;
use protocol::server::ViewSelection;
use protocol::server::{Next, ServerOffer, ServerSession, SessionCounts};
use protocol::{CloseCode, DataFrame};
use std::io;
use std::sync::atomic::Ordering;
use std::time::Duration;
use terrain::ChunkKey;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::task::yield_now;
use tokio::time::{Instant, timeout};

/// Chunks of one session in generation at once. A larger window would order chunks by an outdated
/// view; a smaller one would not fill the session's turns.
const JOB_WINDOW: usize = 16;

/// Cached chunks collected before a flush: about 300 KiB of exact frames, one write.
const BATCH: u32 = 64;

/// Chunks of a step of a view that is selected at once.
const SELECTION_STEP: usize = 4096;

/// Time until a session looks again whether there is memory for its view and its chunks.
const MEMORY_PAUSE: Duration = Duration::from_millis(100);

/// The longest message that is read. Above the protocol's limit, so that the protocol rejects a
/// message slightly over its limit.
pub const READ_LIMIT: usize = 8 * MAX_CONTROL_FRAME;

/// Least number of bytes that a peer must take within
/// [`crate::config::ServerConfig::write_timeout`]: a reader of 6.5 KB a second keeps its session,
/// whatever the length of a batch.
const WRITE_PROGRESS: usize = 64 * 1024;

/// Time for the Close frame, the peer's answer and the end of the connection. A peer that sends
/// until then is cut off.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Bounds of the reconnect delay sent on shutdown, milliseconds. Random, so that clients do not all
/// return at once.
const RECONNECT_MS: (u32, u32) = (500, 2000);

/// A session that has ended.
#[derive(Debug)]
pub struct Ended<S> {
    /// Why.
    pub reason: EndReason,
    /// The stream, not yet dropped.
    pub stream: S,
    /// When its refusal back-off would have ended: until then its client must not have its place
    /// for another session, or the debt would end with the session.
    pub owes_until: Instant,
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
) -> Ended<S>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    state.metrics.sessions.open.inc();
    let number = stats.number();
    tracing::debug!(session = number, "session opened");
    // Boxed, and a block: an idle session must not have room for what comes after it.
    let mut rest = Box::new({
        let mut driver = Driver {
            socket,
            state,
            session: ServerSession::new(offer, number),
            flow: state.generation.session(stats.site(), bucket),
            message_deadline: MessageDeadline::default(),
            delay: None,
            backoff: RefusalBackoff::new(Instant::now()),
            pause_count: PauseCount::new(&state.paused_sessions),
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
        Remaining { socket, stats, end, owes_until: backoff.debt_until() }
    });
    let Remaining { socket, stats, end, .. } = &mut *rest;
    tracing::debug!(session = number, reason = end.reason.name(), "session ended");
    if let Some((code, text)) = &end.close {
        socket.queue_close(*code, text);
        tokio::select! {
            _ = timeout(CLOSE_TIMEOUT, close(socket)) => {}
            // However it has to end: at once.
            _ = stats.ends() => end.reason = EndReason::MemoryShed,
        }
    }
    state.metrics.sessions.ended(end.reason.name());
    state.metrics.sessions.open.dec();
    let Remaining { socket, end, owes_until, .. } = *rest;
    Ended { reason: end.reason, stream: socket.into_stream(), owes_until }
}

/// The end of a session that has done nothing wrong.
fn ended_by_server(ending: Ending) -> SessionEnd {
    match ending {
        // Without a Close frame, whose answer would keep the memory.
        Ending::Memory => SessionEnd::without_code(EndReason::MemoryShed),
        Ending::Displaced => SessionEnd::with_code(EndReason::Displaced, CloseCode::GoingAway),
    }
}

/// The remaining state of a session while its peer answers the Close frame: all else is free
/// already.
struct Remaining<S> {
    socket: WebSocket<S>,
    stats: OpenSession,
    end: SessionEnd,
    owes_until: Instant,
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
    /// Chunks in generation, at most [`JOB_WINDOW`]; nothing more is requested while it is full.
    flow: Flow,
    /// Until when a view or a chunk waits, if one does, and for what.
    delay: Option<(Instant, Delay)>,
    /// Whether the session is read.
    backoff: RefusalBackoff,
    /// Counted while it is not.
    pause_count: PauseCount<'a>,
    /// When an unfinished message must be complete.
    message_deadline: MessageDeadline,
    /// The part of the session's counts that the metrics contain.
    counted: SessionCounts,
    /// Figures for the page.
    stats: OpenSession,
    /// Spans of the traced chunks.
    traces: ChunkTraces,
    /// Start times of the chunks in generation. At most [`JOB_WINDOW`].
    in_generation: Vec<(ChunkKey, Instant)>,
    /// Start times and numbers of the chunks in the next flush. At most [`JOB_WINDOW`] and one
    /// batch.
    unwritten: Vec<(Instant, u64)>,
    /// Cached chunks in the next flush, at most [`BATCH`].
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
            let more = self.request_chunks();
            if let Err(end) = self.flush().await {
                return end;
            }
            let pause = self.backoff.paused_until(Instant::now());
            self.pause_count.set(pause.is_some());
            let read_size = self.backoff.read_size(Instant::now());
            tokio::select! {
                read = self.socket.read_at_most(read_size), if pause.is_none() => {
                    keepalive.on_activity(Instant::now());
                    if let Err(end) = self.read_ended(read).await {
                        return end;
                    }
                    let begins = self.backoff.pause(Instant::now());
                    self.state.metrics.limits.refusal_backoffs.inc_by(u64::from(begins));
                }
                () = sleep_until(self.message_deadline.by()), if pause.is_none() => {
                    if let Err(end) = self.finish_message().await {
                        return end;
                    }
                }
                event = self.flow.next_event() => {
                    match event {
                        FlowEvent::View(selection) => self.apply_view(*selection),
                        FlowEvent::ViewFailed => {
                            self.session.fail_view("the selection of the view failed");
                        }
                        FlowEvent::Chunks(done) => done.into_iter().for_each(|done| self.finish(done)),
                    }
                    while let Some(done) = self.flow.try_completions() {
                        done.into_iter().for_each(|done| self.finish(done));
                    }
                }
                () = self.state.draining.cancelled() => return self.drain().await,
                ending = self.stats.ends() => return ended_by_server(ending),
                // A client that reads cached chunks at full speed must not starve others; between
                // two batches it is read, and a shutdown ends it.
                () = yield_now(), if more => {}
                () = tokio::time::sleep_until(handshake_by), if !self.session.is_welcomed() => {
                    return SessionEnd::with_code(EndReason::HandshakeTimeout, CloseCode::HandshakeTimeout);
                }
                () = sleep_until(pause), if pause.is_some() => {}
                // One timer: each takes memory of an idle session.
                () = sleep_until(self.delay.map(|(until, _)| until)), if self.delay.is_some() => {
                    let is_by_rate = self.delay.is_some_and(|(_, delay)| delay == Delay::RateLimit);
                    self.state.metrics.limits.rate_limit_delays.inc_by(u64::from(is_by_rate));
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
                        KeepaliveAction::Ping => self.socket.queue_as(Opcode::Ping, Bytes::new()),
                        KeepaliveAction::Close => {
                            let code = CloseCode::Unresponsive;
                            return SessionEnd::with_code(EndReason::KeepaliveTimeout, code);
                        }
                    }
                    check.as_mut().reset(next);
                }
            }
        }
    }

    /// Handles the bytes of a read.
    async fn read_ended(&mut self, read: io::Result<()>) -> Result<(), SessionEnd> {
        let received = match read {
            Ok(()) => self.receive().await,
            Err(error) => Err(SessionEnd::read_failed(&error)),
        };
        let Err(end) = received else { return Ok(()) };
        Err(self.ended(end).await)
    }

    /// An end after what is queued is written: the last message may explain it. A peer that takes
    /// none of it gets no Close frame, either.
    async fn ended(&mut self, end: SessionEnd) -> SessionEnd {
        match self.flush().await {
            Err(failed) if failed.reason.leaves_unread_bytes() => failed,
            _ => end,
        }
    }

    /// Ends a session whose message takes too long. Bytes received by now count: a long write may
    /// have kept this session from reading.
    async fn finish_message(&mut self) -> Result<(), SessionEnd> {
        if let Some(read) = self.read_now().await {
            self.read_ended(read).await?;
        }
        if self.message_deadline.has_passed(Instant::now()) {
            return Err(SessionEnd::with_code(EndReason::MessageTimeout, CloseCode::Unresponsive));
        }
        Ok(())
    }

    /// Reads what has arrived; none if nothing has.
    async fn read_now(&mut self) -> Option<io::Result<()>> {
        timeout(Duration::ZERO, self.socket.read()).await.ok()
    }

    /// Requests chunks from the generation service; cached ones go straight to the session. True if
    /// it stopped only to let a full batch be written.
    fn request_chunks(&mut self) -> bool {
        let (before, now) = (self.batch, Instant::now());
        let mut more = false;
        // Nothing is delayed in an idle session, which needs no timer.
        self.delay = None;
        if self.state.memory.is_exceeded() {
            // The tables of a view and chunks that wait for a write take memory.
            let waits = self.session.has_waiting_view() || self.session.has_next_chunk();
            self.delay = waits.then(|| (now + MEMORY_PAUSE, Delay::Memory));
            return false;
        }
        match self.flow.bucket().delay(now) {
            None => {
                if let Some(selection) = self.session.take_view() {
                    self.select_view(selection);
                }
            }
            Some(delay) if self.session.has_waiting_view() => {
                self.delay = Some((now + delay, Delay::RateLimit));
            }
            Some(_) => {}
        }
        while self.flow.in_flight() < JOB_WINDOW {
            if self.batch == BATCH {
                more = true;
                break;
            }
            if let Some(delay) = self.flow.bucket().delay(now) {
                if self.session.has_next_chunk() {
                    self.delay = Some((now + delay, Delay::RateLimit));
                }
                break;
            }
            match self.session.next_chunk_with(|key, delivery| self.flow.cached(key, delivery)) {
                Next::Nothing => break,
                Next::Delivered => self.batch += 1,
                Next::Generate(chunk, delivery) => {
                    self.in_generation.push((chunk.key, now));
                    let span = self.traces.begin(&self.state.traces, chunk.key, delivery);
                    span.in_scope(|| self.flow.request(chunk, delivery));
                }
            }
        }
        let delivered = self.batch - before;
        if delivered > 0 {
            self.unwritten.push((now, u64::from(delivered)));
        }
        more
    }

    /// Handles all messages read, cancels outdated requests, and rejects requests that cannot be
    /// served in time.
    async fn receive(&mut self) -> Result<(), SessionEnd> {
        let admitted = self.session.waiting_requests();
        let mut has_ended = false;
        while let Some(is_data) = self.receive_message().await? {
            // Behind a control frame that is not between fragments another message begins.
            has_ended |= is_data || !self.socket.is_fragmented();
            yield_now().await;
        }
        let by = Instant::now() + self.state.config.message_timeout;
        self.message_deadline.record(has_ended, self.socket.is_in_message(), by);
        self.cancel_stale();
        // With a full window, waiting requests wait for the service, not for credit.
        if self.fill_window() {
            // Requests admitted before stay: a rejection is useful only if it comes at once.
            self.session.shed(self.state.generation.allowance(&self.flow).max(admitted));
        }
        if self.flow.bucket().is_limited() {
            let (waiting, deadline) = (self.session.waiting_requests(), self.state.config.deadline);
            let affordable = self.flow.bucket().affordable_chunks(deadline, Instant::now());
            self.session.shed(affordable.max(admitted));
            let rejected = waiting - self.session.waiting_requests();
            self.state.metrics.limits.rate_limit_rejections.inc_by(rejected as u64);
        }
        // Views may be superseded without anything to write.
        if self.session.counts() != self.counted {
            self.update_metrics();
        }
        Ok(())
    }

    /// Selects a view's chunks in turns on the generation threads, or at once where a measurement
    /// asks what that would cost.
    fn select_view(&mut self, mut selection: ViewSelection) {
        let land = self.state.offer.land;
        if self.state.config.without != Some(Mechanism::ViewTurns) {
            return self.flow.select(selection, land);
        }
        while !selection.step(&land, SELECTION_STEP) {}
        self.apply_view(selection);
    }

    /// Applies a finished selection and cancels what only the previous view needed.
    fn apply_view(&mut self, selection: ViewSelection) {
        self.stats.set_view(selection.view());
        self.session.apply_view(selection);
        self.cancel_stale();
    }

    fn cancel_stale(&mut self) {
        for key in self.session.take_stale() {
            for chunk in self.flow.cancel(key) {
                self.end_generation(chunk.key);
                self.traces.end(chunk.key, "cancelled");
                self.session.withdraw(chunk);
            }
        }
    }

    /// Requests chunks; true if the window is full afterwards.
    fn fill_window(&mut self) -> bool {
        // A full batch of cached chunks is no sign of overload.
        !self.request_chunks() && self.flow.in_flight() >= JOB_WINDOW
    }

    /// Handles one message; whether it was data, none if there is none.
    async fn receive_message(&mut self) -> Result<Option<bool>, SessionEnd> {
        let incoming = match self.socket.next_message() {
            Ok(None) => return Ok(None),
            Ok(Some(Message::Binary(bytes))) if bytes.len() > MAX_CONTROL_FRAME => {
                return Err(SessionEnd::with_code(EndReason::TooLarge, CloseCode::TooLarge));
            }
            Ok(Some(Message::Binary(bytes))) => DataFrame::Binary(bytes),
            Ok(Some(Message::Text(_))) => DataFrame::Text,
            Ok(Some(Message::Ping(payload))) => {
                let payload = Bytes::copy_from_slice(payload);
                self.socket.queue_as(Opcode::Pong, payload);
                return Ok(Some(false));
            }
            Ok(Some(Message::Pong)) => return Ok(Some(false)),
            Ok(Some(Message::Close(close))) => return Err(SessionEnd::answered(close.answer())),
            Err(fault) => {
                let code = CloseCode::from_code(fault.close_code()).unwrap_or(CloseCode::ProtocolError);
                return Err(SessionEnd::protocol_error(code, fault.to_string()));
            }
        };
        self.session
            .receive(incoming)
            .map(|()| Some(true))
            .map_err(|fault| SessionEnd::protocol_error(fault.close_code(), fault.to_string()))
    }

    fn finish(&mut self, (chunk, result): Completion) {
        let since = self.end_generation(chunk.key);
        match result {
            Ok(frame) => {
                self.session.deliver(chunk, frame);
                self.traces.deliver(chunk.key);
                self.unwritten.extend(since.map(|since| (since, 1)));
            }
            Err(error) => {
                let (reason, outcome) = match error {
                    GenerationError::Overloaded => (RefusalReason::Overloaded, "overloaded"),
                    GenerationError::Failed => (RefusalReason::Failed, "failed"),
                };
                self.session.fail(chunk, reason, error.to_string());
                self.traces.end(chunk.key, outcome);
            }
        }
    }

    /// Removes a chunk from those in generation; returns its start time.
    fn end_generation(&mut self, key: ChunkKey) -> Option<Instant> {
        let index = self.in_generation.iter().position(|(other, _)| *other == key)?;
        Some(self.in_generation.swap_remove(index).1)
    }

    /// Writes all messages of the session in one flush.
    async fn flush(&mut self) -> Result<(), SessionEnd> {
        let mut bytes = 0;
        while let Some(frame) = self.session.poll_transmit() {
            bytes += frame.len() as u64;
            self.socket.queue(frame);
        }
        if !self.socket.has_queued() {
            return Ok(());
        }
        let write = async {
            while !write_within(self.state.config.write_timeout, self.socket.flush_part(WRITE_PROGRESS))
                .await?
            {}
            Ok(())
        };
        let result = tokio::select! {
            written = write => written,
            ending = self.stats.ends() => Err(ended_by_server(ending)),
            // A slow reader must not miss the announcement.
            () = self.state.draining.cancelled(), if !self.is_draining => {
                self.socket.drop_unwritten();
                Ok(())
            }
        };
        self.batch = 0;
        self.traces.flushed(result.is_ok());
        self.state.metrics.sessions.sent_bytes.inc_by(bytes);
        if result.is_ok() {
            let now = Instant::now();
            for (since, count) in self.unwritten.drain(..) {
                self.state.metrics.sessions.latency.observe(now - since, count);
            }
        }
        self.update_metrics();
        result
    }

    /// Announces the shutdown with a reconnect delay.
    async fn drain(&mut self) -> SessionEnd {
        let (min_ms, max_ms) = RECONNECT_MS;
        let jitter_ms = terrain::hash::mix(self.stats.number() as u32) % (max_ms - min_ms);
        self.session.drain(min_ms + jitter_ms);
        self.is_draining = true;
        self.ended(SessionEnd::with_code(EndReason::Drained, CloseCode::GoingAway)).await
    }

    /// Adds the session's new counts to the server's metrics.
    fn update_metrics(&mut self) {
        let (now, before, metrics) = (self.session.counts(), self.counted, &self.state.metrics);
        if now.chunks > before.chunks {
            let (chunks, bytes) = (now.chunks - before.chunks, now.chunk_bytes - before.chunk_bytes);
            metrics.sessions.count_chunks(self.session.delivery(), chunks, bytes);
        }
        let superseded = now.superseded_views - before.superseded_views;
        let rejections = Rejections::since(&before, &now);
        if rejections != Rejections::default() {
            let paused = self.state.paused_sessions.load(Ordering::Relaxed);
            let sharers = self.state.generation.sharers(&self.flow);
            let sharers = sharers.max(paused.div_ceil(self.state.config.threads));
            // A rate limit bounds the work of rejections as well.
            let sharers = sharers.max(self.flow.bucket().thread_shares());
            let backs_off = self.state.config.without != Some(Mechanism::RefusalBackoff);
            let begins = backs_off && self.backoff.record(rejections, sharers, Instant::now());
            metrics.limits.refusal_backoffs.inc_by(u64::from(begins));
            for reason in RefusalReason::ALL {
                let count = now.refusals[reason.index()] - before.refusals[reason.index()];
                metrics.limits.request_rejected(reason, count);
            }
        }
        metrics.generation.views_selected.inc_by(now.views - before.views);
        metrics.generation.views_superseded.inc_by(superseded);
        self.stats.set_sent(now.chunks, now.chunk_bytes);
        self.counted = now;
    }
}

/// Waits until a moment; forever if there is none.
async fn sleep_until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment).await,
        None => std::future::pending().await,
    }
}
