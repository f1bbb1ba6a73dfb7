//! One client: a WebSocket around the sans-IO session.
//!
//! The loop does three things in turn: asks the session what to make and hands that to the
//! generation service, writes what the session has to say in one flush, and waits for whatever
//! comes first. It reads nothing while a write is under way, so a client that does not read cannot
//! make it collect answers; a write that takes too long ends the session.

use crate::generation::{Done, Flow, FlowAnswer, GenerationError};
use crate::heed::Heed;
use crate::listener::Shared;
use crate::live::Seated;
use crate::metrics::{DeliveryLabel, Reason};
use crate::purse::Purse;
use crate::silence::{Due, Silence};
use crate::websocket::WebSocket;
use crate::websocket::frame::{Fault, MAX_CONTROL_PAYLOAD, Opcode};
use crate::websocket::inbox::Message;
use bytes::Bytes;
use protocol::limits::MAX_CONTROL_FRAME;
use protocol::message::RefusalReason;
use protocol::server::{Next, ServerSession, SessionCounts};
use protocol::view_selection::ViewSelection;
use protocol::{CloseCode, Incoming};
use std::io;
use std::time::Duration;
use terrain::ChunkKey;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::{Instant, timeout};

/// Chunks of one session that may be in generation at once. More would order its chunks by an old
/// view; fewer would not fill its turn of the service.
const JOB_WINDOW: usize = 16;

/// Cached chunks collected before they are written out: about 300 KiB of exact frames, one write.
const BATCH: usize = 64;

/// The longest message that is read before it is refused by size. Above the protocol's limit, so
/// that a client that exceeds the limit a little has its frame judged by the protocol.
pub const READ_LIMIT: usize = 8 * MAX_CONTROL_FRAME;

/// Why a session ended, and what its peer is told.
#[derive(Clone, Debug, PartialEq, Eq)]
struct End {
    /// Label in the metrics and logs.
    reason: &'static str,
    /// Close frame to send, if the socket may still take one.
    close: Option<(CloseCode, String)>,
}

/// Drives one session to its end and counts it. What it costs is taken out of a purse.
pub async fn serve<S>(socket: WebSocket<S>, shared: &Shared, number: u64, purse: Purse)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    shared.metrics.sessions.inc();
    tracing::debug!(session = number, "session opened");
    let mut driver = Driver {
        socket,
        shared,
        number,
        session: ServerSession::new(shared.offer.clone(), number),
        flow: shared.generation.flow_paid_by(purse),
        broke_until: None,
        heed: Heed::new(Instant::now()),
        counted: SessionCounts::default(),
        seat: shared.live.sit(number),
        taken: Vec::new(),
        unwritten: Vec::new(),
    };
    let end = driver.run().await;
    tracing::debug!(session = number, reason = end.reason, "session ended");
    if let Some((code, text)) = end.close {
        driver.close(code, &text).await;
    }
    driver.count();
    shared.metrics.session_ends.get_or_create(&Reason { reason: end.reason }).inc();
    shared.metrics.sessions.dec();
}

struct Driver<'a, S> {
    socket: WebSocket<S>,
    shared: &'a Shared,
    number: u64,
    session: ServerSession,
    /// Chunks in generation: at most [`JOB_WINDOW`]; the session asks for no more while it is full.
    flow: Flow,
    /// Until when nothing more is asked for, because the purse is empty.
    broke_until: Option<Instant>,
    /// Whether it is listened to.
    heed: Heed,
    /// What of the session's counts is in the metrics already.
    counted: SessionCounts,
    /// What others may know of this session.
    seat: Seated,
    /// Since when each chunk in generation is taken up. At most [`JOB_WINDOW`].
    taken: Vec<(ChunkKey, Instant)>,
    /// Since when chunks that wait for the next flush were taken up, and how many. At most
    /// [`JOB_WINDOW`] and one batch.
    unwritten: Vec<(Instant, u64)>,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Driver<'_, S> {
    async fn run(&mut self) -> End {
        let config = &self.shared.config;
        let handshake_by = Instant::now() + config.handshake_timeout;
        let mut silence = Silence::new(config.ping_interval, Instant::now());
        // Moved on only when it is reached: a peer that speaks often must not cost a timer each
        // time.
        let look = tokio::time::sleep_until(silence.at(Instant::now()).1);
        tokio::pin!(look);
        // What came behind the upgrade's request is here already.
        if let Err(end) = self.receive().await {
            return end;
        }
        loop {
            loop {
                let more = self.start_jobs();
                if let Err(end) = self.flush().await {
                    return end;
                }
                if !more {
                    break;
                }
                // A client that takes cached chunks as fast as they can be written is one of many.
                tokio::task::yield_now().await;
            }
            let pause = self.heed.pause(Instant::now());
            tokio::select! {
                read = self.socket.read(), if pause.is_none() => {
                    silence.broken(Instant::now());
                    let received = match read {
                        Ok(()) => self.receive().await,
                        Err(error) => Err(End::lost(&error)),
                    };
                    if let Err(end) = received {
                        // A last message may explain the close.
                        let _ = self.flush().await;
                        return end;
                    }
                }
                answer = self.flow.next_answer() => {
                    match answer {
                        FlowAnswer::View(selection) => self.apply_view(*selection),
                        FlowAnswer::Chunks(done) => done.into_iter().for_each(|done| self.finish(done)),
                    }
                    while let Some(done) = self.flow.try_answers() {
                        done.into_iter().for_each(|done| self.finish(done));
                    }
                }
                () = self.shared.draining.cancelled() => return self.drain().await,
                () = tokio::time::sleep_until(handshake_by), if !self.session.is_welcomed() => {
                    return End::tell("handshake timeout", CloseCode::HandshakeTimeout);
                }
                () = sleep_until(pause), if pause.is_some() => {}
                () = sleep_until(self.broke_until), if self.broke_until.is_some() => {
                    self.shared.metrics.cost_waits.inc();
                }
                () = &mut look => {
                    let (due, next) = silence.at(Instant::now());
                    match due {
                        Due::Nothing => {}
                        // Written by the flush that follows.
                        Due::Ping => self.socket.queue_as(Opcode::Ping, Bytes::new()),
                        Due::End => return End::tell("silent", CloseCode::Unresponsive),
                    }
                    look.as_mut().reset(next);
                }
            }
        }
    }

    /// Hands wanted chunks to the generation service, and cached ones straight back to the session.
    /// True if it stopped only to let a full batch be written.
    fn start_jobs(&mut self) -> bool {
        let (mut batch, now) = (0, Instant::now());
        let mut more = false;
        self.broke_until = self.flow.purse().wait(now).map(|wait| now + wait);
        if self.broke_until.is_none()
            && let Some(selection) = self.session.take_view()
        {
            self.flow.select(selection, self.shared.offer.land);
        }
        while self.flow.open() < JOB_WINDOW {
            if batch == BATCH {
                more = true;
                break;
            }
            if let Some(wait) = self.flow.purse().wait(now) {
                self.broke_until = Some(now + wait);
                break;
            }
            match self.session.next_chunk_with(|key, delivery| self.flow.cached(key, delivery)) {
                Next::Nothing => break,
                Next::Delivered => batch += 1,
                Next::Make(wanted, delivery) => {
                    self.taken.push((wanted.key, now));
                    self.flow.ask(wanted, delivery);
                }
            }
        }
        if batch > 0 {
            self.unwritten.push((now, batch as u64));
        }
        more
    }

    /// Takes everything that was read, and then sees to what it made stale or what there is too
    /// much of.
    async fn receive(&mut self) -> Result<(), End> {
        let admitted = self.session.waiting_requests();
        while self.receive_message().await? {
            // Whatever a peer sends, other tasks of this thread run between two of its messages.
            tokio::task::yield_now().await;
        }
        self.withdraw_stale();
        // Full window: what waits behind it waits for the service, not for credit.
        if self.start_jobs_until_full() {
            // What was let in before stays: a refusal is worth something only if it comes at once.
            self.session.shed(self.shared.generation.allowance().max(admitted));
        }
        if self.flow.purse().is_limited() {
            let (waiting, deadline) = (self.session.waiting_requests(), self.shared.config.deadline);
            self.session.shed(self.flow.purse().affords(deadline, Instant::now()).max(admitted));
            let refused = waiting - self.session.waiting_requests();
            self.shared.metrics.cost_refusals.inc_by(refused as u64);
        }
        // Views may be replaced without anything to write.
        if self.session.counts() != self.counted {
            self.count();
        }
        Ok(())
    }

    /// Takes a finished selection, and withdraws what only the view before it needed.
    fn apply_view(&mut self, selection: ViewSelection) {
        self.seat.moved(selection.view());
        self.session.apply_view(selection);
        self.withdraw_stale();
    }

    fn withdraw_stale(&mut self) {
        for key in self.session.take_stale() {
            for wanted in self.flow.withdraw(key) {
                self.take_off(wanted.key);
                self.session.withdraw(wanted);
            }
        }
    }

    /// Whether the window is full once what can be started is.
    fn start_jobs_until_full(&mut self) -> bool {
        // A batch that is full of cached chunks is no sign of overload.
        !self.start_jobs() && self.flow.open() >= JOB_WINDOW
    }

    /// Takes one message; false when there is none.
    async fn receive_message(&mut self) -> Result<bool, End> {
        let incoming = match self.socket.next_message() {
            Ok(None) => return Ok(false),
            Ok(Some(Message::Binary(bytes))) if bytes.len() > MAX_CONTROL_FRAME => {
                return Err(End::tell("too large", CloseCode::TooLarge));
            }
            Ok(Some(Message::Binary(bytes))) => Incoming::Binary(bytes),
            Ok(Some(Message::Text)) => Incoming::Text,
            Ok(Some(Message::Ping(payload))) => {
                let payload = Bytes::copy_from_slice(payload);
                self.socket.queue_as(Opcode::Pong, payload);
                return Ok(true);
            }
            Ok(Some(Message::Pong)) => return Ok(true),
            Ok(Some(Message::Close(_))) => {
                // RFC 6455, section 5.5.1: the answer to a good-bye is one. Nothing that goes wrong
                // with it matters.
                self.socket
                    .queue_as(Opcode::Close, Bytes::copy_from_slice(&CloseCode::Normal.code().to_be_bytes()));
                let _ = within(self.shared.config.write_timeout, self.socket.flush()).await;
                self.socket.shut_down().await;
                return Err(End { reason: "closed", close: None });
            }
            Err(fault) => {
                let (reason, code) = match fault {
                    Fault::TooLong(_) => ("too large", CloseCode::TooLarge),
                    _ => ("malformed", CloseCode::Malformed),
                };
                return Err(End { reason, close: Some((code, fault.to_string())) });
            }
        };
        self.session.receive(incoming).map(|()| true).map_err(|fault| {
            let code = fault.close_code();
            End { reason: reason(code), close: Some((code, fault.to_string())) }
        })
    }

    fn finish(&mut self, (wanted, result): Done) {
        let since = self.take_off(wanted.key);
        match result {
            Ok(frame) => {
                self.session.deliver(wanted, frame);
                self.unwritten.extend(since.map(|since| (since, 1)));
            }
            Err(error) => {
                let reason = match error {
                    GenerationError::Overloaded => RefusalReason::Overloaded,
                    GenerationError::Failed => RefusalReason::Failed,
                };
                self.session.fail(wanted, reason, error.to_string());
            }
        }
    }

    /// A chunk is in generation no more; tells since when it was.
    fn take_off(&mut self, key: ChunkKey) -> Option<Instant> {
        let index = self.taken.iter().position(|(taken, _)| *taken == key)?;
        Some(self.taken.swap_remove(index).1)
    }

    /// Writes everything that the session has to say, in one flush.
    async fn flush(&mut self) -> Result<(), End> {
        let mut bytes = 0;
        while let Some(frame) = self.session.poll_transmit() {
            bytes += frame.len() as u64;
            self.socket.queue(frame);
        }
        if !self.socket.has_queued() {
            return Ok(());
        }
        let result = within(self.shared.config.write_timeout, self.socket.flush()).await;
        self.shared.metrics.bytes_sent.inc_by(bytes);
        if result.is_ok() {
            let now = Instant::now();
            for (since, count) in self.unwritten.drain(..) {
                self.shared.metrics.latency.observe(now - since, count);
            }
        }
        self.count();
        result
    }

    /// Says goodbye: when to come back, spread so that not all clients return at once.
    async fn drain(&mut self) -> End {
        let jitter = terrain::hash::mix(self.number as u32) % 1500;
        self.session.drain(500 + jitter);
        let _ = self.flush().await;
        End::tell("drained", CloseCode::GoingAway)
    }

    /// Sends the close frame and waits briefly for the peer to go, so that what was written before
    /// it arrives.
    async fn close(&mut self, code: CloseCode, text: &str) {
        let text = &text[..text.floor_char_boundary(MAX_CONTROL_PAYLOAD - 2)];
        let payload = [&code.code().to_be_bytes(), text.as_bytes()].concat();
        self.socket.queue_as(Opcode::Close, payload.into());
        if within(self.shared.config.write_timeout, self.socket.flush()).await.is_err() {
            return;
        }
        self.socket.shut_down().await;
        let _ = timeout(Duration::from_secs(1), self.socket.drain()).await;
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
        let superseded = now.superseded_views - before.superseded_views;
        if now.refusals != before.refusals || superseded > 0 {
            // A view that nobody selects costs what a refusal costs.
            let more = superseded + now.refusals.iter().sum::<u64>() - before.refusals.iter().sum::<u64>();
            // Where an address has a purse, what it is refused is bounded by it as well.
            let sharers = self.shared.generation.sharers().max(self.flow.purse().sharers());
            let begins = self.heed.refused(more, sharers, Instant::now());
            metrics.refusal_pauses.inc_by(u64::from(begins));
            for reason in RefusalReason::ALL {
                let more = now.refusals[reason.index()] - before.refusals[reason.index()];
                metrics.refused(reason, more);
            }
        }
        metrics.views.inc_by(now.views - before.views);
        metrics.superseded_views.inc_by(superseded);
        self.seat.sent(now.chunks, now.chunk_bytes);
        self.counted = now;
    }
}

impl End {
    fn tell(reason: &'static str, code: CloseCode) -> Self {
        Self { reason, close: Some((code, code.to_string())) }
    }

    fn lost(error: &io::Error) -> Self {
        let reason = if error.kind() == io::ErrorKind::UnexpectedEof { "closed" } else { "read failed" };
        Self { reason, close: None }
    }
}

/// Runs a write under the deadline. A peer that does not read in time is not told: it would not
/// read that either.
async fn within(deadline: Duration, write: impl Future<Output = io::Result<()>>) -> Result<(), End> {
    match timeout(deadline, write).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(End { reason: "write failed", close: None }),
        Err(_) => Err(End { reason: "not reading", close: None }),
    }
}

/// Waits until a moment; for ever without one.
async fn sleep_until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment).await,
        None => std::future::pending().await,
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
