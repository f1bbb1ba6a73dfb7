//! The feed of a server: a WebSocket session on a thread of its own, restarted whenever it ends.
//!
//! The protocol is `protocol::client`; this file only moves its frames, keeps the connection alive
//! and decides about reconnecting. Chunks are decoded (or, in seed-only delivery, generated) and
//! verified here, off the drawing thread.

use crate::feed::{Feed, FeedEvent, Traffic};
use crate::native::backoff::Backoff;
use futures_util::{SinkExt as _, StreamExt as _};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_SERVER_FRAME;
use protocol::view::View;
use protocol::{CloseCode, Delivery, Incoming, SUBPROTOCOL};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, timeout};
use tokio_tungstenite::tungstenite::{self, ClientRequestBuilder, Message, http::Uri, protocol as ws};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

/// Events on their way to the drawing thread. When it is full the session stops reading: no more
/// credit is granted, and the server waits. At most this many decoded chunks (a few MiB) lie
/// between the threads.
const EVENTS: usize = 256;
/// Commands on their way to the session. When it is full they stay with the caller until the next
/// poll.
const COMMANDS: usize = 64;
/// Chunks that may be under way: enough to keep a fast server busy over a round trip of 100 ms.
const WINDOW: u32 = 256;
/// A server that does not answer a connection attempt for so long is treated as gone.
const CONNECT_LIMIT: Duration = Duration::from_secs(10);
/// How often a quiet connection is tested with a ping.
const PING_INTERVAL: Duration = Duration::from_secs(10);
/// Silence after which the connection is given up: several pings went unanswered.
const SILENCE_LIMIT: Duration = Duration::from_secs(35);
/// How long leaving politely may take.
const CLOSE_LIMIT: Duration = Duration::from_millis(300);

/// Where to connect, as whom and for what.
#[derive(Clone, Debug)]
pub struct Settings {
    /// `ws://` URL of the stream.
    pub url: Uri,
    /// Access token, where the server asks for one.
    pub token: Option<String>,
    /// The world to insist on; none accepts any.
    pub digest: Option<WorldDigest>,
    /// How chunks are to come.
    pub delivery: Delivery,
}

impl Settings {
    /// Any world, exact, without a token.
    #[must_use]
    pub const fn new(url: Uri) -> Self {
        Self { url, token: None, digest: None, delivery: Delivery::Exact }
    }
}

/// A server as a feed.
#[derive(Debug)]
pub struct SocketFeed {
    events: Option<mpsc::Receiver<FeedEvent>>,
    commands: mpsc::Sender<Command>,
    /// Commands that found the channel full. Bounded by what happens between two polls: keys of
    /// evicted chunks, one view.
    waiting: VecDeque<Command>,
    counters: Arc<Counters>,
    delivery: Delivery,
    thread: Option<std::thread::JoinHandle<()>>,
}

#[derive(Debug)]
enum Command {
    View(View),
    Release(Vec<ChunkKey>),
    Holding(Vec<ChunkKey>),
}

#[derive(Debug, Default)]
struct Counters {
    bytes: AtomicU64,
    credits: AtomicU32,
}

impl SocketFeed {
    /// Starts connecting. Fails only if the system has no thread left.
    pub fn connect(settings: Settings) -> std::io::Result<Self> {
        let (event_sender, events) = mpsc::channel(EVENTS);
        let (commands, command_receiver) = mpsc::channel(COMMANDS);
        let (counters, delivery) = (Arc::new(Counters::default()), settings.delivery);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let worker = Worker {
            settings,
            events: event_sender,
            commands: command_receiver,
            counters: Arc::clone(&counters),
        };
        let thread = std::thread::Builder::new()
            .name("tombolo-stream".into())
            .spawn(move || runtime.block_on(worker.run()))?;
        Ok(Self {
            events: Some(events),
            commands,
            waiting: VecDeque::new(),
            counters,
            delivery,
            thread: Some(thread),
        })
    }

    fn command(&mut self, command: Command) {
        self.waiting.push_back(command);
        self.flush();
    }

    fn flush(&mut self) {
        while let Some(command) = self.waiting.pop_front() {
            match self.commands.try_send(command) {
                Ok(()) => {}
                Err(mpsc::error::TrySendError::Full(command)) => {
                    self.waiting.push_front(command);
                    break;
                }
                // The session gave up for good; the event that says so is on its way.
                Err(mpsc::error::TrySendError::Closed(_)) => self.waiting.clear(),
            }
        }
    }
}

impl Feed for SocketFeed {
    fn poll(&mut self) -> Option<FeedEvent> {
        self.flush();
        self.events.as_mut()?.try_recv().ok()
    }

    fn set_view(&mut self, view: View) {
        self.waiting.retain(|command| !matches!(command, Command::View(_)));
        self.command(Command::View(view));
    }

    fn release(&mut self, keys: &[ChunkKey]) {
        self.command(Command::Release(keys.to_vec()));
    }

    fn holding(&mut self, keys: &[ChunkKey]) {
        self.command(Command::Holding(keys.to_vec()));
    }

    fn delivery(&self) -> Delivery {
        self.delivery
    }

    fn traffic(&self) -> Traffic {
        Traffic {
            bytes_received: self.counters.bytes.load(Ordering::Relaxed),
            credits: self.counters.credits.load(Ordering::Relaxed),
        }
    }
}

impl Drop for SocketFeed {
    /// Ends the session and waits for its polite goodbye.
    fn drop(&mut self) {
        self.events = None;
        if let Some(thread) = self.thread.take() {
            // A panic there was reported there.
            let _ = thread.join();
        }
    }
}

/// Why a session ended.
enum Ended {
    /// The viewer is closing.
    Abandoned,
    /// Anything else.
    Lost {
        cause: String,
        /// Whether another attempt can help.
        retry: bool,
        /// The delay that the server asked for.
        hint: Option<Duration>,
    },
}

fn lost(cause: impl Into<String>, retry: bool) -> Ended {
    Ended::Lost { cause: cause.into(), retry, hint: None }
}

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

struct Worker {
    settings: Settings,
    events: mpsc::Sender<FeedEvent>,
    commands: mpsc::Receiver<Command>,
    counters: Arc<Counters>,
}

impl Worker {
    async fn run(mut self) {
        let mut backoff = Backoff::new(u64::from(std::process::id()) << 20);
        loop {
            let ended = self.session(&mut backoff).await;
            self.counters.credits.store(0, Ordering::Relaxed);
            let Ended::Lost { cause, retry, hint } = ended else { return };
            let delay = retry.then(|| hint.unwrap_or_default().max(backoff.next_delay()));
            if self.tell(FeedEvent::Disconnected { cause, retry: delay }).await.is_err() {
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
    async fn session(&mut self, backoff: &mut Backoff) -> Ended {
        let connected = tokio::select! {
            connected = timeout(CONNECT_LIMIT, connect(&self.settings.url)) => connected,
            () = self.events.closed() => return Ended::Abandoned,
        };
        let mut socket = match connected {
            Ok(Ok(socket)) => socket,
            Ok(Err(error)) => return self.not_connected(&error),
            Err(_) => {
                return lost(format!("{} does not answer: check host and port", self.settings.url), true);
            }
        };
        // What was meant for the previous session.
        while self.commands.try_recv().is_ok() {}
        let mut session = ClientSession::new(ClientConfig {
            digest: self.settings.digest,
            delivery: self.settings.delivery,
            token: self.settings.token.clone(),
            software: concat!("tombolo-view ", env!("CARGO_PKG_VERSION")).into(),
            window: WINDOW,
        });
        let ended = self.converse(&mut socket, &mut session, backoff).await;
        let code = match &ended {
            Ok(Ended::Abandoned) => CloseCode::Normal,
            Ok(Ended::Lost { .. }) => return ended.unwrap_or(Ended::Abandoned),
            Err(fault) => fault.close_code(),
        };
        let frame = ws::CloseFrame { code: code.code().into(), reason: "".into() };
        // Politeness has a limit, and its failure changes nothing.
        let _ = timeout(CLOSE_LIMIT, socket.close(Some(frame))).await;
        ended.unwrap_or_else(|fault| {
            let cause = format!("{}: {fault}", self.settings.url);
            lost(cause, code.is_retryable())
        })
    }

    async fn converse(
        &mut self,
        socket: &mut Socket,
        session: &mut ClientSession,
        backoff: &mut Backoff,
    ) -> Result<Ended, protocol::PeerFault> {
        let mut heard = Instant::now();
        let mut pings = tokio::time::interval(PING_INTERVAL);
        let mut hint = None;
        loop {
            while let Some(frame) = session.poll_transmit() {
                if let Err(error) = socket.feed(Message::Binary(frame)).await {
                    return Ok(self.broken(&error, hint));
                }
            }
            if let Err(error) = socket.flush().await {
                return Ok(self.broken(&error, hint));
            }
            self.counters.credits.store(session.credits(), Ordering::Relaxed);
            let message = tokio::select! {
                message = socket.next() => message,
                command = self.commands.recv() => {
                    match command {
                        Some(Command::View(view)) => session.set_view(view),
                        Some(Command::Release(keys)) => session.release(&keys),
                        Some(Command::Holding(keys)) => session.holding(&keys),
                        None => return Ok(Ended::Abandoned),
                    }
                    continue;
                }
                _ = pings.tick() => {
                    if heard.elapsed() > SILENCE_LIMIT {
                        return Ok(lost(format!("{} went silent", self.settings.url), true));
                    }
                    if let Err(error) = socket.feed(Message::Ping(bytes::Bytes::new())).await {
                        return Ok(self.broken(&error, hint));
                    }
                    continue;
                }
                () = self.events.closed() => return Ok(Ended::Abandoned),
            };
            heard = Instant::now();
            let event = match message {
                Some(Ok(Message::Binary(frame))) => {
                    self.counters.bytes.fetch_add(frame.len() as u64, Ordering::Relaxed);
                    session.receive(Incoming::Binary(&frame))?
                }
                Some(Ok(Message::Text(_))) => session.receive(Incoming::Text)?,
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => continue,
                Some(Ok(Message::Close(frame))) => return Ok(self.closed(frame.as_ref(), hint)),
                Some(Err(error)) => return Ok(self.broken(&error, hint)),
                None => return Ok(self.closed(None, hint)),
            };
            let event = match event {
                Event::Welcome(welcome) => {
                    backoff.reset();
                    let world = WorldDigest(welcome.digest);
                    FeedEvent::Connected { world, world_seed: welcome.world_seed, server: welcome.software }
                }
                Event::Chunk { chunk, .. } => FeedEvent::Chunk(chunk),
                Event::Settled { view, .. } => FeedEvent::Settled { view },
                Event::Refused(refused) => FeedEvent::Refused { detail: refused.detail.into_owned() },
                Event::Draining { reconnect_after_ms } => {
                    hint = Some(Duration::from_millis(reconnect_after_ms.into()));
                    continue;
                }
            };
            if self.tell(event).await.is_err() {
                return Ok(Ended::Abandoned);
            }
        }
    }

    async fn tell(&self, event: FeedEvent) -> Result<(), mpsc::error::SendError<FeedEvent>> {
        self.events.send(event).await
    }

    fn not_connected(&self, error: &tungstenite::Error) -> Ended {
        let url = &self.settings.url;
        match error {
            tungstenite::Error::Http(response) => {
                let status = response.status();
                let retry = status.is_server_error() || status.as_u16() == 429;
                lost(format!("{url} answered {status}: is it the stream of a tombolo-server?"), retry)
            }
            tungstenite::Error::Io(cause) => lost(
                format!(
                    "cannot connect to {url}: {cause}; start a server with `tombolo-server` or name one with --connect"
                ),
                true,
            ),
            other => lost(format!("{url} is no Tombolo stream: {other}"), false),
        }
    }

    fn closed(&self, frame: Option<&ws::CloseFrame>, hint: Option<Duration>) -> Ended {
        let url = &self.settings.url;
        let Some(frame) = frame else {
            return Ended::Lost { cause: format!("{url} closed the connection"), retry: true, hint };
        };
        let number = u16::from(frame.code);
        let code = CloseCode::from_code(number);
        let words = code.map_or_else(|| format!("code {number}"), |code| code.to_string());
        let cause = match frame.reason.as_str() {
            "" => format!("{url} closed the connection: {words}"),
            reason => format!("{url} closed the connection: {words}: {reason}"),
        };
        // An unknown code comes from something between us and the server: worth another attempt.
        let retry = code.is_none_or(|code| code.is_retryable() || code == CloseCode::Normal);
        Ended::Lost { cause, retry, hint }
    }

    fn broken(&self, error: &tungstenite::Error, hint: Option<Duration>) -> Ended {
        Ended::Lost { cause: format!("lost {}: {error}", self.settings.url), retry: true, hint }
    }
}

async fn connect(url: &Uri) -> Result<Socket, tungstenite::Error> {
    let request = ClientRequestBuilder::new(url.clone()).with_sub_protocol(SUBPROTOCOL);
    let config = ws::WebSocketConfig::default()
        .max_message_size(Some(MAX_SERVER_FRAME))
        .max_frame_size(Some(MAX_SERVER_FRAME));
    // Small control frames must not wait for company.
    let disable_nagle = true;
    Ok(connect_async_with_config(request, Some(config), disable_nagle).await?.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poll_until(feed: &mut SocketFeed, what: impl Fn(&FeedEvent) -> bool) -> FeedEvent {
        let limit = std::time::Instant::now() + Duration::from_secs(20);
        while std::time::Instant::now() < limit {
            match feed.poll() {
                Some(event) if what(&event) => return event,
                Some(_) => {}
                None => std::thread::sleep(Duration::from_millis(2)),
            }
        }
        panic!("nothing happened");
    }

    fn feed_of(address: std::net::SocketAddr) -> SocketFeed {
        let url = format!("ws://{address}/v1/stream").parse().unwrap();
        SocketFeed::connect(Settings::new(url)).unwrap()
    }

    #[test]
    fn a_server_that_is_not_there_is_named_and_tried_again() {
        // A port that was free a moment ago.
        let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut feed = feed_of(address);
        for _ in 0..2 {
            let event = poll_until(&mut feed, |event| matches!(event, FeedEvent::Disconnected { .. }));
            let FeedEvent::Disconnected { cause, retry } = event else { unreachable!() };
            assert!(cause.contains(&address.to_string()) && cause.contains("--connect"), "{cause}");
            assert!(retry.is_some());
        }
    }

    #[test]
    fn something_that_speaks_no_websocket_is_no_stream() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let server = std::thread::spawn(move || {
            use std::io::{Read as _, Write as _};
            let (mut socket, _) = listener.accept().unwrap();
            let mut request = [0; 2048];
            let _ = socket.read(&mut request).unwrap();
            socket.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n").unwrap();
        });
        let mut feed = feed_of(address);
        let event = poll_until(&mut feed, |event| matches!(event, FeedEvent::Disconnected { .. }));
        let FeedEvent::Disconnected { cause, retry } = event else { unreachable!() };
        assert!(cause.contains("404") && retry.is_none(), "{cause}");
        server.join().unwrap();
    }
}
