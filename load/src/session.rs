//! One session over WebSocket: admission, the loop, the good-bye.
//!
//! The protocol itself runs in [`ClientSession`]; this file moves its frames, keeps the clock, and
//! says how a session ended. What is said and asked is in `errands`, the socket in `socket`.

mod errands;
mod socket;

pub use errands::view_of;
pub use socket::{Socket, connect, transmit};

use crate::SOFTWARE;
use crate::agenda::Agenda;
use crate::client::{End, GRACE, HANDSHAKE_TIMEOUT, Task};
use crate::dial::Dial;
use crate::inspection::Inspection;
use crate::interest::{Arrival, Interest, MAX_VIEWS, MAX_VIEWS_SLOW};
use crate::keys::Keys;
use crate::path::FlightPath;
use crate::verify::{self, Mismatch};
use errands::Poses;
use futures_util::StreamExt;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_CREDITS;
use protocol::message::Welcome;
use protocol::{CloseCode, Delivery, Incoming, PeerFault};
use socket::lost;
use terrain::{Chunk, Land};
use tokio::time::{Instant, sleep_until, timeout, timeout_at};
use tokio_tungstenite::tungstenite::{Error, Message};

/// Chunks that may be under way to one client. Enough to hide a round trip, few enough that a view
/// change counts.
const WINDOW: u32 = 64;

/// The same for one who reads slowly: all that there can be, or credit would keep the server from
/// ever owing more than a socket holds.
const WINDOW_SLOW: u32 = MAX_CREDITS;

/// Frames that a session takes before others get their turn. A frame costs about 0.1 ms to decode
/// or generate and verify; without turns a burst would hold up the clocks of all.
const TURN: u32 = 16;

/// One session from connect to close.
pub async fn run<D: Dial>(task: &Task<'_, D>, agenda: &mut Agenda) -> End {
    let mut session = match timeout_at(task.end, Session::admit(task)).await {
        Ok(Ok(session)) => session,
        Ok(Err(end)) => return end,
        // The run ended while the server took its time; that is no session lost.
        Err(_) => return End::Finished,
    };
    let outcome = session.run(agenda).await;
    session.give_up(agenda.is_open());
    outcome
}

/// An admitted client and everything it knows.
struct Session<'t, 'a, D: Dial> {
    task: &'t Task<'a, D>,
    socket: Socket<D::Stream>,
    machine: ClientSession,
    land: Land,
    interest: Interest,
    inspection: Inspection,
    path: FlightPath,
    keys: Keys,
    poses: Poses,
}

impl<'t, 'a, D: Dial> Session<'t, 'a, D> {
    /// Connects and waits for the Welcome.
    async fn admit(task: &'t Task<'a, D>) -> Result<Self, End> {
        let config = task.config;
        let mut socket = connect(task).await?;
        let mut machine = ClientSession::new(ClientConfig {
            digest: None,
            delivery: config.delivery,
            token: config.token.clone(),
            software: SOFTWARE.into(),
            window: if task.reads.is_some() { WINDOW_SLOW } else { WINDOW },
        });
        transmit(&mut socket, &mut machine).await.map_err(End::not_admitted)?;
        let welcome = timeout(HANDSHAKE_TIMEOUT, welcome(&mut socket, &mut machine))
            .await
            .map_err(|_| End::not_admitted(format!("no Welcome within {HANDSHAKE_TIMEOUT:?}")))??;
        let land = verify::world(&welcome).map_err(|mismatch| End::Wrong(mismatch.to_string()))?;
        task.counters.admitted();
        let sample = (config.verify_every, task.index);
        let path = FlightPath::new(config.path, config.seed, task.index);
        Ok(Self {
            task,
            socket,
            machine,
            land,
            interest: Interest::new(land, if task.reads.is_some() { MAX_VIEWS_SLOW } else { MAX_VIEWS }),
            inspection: Inspection::new(land, config.delivery, sample, task.counters, task.regeneration),
            path,
            keys: Keys::new(config.path, config.seed, task.index, path),
            poses: Poses::default(),
        })
    }

    /// Does errands until the end of the run or of the session.
    async fn run(&mut self, agenda: &mut Agenda) -> End {
        let mut frames = 0u32;
        let mut stop = self.task.end;
        loop {
            if let Err(problem) = transmit(&mut self.socket, &mut self.machine).await {
                return End::Lost(problem);
            }
            let outstanding = self.outstanding(agenda.waits_for_views());
            if agenda.is_done() && outstanding == 0 && Instant::now() >= self.task.end {
                self.close(CloseCode::Normal).await;
                return End::Finished;
            }
            tokio::select! {
                frame = self.socket.next() => {
                    frames = frames.wrapping_add(1);
                    if frames.is_multiple_of(TURN) {
                        tokio::task::yield_now().await;
                    }
                    if let Err(end) = self.receive(frame, agenda.is_open()).await {
                        if let End::Wrong(_) = end {
                            self.close(CloseCode::Malformed).await;
                        }
                        return end;
                    }
                }
                errand = agenda.next(outstanding) => self.attend(errand, agenda),
                () = sleep_until(stop) => {
                    if agenda.is_open() && stop == self.task.end {
                        stop += GRACE;
                        continue;
                    }
                    self.close(CloseCode::Normal).await;
                    return End::Finished;
                }
            }
        }
    }

    async fn receive(&mut self, frame: Option<Result<Message, Error>>, is_open: bool) -> Result<(), End> {
        let event = match frame {
            Some(Ok(Message::Binary(bytes))) => self.machine.receive(Incoming::Binary(&bytes)),
            Some(Ok(Message::Text(_))) => self.machine.receive(Incoming::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => return Ok(()),
            other => return Err(End::Lost(lost(other))),
        };
        match event {
            Ok(Event::Chunk { chunk, bytes, delivery }) => self.take(chunk, bytes, delivery).await,
            Ok(Event::Settled { view, .. }) => {
                self.interest.settled(view);
                self.settled(view, is_open);
            }
            Ok(Event::Refused(refused)) => {
                self.interest.refused(&refused);
                self.task.counters.refused(&format!("refused by the server: {}", refused.detail));
            }
            // The close follows; that it comes before the end of the run is what counts.
            Ok(Event::Draining { .. } | Event::Welcome(_)) => {}
            Err(fault) => return Err(End::Wrong(fault.to_string())),
        }
        Ok(())
    }

    /// Verifies a chunk and lets it go.
    async fn take(&mut self, chunk: Box<Chunk>, bytes: usize, delivery: Delivery) {
        let counters = self.task.counters;
        counters.chunk(bytes);
        let (arrival, release) = self.interest.arrive(chunk.key, Instant::now());
        match arrival {
            Arrival::Requested(latency) => counters.answered(latency),
            Arrival::InView => {}
            Arrival::Unasked => counters.mismatch(&Mismatch::Unasked(chunk.key).to_string()),
        }
        if let Some(key) = release {
            self.machine.release(&[key]);
        }
        self.inspection.inspect(chunk, delivery).await;
    }

    /// Says why the session ends and gives the server a moment to answer. Nothing that arrives
    /// meanwhile is counted.
    async fn close(&mut self, code: CloseCode) {
        socket::close(&mut self.socket, code).await;
    }

    /// Counts what has no answer.
    fn give_up(&self, is_open: bool) {
        if !is_open {
            self.task.counters.unanswered(self.interest.open_requests());
            return;
        }
        let now = Instant::now();
        for since in self.interest.waiting_since().chain(self.poses.waiting_since()) {
            self.task.counters.abandoned(now.saturating_duration_since(since));
        }
    }
}

/// Waits for the first message, which must be the Welcome.
async fn welcome<S>(socket: &mut Socket<S>, machine: &mut ClientSession) -> Result<Welcome, End>
where
    Socket<S>: StreamExt<Item = Result<Message, Error>> + Unpin,
{
    loop {
        let event = match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => machine.receive(Incoming::Binary(&bytes)),
            Some(Ok(Message::Text(_))) => machine.receive(Incoming::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => continue,
            other => return Err(End::not_admitted(lost(other))),
        };
        return match event {
            Ok(Event::Welcome(welcome)) => Ok(welcome),
            Ok(Event::Draining { .. }) => Err(End::not_admitted("the server is shutting down".into())),
            Ok(_) => Err(End::Wrong("the first message is not the Welcome".into())),
            Err(PeerFault::Rejected(rejection)) => Err(End::NotAdmitted {
                retry: rejection.close_code().is_retryable(),
                problem: rejection.to_string(),
            }),
            Err(fault) => Err(End::Wrong(fault.to_string())),
        };
    }
}
