//! The thread of a stream: connects, transports the frames of one session after the other, and
//! keeps each connection alive.

use super::socket::{self, SessionEnd, Socket, lost};
use super::{Command, Counters, Settings};
use crate::stream::StreamEvent;
use crate::stream::guarded_session::{GuardedSession, Received, SessionFault};
use crate::stream::trust::Trust;
use futures_util::{SinkExt as _, StreamExt as _};
use protocol::backoff::Backoff;
use protocol::client::ClientConfig;
use protocol::{CloseCode, DataFrame};
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_tungstenite::tungstenite::{self, Message, protocol as ws};

/// Credit window, chunks: enough for a fast server over a round trip of 100 ms.
const WINDOW: u32 = 256;
/// Time limit of the closing handshake.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(300);

/// See the module.
pub struct Worker {
    pub settings: Settings,
    pub events: mpsc::Sender<StreamEvent>,
    pub commands: mpsc::Receiver<Command>,
    pub counters: Arc<Counters>,
}

/// State that outlives a session.
struct Memory {
    backoff: Backoff,
    /// Spreads the requests of missed chunks: other viewers of a server miss the same ones.
    retry_seed: u64,
    trust: Trust,
    /// When the present session began, once the server has welcomed it.
    welcomed: Option<Instant>,
}

impl Worker {
    /// Runs until the viewer closes or the server is given up.
    pub async fn run(mut self) {
        let timeouts = self.settings.timeouts;
        // Process numbers of two machines may be equal; in containers they usually are.
        let random = RandomState::new();
        let [seed, retry_seed] = [0, 1].map(|number| random.hash_one(number));
        let backoff = Backoff::new(timeouts.first_retry, timeouts.longest_retry, seed);
        let mut memory = Memory { backoff, retry_seed, trust: Trust::default(), welcomed: None };
        loop {
            let ended = self.session(&mut memory).await;
            // A server that welcomes and closes at once is not asked again at once.
            let lasted = memory.welcomed.take().map(|welcomed| welcomed.elapsed());
            if lasted.is_some_and(|lasted| lasted > timeouts.longest_retry) {
                memory.backoff.reset();
            }
            self.counters.credits.store(0, Ordering::Relaxed);
            let SessionEnd::Lost { mut cause, mut retry, hint, is_fault } = ended else { return };
            if is_fault && let Err(distrust) = memory.trust.bad(&cause) {
                (cause, retry) = (format!("{}: {distrust}", self.settings.url), false);
            }
            let delay = retry.then(|| hint.unwrap_or_default().max(memory.backoff.next_delay()));
            if self.send_event(StreamEvent::Disconnected { cause, retry: delay }).await.is_err() {
                return;
            }
            let Some(delay) = delay else { return };
            tokio::select! {
                () = sleep(delay) => {}
                () = self.events.closed() => return,
            }
        }
    }

    /// One session, from the connection to its end.
    async fn session(&mut self, memory: &mut Memory) -> SessionEnd {
        let timeouts = self.settings.timeouts;
        let connecting = socket::connect(&self.settings.url, self.settings.tls.as_ref());
        let connected = tokio::select! {
            connected = timeout(timeouts.connect, connecting) => connected,
            () = self.events.closed() => return SessionEnd::Closing,
        };
        let mut socket = match connected {
            Ok(Ok(socket)) => socket,
            Ok(Err(error)) => return socket::not_connected(&self.settings.url, &error),
            Err(_) => {
                return lost(format!("{} does not answer: check host and port", self.settings.url), true);
            }
        };
        // Commands for the previous session.
        while self.commands.try_recv().is_ok() {}
        let config = ClientConfig {
            digest: self.settings.digest,
            delivery: self.settings.delivery,
            token: self.settings.token.clone(),
            software: concat!("tombolo-view ", env!("CARGO_PKG_VERSION")).into(),
            window: WINDOW,
        };
        let delays = (timeouts.first_retry, timeouts.longest_retry);
        let mut session = GuardedSession::new(config, delays, memory.retry_seed);
        let ended = self.run_session(&mut socket, &mut session, memory).await;
        self.counters.add(session.take_rejects());
        let code = match &ended {
            Ok(SessionEnd::Closing) | Err(SessionFault::Restart) => CloseCode::Normal,
            Ok(SessionEnd::Lost { .. }) => return ended.unwrap_or(SessionEnd::Closing),
            Err(SessionFault::Peer(fault)) => fault.close_code(),
            Err(SessionFault::Untrusted(_)) => CloseCode::Malformed,
        };
        let frame = ws::CloseFrame { code: code.code().into(), reason: "".into() };
        // Best effort: a failed closing handshake changes nothing.
        let _ = timeout(CLOSE_TIMEOUT, socket.close(Some(frame))).await;
        ended.unwrap_or_else(|fault| {
            let retry = fault == SessionFault::Restart || code.is_retryable();
            lost(format!("{}: {fault}", self.settings.url), retry)
        })
    }

    async fn run_session(
        &mut self,
        socket: &mut Socket,
        session: &mut GuardedSession,
        memory: &mut Memory,
    ) -> Result<SessionEnd, SessionFault> {
        let (url, timeouts) = (self.settings.url.clone(), self.settings.timeouts);
        let started = Instant::now();
        // Any message; data, or the begin of waiting for it.
        let (mut last_received, mut last_data) = (started, started);
        let mut pings = tokio::time::interval_at(started + timeouts.ping, timeouts.ping);
        let mut hint = None;
        loop {
            session.retry(started.elapsed());
            self.counters.add(session.take_rejects());
            let written = tokio::select! {
                written = timeout(timeouts.write, transmit(socket, session)) => written,
                // The owner does not wait for a server that does not read.
                () = self.events.closed() => return Ok(SessionEnd::Closing),
            };
            match written {
                Ok(Ok(())) => {}
                Ok(Err(error)) => return Ok(socket::broken(&url, &error, hint)),
                Err(_) => return Ok(lost(format!("{url} does not read"), true)),
            }
            self.counters.credits.store(session.credits(), Ordering::Relaxed);
            let next_retry = session.next_retry();
            let limit = if session.is_welcomed() { timeouts.progress } else { timeouts.welcome };
            let awaits_data = session.awaits_data() || !session.is_welcomed();
            let message = tokio::select! {
                message = socket.next() => message,
                command = self.commands.recv() => {
                    if !awaits_data {
                        last_data = Instant::now();
                    }
                    match command {
                        Some(Command::View(view)) => session.set_view(view),
                        Some(Command::Release(keys)) => session.release(&keys),
                        Some(Command::Holding(keys)) => session.holding(&keys),
                        None => return Ok(SessionEnd::Closing),
                    }
                    continue;
                }
                () = at(next_retry.map(|after| started + after)) => continue,
                () = at(awaits_data.then_some(last_data + limit)) => {
                    let what = if session.is_welcomed() { "chunk" } else { "welcome" };
                    return Ok(lost(format!("no {what} from {url} within {limit:?}"), true));
                }
                _ = pings.tick() => {
                    memory.trust.seconds_passed(timeouts.ping.as_secs() as u32);
                    if last_received.elapsed() > timeouts.idle {
                        return Ok(lost(format!("no message from {url} for too long"), true));
                    }
                    match timeout(timeouts.write, socket.feed(Message::Ping(bytes::Bytes::new()))).await {
                        Ok(Ok(())) => {}
                        Ok(Err(error)) => return Ok(socket::broken(&url, &error, hint)),
                        Err(_) => return Ok(lost(format!("{url} does not read"), true)),
                    }
                    continue;
                }
                () = self.events.closed() => return Ok(SessionEnd::Closing),
            };
            last_received = Instant::now();
            let now = started.elapsed();
            let received = match message {
                Some(Ok(Message::Binary(frame))) => {
                    self.counters.bytes.fetch_add(frame.len() as u64, Ordering::Relaxed);
                    session.receive(DataFrame::Binary(&frame), &mut memory.trust, now)?
                }
                Some(Ok(Message::Text(_))) => session.receive(DataFrame::Text, &mut memory.trust, now)?,
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {
                    memory.trust.surplus().map_err(SessionFault::from)?;
                    continue;
                }
                Some(Ok(Message::Close(frame))) => return Ok(socket::closed(&url, frame.as_ref(), hint)),
                Some(Err(error)) => return Ok(socket::broken(&url, &error, hint)),
                None => return Ok(socket::closed(&url, None, hint)),
            };
            let event = match received {
                Received::Event(event) => event,
                Received::Draining(delay) => {
                    hint = Some(delay);
                    continue;
                }
                // Among them the refusal of a chunk that was requested again: a server that refuses
                // for ever sends nothing.
                Received::Nothing => continue,
            };
            if matches!(event, StreamEvent::Connected { .. }) {
                memory.welcomed = Some(Instant::now());
            }
            let is_missed = matches!(event, StreamEvent::Missed { .. });
            let before = Instant::now();
            if self.send_event(event).await.is_err() {
                return Ok(SessionEnd::Closing);
            }
            // The drawing thread may have paused, and nothing was read meanwhile. A chunk that does
            // not come is no progress.
            last_received = Instant::now();
            last_data = if is_missed { last_data + before.elapsed() } else { last_received };
        }
    }

    async fn send_event(&self, event: StreamEvent) -> Result<(), mpsc::error::SendError<StreamEvent>> {
        self.events.send(event).await
    }
}

/// Writes what the session has to send.
async fn transmit(socket: &mut Socket, session: &mut GuardedSession) -> Result<(), tungstenite::Error> {
    while let Some(frame) = session.poll_transmit() {
        socket.feed(Message::Binary(frame)).await?;
    }
    socket.flush().await
}

/// Waits until a time; for ever without one.
async fn at(time: Option<Instant>) {
    match time {
        Some(time) => sleep_until(time).await,
        None => std::future::pending().await,
    }
}
