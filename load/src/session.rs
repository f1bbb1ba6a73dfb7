//! One client: connects, flies, verifies, and comes back when it is thrown out.
//!
//! The protocol itself runs in [`ClientSession`]; this file moves its frames over a WebSocket, keeps the clock, and turns
//! whatever ends a session into a count.

use crate::SOFTWARE;
use crate::config::LoadConfig;
use crate::interest::{Arrival, Interest};
use crate::path::{FlightPath, Pose};
use crate::regeneration::Regeneration;
use crate::tally::Tally;
use crate::verify::{self, Mismatch};
use futures_util::{SinkExt, StreamExt};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_SERVER_FRAME;
use protocol::message::Welcome;
use protocol::view::View;
use protocol::{CloseCode, Delivery, Incoming, PeerFault, SUBPROTOCOL};
use std::time::Duration;
use terrain::constants::UNITS_PER_METRE;
use terrain::hash::{hash2, mix};
use terrain::{Chunk, ChunkKey, Land};
use tokio::net::TcpStream;
use tokio::time::{Instant, MissedTickBehavior, interval_at, sleep_until, timeout, timeout_at};
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::protocol::frame::CloseFrame;
use tokio_tungstenite::tungstenite::{Error, Message, protocol::WebSocketConfig};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

/// Chunks that may be under way to one client. Enough to hide a round trip, few enough that a view change counts.
const WINDOW: u32 = 64;

/// Time between two explicit requests of a client.
const REQUEST_PERIOD: Duration = Duration::from_millis(250);

/// Levels that explicit requests ask for are below this: the fine ones, which a view needs only near the eye.
const REQUEST_LEVELS: u32 = 4;

/// Time for a connection with its WebSocket handshake, and again for the Welcome.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);

/// Time that a server may take to accept what a client writes.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// First and longest pause before connecting again; doubled after each failure.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));

/// Frames that a session takes before others get their turn. A frame costs about 0.1 ms to decode or generate and verify; without
/// turns a burst would hold up the clocks of all.
const TURN: u32 = 16;

/// Buffers of one connection, bytes. The library's 128 KiB each would be 50 MiB for 200 clients.
const BUFFER: usize = 16 * 1024;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// How one session ended.
#[derive(Debug)]
enum End {
    /// The run is over.
    Finished,
    /// Never admitted, and why. Trying again helps only if told so.
    NotAdmitted { problem: String, retry: bool },
    /// Admitted and lost, and why.
    Lost(String),
    /// The server sent something wrong.
    Wrong(String),
}

/// Flies one client until `end`, reconnecting with growing pauses.
pub async fn fly(index: u32, config: &LoadConfig, tally: &Tally, regeneration: &Regeneration, end: Instant) {
    let mut pause = BACKOFF.0;
    loop {
        let began = Instant::now();
        match Client::session(index, config, tally, regeneration, end).await {
            End::Finished => return,
            End::NotAdmitted { problem, retry } => {
                tally.refused(&problem);
                if !retry {
                    return;
                }
            }
            End::Lost(problem) => tally.dropped(&problem),
            End::Wrong(problem) => {
                tally.mismatch(&problem);
                tally.dropped(&problem);
            }
        }
        // A session that lasted starts over with the shortest pause.
        pause = if began.elapsed() > BACKOFF.1 { BACKOFF.0 } else { (pause * 2).min(BACKOFF.1) };
        // Half of the pause is spread by client, so that those thrown out together do not return together.
        let spread = pause.mul_f64(0.5 + f64::from(mix(index)) / f64::from(u32::MAX) / 2.0);
        if timeout_at(end, tokio::time::sleep(spread)).await.is_err() || Instant::now() >= end {
            return;
        }
    }
}

/// The view that a client at a pose has: 1280 x 720 at 60 degrees, 4 pixels of tolerance.
#[must_use]
pub fn view_of(id: u32, pose: &Pose, distance_m: u32) -> View {
    View {
        id,
        eye: pose.eye,
        velocity: pose.velocity,
        yaw_mdeg: pose.yaw_mdeg,
        pitch_mdeg: -10_000,
        fov_mdeg: 60_000,
        viewport: [1280, 720],
        tolerance_q4: 64,
        distance_m,
    }
}

/// An admitted client and everything it knows.
struct Client<'a> {
    config: &'a LoadConfig,
    tally: &'a Tally,
    regeneration: &'a Regeneration,
    socket: Socket,
    session: ClientSession,
    land: Land,
    interest: Interest,
    path: FlightPath,
    /// Time zero of the path.
    epoch: Instant,
    next_view: u32,
    /// Chunks until the next one that is generated again.
    until_regeneration: u32,
    /// Seeds the choice of requested keys.
    seed: u32,
}

impl<'a> Client<'a> {
    /// One session from connect to close.
    async fn session(
        index: u32,
        config: &'a LoadConfig,
        tally: &'a Tally,
        regeneration: &'a Regeneration,
        end: Instant,
    ) -> End {
        let mut client = match timeout_at(end, Self::admit(index, config, tally, regeneration)).await {
            Ok(Ok(client)) => client,
            Ok(Err(end)) => return end,
            // The run ended while the server took its time; that is no session lost.
            Err(_) => return End::Finished,
        };
        let outcome = client.run(index, end).await;
        client.tally.unanswered(client.interest.open_requests());
        outcome
    }

    /// Connects and waits for the Welcome.
    async fn admit(
        index: u32,
        config: &'a LoadConfig,
        tally: &'a Tally,
        regeneration: &'a Regeneration,
    ) -> Result<Self, End> {
        let mut socket = connect(config).await?;
        let mut session = ClientSession::new(ClientConfig {
            digest: None,
            delivery: config.delivery,
            token: config.token.clone(),
            software: SOFTWARE.into(),
            window: WINDOW,
        });
        transmit(&mut socket, &mut session).await.map_err(not_admitted)?;
        let welcome = timeout(HANDSHAKE_TIMEOUT, welcome(&mut socket, &mut session))
            .await
            .map_err(|_| not_admitted(format!("no Welcome within {HANDSHAKE_TIMEOUT:?}")))??;
        let land = verify::world(&welcome).map_err(|mismatch| End::Wrong(mismatch.to_string()))?;
        Ok(Self {
            config,
            tally,
            regeneration,
            socket,
            session,
            land,
            interest: Interest::new(land),
            path: FlightPath::new(config.path, config.seed, index),
            epoch: Instant::now(),
            next_view: 0,
            // Clients start at different places of the count, so that short sessions are sampled too.
            until_regeneration: 1 + index % config.verify_every.max(1),
            seed: hash2(config.seed, index as i32, 0x72),
        })
    }

    /// Flies until the end of the run or of the session.
    async fn run(&mut self, index: u32, end: Instant) -> End {
        // 2 to 4 views a second, and no two clients in step.
        let view_period = Duration::from_millis(250 + u64::from(mix(index) % 250));
        let mut views = interval_at(self.epoch, view_period);
        let mut requests = interval_at(self.epoch + REQUEST_PERIOD / 2, REQUEST_PERIOD);
        views.set_missed_tick_behavior(MissedTickBehavior::Delay);
        requests.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut frames = 0u32;
        loop {
            if let Err(problem) = transmit(&mut self.socket, &mut self.session).await {
                return End::Lost(problem);
            }
            tokio::select! {
                frame = self.socket.next() => {
                    frames = frames.wrapping_add(1);
                    if frames.is_multiple_of(TURN) {
                        tokio::task::yield_now().await;
                    }
                    if let Err(end) = self.receive(frame).await {
                        if let End::Wrong(_) = end {
                            self.close(CloseCode::Malformed).await;
                        }
                        return end;
                    }
                }
                _ = views.tick() => self.look(),
                _ = requests.tick() => self.request(),
                () = sleep_until(end) => {
                    self.close(CloseCode::Normal).await;
                    return End::Finished;
                }
            }
        }
    }

    /// Says what is seen now.
    fn look(&mut self) {
        let pose = self.path.pose(&self.land, self.epoch.elapsed().as_secs_f64());
        let view = view_of(self.next_view, &pose, self.config.view_distance_m);
        self.next_view = self.next_view.wrapping_add(1);
        self.interest.view(&view);
        self.session.set_view(view);
    }

    /// Asks for one chunk near the path that no view brings, to measure how long it takes.
    fn request(&mut self) {
        let ahead_m = self.path.place_m(self.epoch.elapsed().as_secs_f64() + 20.0);
        let Some(key) = (0..8).find_map(|_| self.candidate(ahead_m)) else { return };
        let id = self.session.request(&[key]);
        self.interest.request(id, key, Instant::now());
        self.tally.request();
    }

    /// A fine chunk within about 2 km of a place, if a request for it would measure anything.
    fn candidate(&mut self, (east_m, south_m): (f64, f64)) -> Option<ChunkKey> {
        self.seed = mix(self.seed.wrapping_add(1));
        let level = (self.seed % REQUEST_LEVELS) as u8;
        let offset_m = |bits: u32| f64::from((self.seed >> bits) & 0xfff) - 2048.0;
        let units = |metres: f64| (metres * f64::from(UNITS_PER_METRE)) as i32;
        let key = ChunkKey::containing(level, units(east_m + offset_m(4)), units(south_m + offset_m(18)));
        self.interest.can_request(key).then_some(key)
    }

    async fn receive(&mut self, frame: Option<Result<Message, Error>>) -> Result<(), End> {
        let event = match frame {
            Some(Ok(Message::Binary(bytes))) => self.session.receive(Incoming::Binary(&bytes)),
            Some(Ok(Message::Text(_))) => self.session.receive(Incoming::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => return Ok(()),
            other => return Err(End::Lost(lost(other))),
        };
        match event {
            Ok(Event::Chunk { chunk, bytes, delivery }) => self.take(chunk, bytes, delivery).await,
            Ok(Event::Settled { view, .. }) => {
                self.interest.settled(view);
                self.tally.view_settled();
            }
            Ok(Event::Refused(refused)) => {
                self.interest.refused(&refused);
                self.tally.refused(&format!("refused by the server: {}", refused.detail));
            }
            // The close follows; that it comes before the end of the run is what counts.
            Ok(Event::Draining { .. } | Event::Welcome(_)) => {}
            Err(fault) => return Err(End::Wrong(fault.to_string())),
        }
        Ok(())
    }

    /// Verifies a chunk and lets it go.
    async fn take(&mut self, chunk: Box<Chunk>, bytes: usize, delivery: Delivery) {
        self.tally.chunk(bytes);
        let (arrival, release) = self.interest.arrive(chunk.key, Instant::now());
        match arrival {
            Arrival::Requested(latency) => self.tally.answered(latency),
            Arrival::InView => {}
            Arrival::Unasked => self.tally.mismatch(&Mismatch::Unasked(chunk.key).to_string()),
        }
        if let Some(key) = release {
            self.session.release(&[key]);
        }
        if let Err(mismatch) = verify::pyramids(&chunk) {
            self.tally.mismatch(&mismatch.to_string());
        }
        // A seed-only frame was generated and verified by the session; its error is the server's word until it is sampled. An
        // exact frame may come in seed-only delivery too, where every chunk is promised to be compared.
        let regenerated = delivery == Delivery::SeedOnly;
        let sampled = self.is_sampled() || (self.config.delivery == Delivery::SeedOnly && !regenerated);
        if sampled || regenerated {
            self.tally.regenerated();
        }
        if sampled {
            self.regeneration.compare(self.land, chunk, delivery).await;
        }
    }

    /// Whether this is the one in `verify_every` chunks that is generated again.
    fn is_sampled(&mut self) -> bool {
        if self.config.verify_every == 0 {
            return false;
        }
        self.until_regeneration -= 1;
        if self.until_regeneration > 0 {
            return false;
        }
        self.until_regeneration = self.config.verify_every;
        true
    }

    /// Says why the session ends and gives the server a moment to answer. Nothing that arrives meanwhile is counted.
    async fn close(&mut self, code: CloseCode) {
        let frame = CloseFrame { code: code.code().into(), reason: "".into() };
        let goodbye = async {
            self.socket.close(Some(frame)).await?;
            while let Some(Ok(_)) = self.socket.next().await {}
            Ok::<_, Error>(())
        };
        // A server that does not answer a good-bye has lost nothing of this session.
        let _ = timeout(Duration::from_secs(1), goodbye).await;
    }
}

/// Opens the WebSocket.
async fn connect(config: &LoadConfig) -> Result<Socket, End> {
    let request = ClientRequestBuilder::new(config.connect.clone()).with_sub_protocol(SUBPROTOCOL);
    let limits = WebSocketConfig::default()
        .max_message_size(Some(MAX_SERVER_FRAME))
        .max_frame_size(Some(MAX_SERVER_FRAME))
        .read_buffer_size(BUFFER)
        .write_buffer_size(BUFFER);
    let address = &config.connect;
    // Requests are small and timed; Nagle would hold them back.
    match timeout(HANDSHAKE_TIMEOUT, connect_async_with_config(request, Some(limits), true)).await {
        Ok(Ok((socket, _))) => Ok(socket),
        Ok(Err(error)) => Err(not_admitted(format!("cannot connect to {address}: {}", explain(error)))),
        Err(_) => Err(not_admitted(format!("no answer from {address} within {HANDSHAKE_TIMEOUT:?}"))),
    }
}

/// Waits for the first message, which must be the Welcome.
async fn welcome(socket: &mut Socket, session: &mut ClientSession) -> Result<Welcome, End> {
    loop {
        let event = match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => session.receive(Incoming::Binary(&bytes)),
            Some(Ok(Message::Text(_))) => session.receive(Incoming::Text),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => continue,
            other => return Err(not_admitted(lost(other))),
        };
        return match event {
            Ok(Event::Welcome(welcome)) => Ok(welcome),
            Ok(Event::Draining { .. }) => Err(not_admitted("the server is shutting down".into())),
            Ok(_) => Err(End::Wrong("the first message is not the Welcome".into())),
            Err(PeerFault::Rejected(rejection)) => Err(End::NotAdmitted {
                retry: rejection.close_code().is_retryable(),
                problem: rejection.to_string(),
            }),
            Err(fault) => Err(End::Wrong(fault.to_string())),
        };
    }
}

/// Writes everything that the session has to say, in one flush.
async fn transmit(socket: &mut Socket, session: &mut ClientSession) -> Result<(), String> {
    let Some(first) = session.poll_transmit() else { return Ok(()) };
    let write = async {
        let mut next = Some(first);
        while let Some(frame) = next {
            socket.feed(Message::Binary(frame)).await?;
            next = session.poll_transmit();
        }
        socket.flush().await
    };
    match timeout(WRITE_TIMEOUT, write).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) => Err(format!("the connection broke: {}", explain(error))),
        Err(_) => Err(format!("the server read nothing for {WRITE_TIMEOUT:?}")),
    }
}

fn not_admitted(problem: String) -> End {
    End::NotAdmitted { problem, retry: true }
}

/// Why a stream of frames ended.
fn lost(last: Option<Result<Message, Error>>) -> String {
    match last {
        Some(Ok(Message::Close(Some(frame)))) => match CloseCode::from_code(frame.code.into()) {
            Some(code) if frame.reason.is_empty() => format!("the server closed: {code}"),
            _ => format!("the server closed: {} ({})", frame.reason, u16::from(frame.code)),
        },
        Some(Ok(_)) => "the server closed without a reason".into(),
        Some(Err(error)) => format!("the connection broke: {}", explain(error)),
        None => "the connection ended without a close frame".into(),
    }
}

/// A library error in one line; what an HTTP refusal says is in its body.
fn explain(error: Error) -> String {
    let Error::Http(response) = error else {
        return match error {
            Error::Io(error) => error.to_string(),
            other => other.to_string(),
        };
    };
    let body = response.body().as_deref().map(String::from_utf8_lossy).unwrap_or_default();
    let line: String = body.lines().next().unwrap_or_default().chars().take(200).collect();
    if line.is_empty() { response.status().to_string() } else { format!("{}: {line}", response.status()) }
}
