//! One session over WebSocket: admission, main loop, closing handshake.
//!
//! The protocol runs in [`ClientSession`]; this file transports its frames and measures time. Views
//! and requests are in `actions`, the WebSocket is in `socket`.

mod actions;
mod socket;

pub use actions::view_of;
pub use socket::{Socket, connect, transmit};

use crate::SOFTWARE;
use crate::checker::ChunkChecker;
use crate::dial::Dial;
use crate::expected::{ChunkStatus, ExpectedChunks, MAX_VIEWS, MAX_VIEWS_SLOW};
use crate::held::MAX_HELD;
use crate::keys::Keys;
use crate::path::FlightPath;
use crate::released::ReleasedChunks;
use crate::request_pause::RequestPause;
use crate::resume::Resumption;
use crate::schedule::Schedule;
use crate::task::{GRACE, HANDSHAKE_TIMEOUT, STALL_TIMEOUT, SessionEnd, Task};
use crate::verify::Mismatch;
use actions::Poses;
use futures_util::StreamExt;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_CREDITS;
use protocol::message::{RefusalReason, Settled, Welcome};
use protocol::peer_text::one_line;
use protocol::{CloseCode, DataFrame, Delivery, PeerFault};
use socket::lost;
use std::pin::pin;
use std::time::Duration;
use terrain::{Chunk, Land, WorldDigest};
use tokio::time::{Instant, sleep_until, timeout};
use tokio_tungstenite::tungstenite::{Error, Message};

/// Credit window, chunks. Enough to hide a round trip, few enough that a new view takes effect
/// soon.
const WINDOW: u32 = 64;

/// The same for a slow client: the maximum, so that credit never limits what the server has to
/// send.
const WINDOW_SLOW: u32 = MAX_CREDITS;

/// A request that is not answered at the end of its session counts as a latency if it has waited so
/// long. A younger one is counted as unanswered only.
pub const MIN_ABANDONED_WAIT: Duration = Duration::from_secs(1);

/// Longest time to read the frames that arrived before a write failed.
const LAST_FRAMES_WITHIN: Duration = Duration::from_secs(1);

/// Frames after which a session yields. A frame takes about 0.1 ms to decode or generate and
/// verify; without yielding a burst would delay the clocks of all sessions.
const YIELD_EVERY: u32 = 16;

/// One settled view in this number is checked for missing chunks. The check repeats the selection.
const CHECKED_VIEWS: u32 = 8;

/// One session from connect to close. The chunks of an earlier one are reported to the server.
pub async fn run<D: Dial>(
    task: &Task<'_, D>,
    schedule: &mut Schedule,
    resumption: &mut Resumption,
) -> SessionEnd {
    let started = Instant::now();
    let mut session = match task.until(task.end, Session::admit(task, resumption)).await {
        Some(Ok(session)) => session,
        Some(Err(end)) => return end,
        // The phase ended during admission; no session was lost.
        None => {
            task.ended_in_admission(started);
            return SessionEnd::Finished;
        }
    };
    let outcome = session.run(schedule).await;
    session.count_unanswered(schedule.is_open());
    if matches!(outcome, SessionEnd::Finished) {
        session.count_stall();
    }
    outcome
}

/// An admitted client.
struct Session<'t, 'a, D: Dial> {
    task: &'t Task<'a, D>,
    resumption: &'t mut Resumption,
    socket: Socket<D::Stream>,
    machine: ClientSession,
    land: Land,
    expected: ExpectedChunks,
    checker: ChunkChecker,
    path: FlightPath,
    keys: Keys,
    poses: Poses,
    /// After refusals, in a closed loop.
    pause: RequestPause,
    /// When a frame arrived, or the session began.
    last_frame: Instant,
    /// The newest view when something was refused: what was refused may belong to it or an older
    /// one.
    refused_view: Option<u32>,
    released: ReleasedChunks,
}

impl<'t, 'a, D: Dial> Session<'t, 'a, D> {
    /// Connects and waits for the Welcome.
    async fn admit(task: &'t Task<'a, D>, resumption: &'t mut Resumption) -> Result<Self, SessionEnd> {
        let config = task.config;
        let mut socket = connect(task).await?;
        let mut machine = ClientSession::new(ClientConfig {
            digest: None,
            delivery: config.delivery,
            token: config.token.clone(),
            software: SOFTWARE.into(),
            window: if task.read_rate.is_some() { WINDOW_SLOW } else { WINDOW },
        });
        transmit(&mut socket, &mut machine).await.map_err(SessionEnd::not_admitted)?;
        let welcome = timeout(HANDSHAKE_TIMEOUT, welcome(&mut socket, &mut machine))
            .await
            .map_err(|_| SessionEnd::not_admitted(format!("no Welcome within {HANDSHAKE_TIMEOUT:?}")))??;
        let land = world_of(&welcome, task).map_err(|mismatch| SessionEnd::wrong_world(&mismatch))?;
        task.admitted();
        if resumption.begin(WorldDigest(welcome.digest)) && config.resume {
            machine.holding(&resumption.held.keys());
        }
        let sample = (config.verify_every, task.index);
        let path = task.path(&land);
        Ok(Self {
            task,
            resumption,
            socket,
            machine,
            land,
            expected: ExpectedChunks::new(
                land,
                if task.read_rate.is_some() { MAX_VIEWS_SLOW } else { MAX_VIEWS },
            ),
            checker: ChunkChecker::new(land, config.delivery, sample, task.counters, task.regeneration),
            path,
            keys: Keys::new(config.path, config.seed, task.index, path),
            poses: Poses::default(),
            pause: RequestPause::new(task.delay_seed()),
            last_frame: Instant::now(),
            refused_view: None,
            released: ReleasedChunks::default(),
        })
    }

    /// Follows the schedule until the end of the phase or of the session.
    async fn run(&mut self, schedule: &mut Schedule) -> SessionEnd {
        let mut frames = 0u32;
        let mut stop = self.task.end;
        let mut interrupted = pin!(self.task.interrupt.cancelled());
        loop {
            let sent = transmit(&mut self.socket, &mut self.machine);
            if let Some(Err(problem)) = self.task.interrupt.run_until_cancelled(sent).await {
                let is_open = schedule.is_open();
                let read = timeout(LAST_FRAMES_WITHIN, self.read_last_frames(&problem, is_open)).await;
                return read.unwrap_or(SessionEnd::Lost(problem));
            }
            let outstanding = self.outstanding(schedule.waits_for_views());
            if schedule.is_done() && outstanding == 0 && Instant::now() >= self.task.end {
                self.close(CloseCode::Normal).await;
                return SessionEnd::Finished;
            }
            let is_paused = schedule.is_closed() && self.pause.is_paused();
            tokio::select! {
                frame = self.socket.next() => {
                    frames = frames.wrapping_add(1);
                    if frames.is_multiple_of(YIELD_EVERY) {
                        tokio::task::yield_now().await;
                    }
                    if let Err(end) = self.receive(frame, schedule.is_open()).await {
                        if let SessionEnd::Wrong(_) = end {
                            self.close(CloseCode::Malformed).await;
                        }
                        return end;
                    }
                }
                action = schedule.next(outstanding), if !is_paused => self.perform(action, schedule),
                () = self.pause.end(), if is_paused => {}
                () = &mut interrupted => {
                    self.close(CloseCode::Normal).await;
                    return SessionEnd::Finished;
                }
                () = sleep_until(stop) => {
                    if schedule.is_open() && stop == self.task.end {
                        stop += GRACE;
                        continue;
                    }
                    self.close(CloseCode::Normal).await;
                    return SessionEnd::Finished;
                }
            }
        }
    }

    /// A write failed. Frames that arrived before may give the reason.
    async fn read_last_frames(&mut self, problem: &str, is_open: bool) -> SessionEnd {
        loop {
            match self.socket.next().await {
                Some(Err(_)) | None => return SessionEnd::Lost(problem.into()),
                frame => {
                    if let Err(end) = self.receive(frame, is_open).await {
                        return end;
                    }
                }
            }
        }
    }

    async fn receive(
        &mut self,
        frame: Option<Result<Message, Error>>,
        is_open: bool,
    ) -> Result<(), SessionEnd> {
        let event = match frame {
            Some(Ok(Message::Binary(bytes))) => {
                // Pings say nothing of the session behind them.
                self.last_frame = Instant::now();
                self.machine.receive(DataFrame::Binary(&bytes))
            }
            Some(Ok(Message::Text(_))) => self.machine.receive(DataFrame::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => return Ok(()),
            other => {
                if matches!(other, Some(Ok(Message::Close(_)))) {
                    self.resumption.closed(self.task.counters);
                }
                return Err(SessionEnd::Lost(lost(other)));
            }
        };
        match event {
            Ok(Event::Chunk { chunk, bytes, delivery }) => self.take(chunk, bytes, delivery).await,
            Ok(Event::Settled(Settled { view, chunks })) => {
                self.check_settled(view, chunks);
                if !self.expected.settled(view) {
                    self.task.counters.mismatch(&format!("view {view} is settled, which was not sent"));
                    return Ok(());
                }
                self.released.settled(view);
                self.resumption.delivered(Instant::now(), self.task.counters);
                self.settled(view, is_open);
            }
            Ok(Event::Refused(refused)) => {
                self.expected.refused(&refused);
                self.refused_view = self.expected.newest_view();
                self.pause.refused(Instant::now());
                let problem = format!("refused by the server: {}", one_line(&refused.detail));
                match refused.reason {
                    RefusalReason::Overloaded | RefusalReason::TooManyRequests => {
                        self.task.counters.refused(&problem);
                    }
                    // The requests of this client are valid, so the server is at fault.
                    _ => self.task.counters.mismatch(&problem),
                }
            }
            // The close frame follows and counts if it comes before the end of the phase.
            Ok(Event::Draining { reconnect_after_ms }) => {
                self.task.counters.announced();
                self.resumption.announced(Duration::from_millis(reconnect_after_ms.into()));
            }
            Ok(Event::Welcome(_)) => {}
            Err(fault) => return Err(SessionEnd::Wrong(fault.to_string())),
        }
        Ok(())
    }

    /// Classifies and verifies a chunk.
    async fn take(&mut self, chunk: Box<Chunk>, bytes: usize, delivery: Delivery) {
        let counters = self.task.counters;
        counters.chunk(bytes);
        let now = Instant::now();
        let arrival = self.expected.receive(chunk.key, now);
        let is_again = self.resumption.held.insert(chunk.key, bytes);
        self.resumption.delivered(now, counters);
        self.pause.answered();
        match arrival {
            ChunkStatus::Requested(latency) => counters.answered(latency),
            ChunkStatus::InView if is_again => counters.sent_again(bytes),
            ChunkStatus::InView => {}
            ChunkStatus::Unexpected => counters.mismatch(&Mismatch::Unexpected(chunk.key).to_string()),
        }
        if let Some(key) = self.resumption.held.release(|key| !self.expected.is_in_view(*key)) {
            self.machine.release(&[key]);
            if let Some(newest) = self.expected.newest_view() {
                self.released.add(newest, key);
            }
        }
        self.checker.check(chunk, delivery).await;
    }

    /// Of some settled views: whether the server counts the right chunks, and all have come. Not if
    /// chunks of them may have been refused or released, or if they need more than a client holds.
    fn check_settled(&self, view: u32, settled: u32) {
        let was_refused = self.refused_view.is_some_and(|refused| view <= refused);
        if !view.is_multiple_of(CHECKED_VIEWS) || was_refused {
            return;
        }
        let Some(needed) = self.expected.needed_by(view) else { return };
        if needed.len() > MAX_HELD || self.released.may_lack(view, &needed) {
            return;
        }
        self.task.counters.view_checked();
        let missing = needed.iter().filter(|key| !self.resumption.held.contains(**key)).count();
        if missing > 0 || settled as usize != needed.len() {
            let incomplete = Mismatch::Incomplete { view, settled, needed: needed.len(), missing };
            self.task.counters.mismatch(&incomplete.to_string());
        }
    }

    /// Counts a client whose requests or poses have waited for long while nothing arrived.
    fn count_stall(&self) {
        let now = Instant::now();
        let has_waited = |since: Instant| now.saturating_duration_since(since) >= STALL_TIMEOUT;
        let mut waiting = self.expected.waiting_since().chain(self.poses.waiting_since());
        if has_waited(self.last_frame) && waiting.any(has_waited) {
            self.task.counters.stalled(&format!("nothing arrived for {STALL_TIMEOUT:?}"));
        }
    }

    /// Closes with a code. Frames that arrive until the server answers are not counted.
    async fn close(&mut self, code: CloseCode) {
        socket::close(&mut self.socket, code).await;
    }

    /// Counts requests and poses without an answer.
    fn count_unanswered(&self, is_open: bool) {
        let now = Instant::now();
        // An open loop has waited for its last answers, unless it was interrupted.
        let has_waited = is_open && !self.task.interrupt.is_cancelled();
        let poses = self.poses.waiting_since().filter(|_| is_open);
        for since in self.expected.waiting_since().chain(poses) {
            match now.saturating_duration_since(since) {
                // The server had enough time: the wait is a lower bound of the latency.
                waited if has_waited || waited >= MIN_ABANDONED_WAIT => self.task.counters.abandoned(waited),
                // It was sent just before the end of the session.
                _ => self.task.counters.unanswered(1),
            }
        }
    }
}

/// The land of a Welcome, if the announced digest is that of its seed.
fn world_of<D>(welcome: &Welcome, task: &Task<'_, D>) -> Result<Land, Mismatch> {
    task.world.check(welcome.world_seed, welcome.generator_version, WorldDigest(welcome.digest))
}

/// Waits for the first message, which must be the Welcome.
async fn welcome<S>(socket: &mut Socket<S>, machine: &mut ClientSession) -> Result<Welcome, SessionEnd>
where
    Socket<S>: StreamExt<Item = Result<Message, Error>> + Unpin,
{
    loop {
        let event = match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => machine.receive(DataFrame::Binary(&bytes)),
            Some(Ok(Message::Text(_))) => machine.receive(DataFrame::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => continue,
            other => return Err(SessionEnd::not_admitted(lost(other))),
        };
        return match event {
            Ok(Event::Welcome(welcome)) => Ok(welcome),
            Ok(Event::Draining { .. }) => Err(SessionEnd::not_admitted("the server is shutting down".into())),
            Ok(_) => Err(SessionEnd::Wrong("the first message is not the Welcome".into())),
            Err(PeerFault::Rejected(rejection)) => Err(SessionEnd::NotAdmitted {
                retry: rejection.close_code().is_retryable(),
                problem: rejection.to_string(),
            }),
            Err(fault) => Err(SessionEnd::Wrong(fault.to_string())),
        };
    }
}
