//! The chunk stream of a server: a WebSocket session on its own thread, restarted when it ends.
//!
//! The protocol is in `protocol::client`; this file transports its frames, keeps the connection
//! alive and reconnects. Chunks are decoded (or generated, in seed-only delivery) and verified
//! here, off the drawing thread.

use crate::stream::{ChunkStream, StreamEvent, Traffic};
use futures_util::{SinkExt as _, StreamExt as _};
use protocol::backoff::Backoff;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_SERVER_FRAME;
use protocol::view::View;
use protocol::{CloseCode, DataFrame, Delivery, SUBPROTOCOL};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use tls_client::{TlsClient, Transport};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, timeout};
use tokio_tungstenite::tungstenite::{self, ClientRequestBuilder, Message, http::Uri, protocol as ws};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};
use tokio_util::either::Either;

/// Capacity for events to the drawing thread. When it is full the session stops reading: no credit
/// is granted, and the server waits. Bounds the decoded chunks between the threads to a few MiB.
const EVENT_CAPACITY: usize = 256;
/// Capacity for commands to the session. When it is full they are queued by the caller until the
/// next poll.
const COMMAND_CAPACITY: usize = 64;
/// Credit window, chunks: enough for a fast server over a round trip of 100 ms.
const WINDOW: u32 = 256;
/// Time limit of a connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Interval of pings.
const PING_INTERVAL: Duration = Duration::from_secs(10);
/// Time without any message after which the connection is given up: several pings were not
/// answered.
const IDLE_TIMEOUT: Duration = Duration::from_secs(35);
/// Time limit of the closing handshake.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(300);

/// First and longest delay before a new connection attempt.
const FIRST_RETRY_DELAY: Duration = Duration::from_millis(250);
const MAX_RETRY_DELAY: Duration = Duration::from_secs(10);

/// Connection settings.
#[derive(Clone, Debug)]
pub struct Settings {
    /// `ws://` or `wss://` URL of the stream.
    pub url: Uri,
    /// TLS to the server; none is plain TCP.
    pub tls: Option<TlsClient>,
    /// Access token, if the server requires one.
    pub token: Option<String>,
    /// The required world; none accepts any.
    pub digest: Option<WorldDigest>,
    /// Delivery mode.
    pub delivery: Delivery,
}

impl Settings {
    /// Any world, exact, without a token.
    #[must_use]
    pub const fn new(url: Uri) -> Self {
        Self { url, tls: None, token: None, digest: None, delivery: Delivery::Exact }
    }
}

/// The chunk stream of a server.
#[derive(Debug)]
pub struct ServerStream {
    events: Option<mpsc::Receiver<StreamEvent>>,
    commands: mpsc::Sender<Command>,
    /// Commands that did not fit the channel. Bounded by what happens between two polls: keys of
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

impl ServerStream {
    /// Starts connecting. Fails only if no thread can be created.
    pub fn connect(settings: Settings) -> std::io::Result<Self> {
        let (event_sender, events) = mpsc::channel(EVENT_CAPACITY);
        let (commands, command_receiver) = mpsc::channel(COMMAND_CAPACITY);
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
                // The session gave up; its last event is on the way.
                Err(mpsc::error::TrySendError::Closed(_)) => self.waiting.clear(),
            }
        }
    }
}

impl ChunkStream for ServerStream {
    fn poll(&mut self) -> Option<StreamEvent> {
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

impl Drop for ServerStream {
    /// Ends the session and waits for the closing handshake.
    fn drop(&mut self) {
        self.events = None;
        if let Some(thread) = self.thread.take() {
            // A panic was reported by the thread.
            let _ = thread.join();
        }
    }
}

/// Why a session ended.
enum SessionEnd {
    /// The viewer is closing.
    Closing,
    /// Anything else.
    Lost {
        cause: String,
        /// Whether another attempt can help.
        retry: bool,
        /// Delay requested by the server.
        hint: Option<Duration>,
    },
}

fn lost(cause: impl Into<String>, retry: bool) -> SessionEnd {
    SessionEnd::Lost { cause: cause.into(), retry, hint: None }
}

type Socket = WebSocketStream<Transport>;

struct Worker {
    settings: Settings,
    events: mpsc::Sender<StreamEvent>,
    commands: mpsc::Receiver<Command>,
    counters: Arc<Counters>,
}

impl Worker {
    async fn run(mut self) {
        let mut backoff =
            Backoff::new(FIRST_RETRY_DELAY, MAX_RETRY_DELAY, u64::from(std::process::id()) << 20);
        loop {
            let ended = self.session(&mut backoff).await;
            self.counters.credits.store(0, Ordering::Relaxed);
            let SessionEnd::Lost { cause, retry, hint } = ended else { return };
            let delay = retry.then(|| hint.unwrap_or_default().max(backoff.next_delay()));
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
    async fn session(&mut self, backoff: &mut Backoff) -> SessionEnd {
        let connected = tokio::select! {
            connected = timeout(CONNECT_TIMEOUT, connect(&self.settings)) => connected,
            () = self.events.closed() => return SessionEnd::Closing,
        };
        let mut socket = match connected {
            Ok(Ok(socket)) => socket,
            Ok(Err(error)) => return self.not_connected(&error),
            Err(_) => {
                return lost(format!("{} does not answer: check host and port", self.settings.url), true);
            }
        };
        // Commands for the previous session.
        while self.commands.try_recv().is_ok() {}
        let mut session = ClientSession::new(ClientConfig {
            digest: self.settings.digest,
            delivery: self.settings.delivery,
            token: self.settings.token.clone(),
            software: concat!("tombolo-view ", env!("CARGO_PKG_VERSION")).into(),
            window: WINDOW,
        });
        let ended = self.run_session(&mut socket, &mut session, backoff).await;
        let code = match &ended {
            Ok(SessionEnd::Closing) => CloseCode::Normal,
            Ok(SessionEnd::Lost { .. }) => return ended.unwrap_or(SessionEnd::Closing),
            Err(fault) => fault.close_code(),
        };
        let frame = ws::CloseFrame { code: code.code().into(), reason: "".into() };
        // Best effort: a failed closing handshake changes nothing.
        let _ = timeout(CLOSE_TIMEOUT, socket.close(Some(frame))).await;
        ended.unwrap_or_else(|fault| {
            let cause = format!("{}: {fault}", self.settings.url);
            lost(cause, code.is_retryable())
        })
    }

    async fn run_session(
        &mut self,
        socket: &mut Socket,
        session: &mut ClientSession,
        backoff: &mut Backoff,
    ) -> Result<SessionEnd, protocol::PeerFault> {
        let mut last_received = Instant::now();
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
                        None => return Ok(SessionEnd::Closing),
                    }
                    continue;
                }
                _ = pings.tick() => {
                    if last_received.elapsed() > IDLE_TIMEOUT {
                        let cause = format!("no message from {} for too long", self.settings.url);
                        return Ok(lost(cause, true));
                    }
                    if let Err(error) = socket.feed(Message::Ping(bytes::Bytes::new())).await {
                        return Ok(self.broken(&error, hint));
                    }
                    continue;
                }
                () = self.events.closed() => return Ok(SessionEnd::Closing),
            };
            last_received = Instant::now();
            let event = match message {
                Some(Ok(Message::Binary(frame))) => {
                    self.counters.bytes.fetch_add(frame.len() as u64, Ordering::Relaxed);
                    session.receive(DataFrame::Binary(&frame))?
                }
                Some(Ok(Message::Text(_))) => session.receive(DataFrame::Text)?,
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => continue,
                Some(Ok(Message::Close(frame))) => return Ok(self.closed(frame.as_ref(), hint)),
                Some(Err(error)) => return Ok(self.broken(&error, hint)),
                None => return Ok(self.closed(None, hint)),
            };
            let event = match event {
                Event::Welcome(welcome) => {
                    backoff.reset();
                    let world = WorldDigest(welcome.digest);
                    StreamEvent::Connected { world, world_seed: welcome.world_seed, server: welcome.software }
                }
                Event::Chunk { chunk, .. } => StreamEvent::Chunk(chunk),
                Event::Settled(settled) => StreamEvent::Settled { view: settled.view },
                Event::Refused(refused) => StreamEvent::Refused { detail: refused.detail.into_owned() },
                Event::Draining { reconnect_after_ms } => {
                    hint = Some(Duration::from_millis(reconnect_after_ms.into()));
                    continue;
                }
            };
            if self.send_event(event).await.is_err() {
                return Ok(SessionEnd::Closing);
            }
        }
    }

    async fn send_event(&self, event: StreamEvent) -> Result<(), mpsc::error::SendError<StreamEvent>> {
        self.events.send(event).await
    }

    fn not_connected(&self, error: &tungstenite::Error) -> SessionEnd {
        let url = &self.settings.url;
        match error {
            tungstenite::Error::Http(response) => {
                let status = response.status();
                let retry = status.is_server_error() || status.as_u16() == 429;
                lost(format!("{url} answered {status}: is it the stream of a tombolo-server?"), retry)
            }
            tungstenite::Error::Io(cause) => lost(
                format!(
                    "cannot connect to {url}: {cause}; start a server with `tombolo-server` \
                     or name one with --connect"
                ),
                true,
            ),
            other => lost(format!("{url} is not a Tombolo stream: {other}"), false),
        }
    }

    fn closed(&self, frame: Option<&ws::CloseFrame>, hint: Option<Duration>) -> SessionEnd {
        let url = &self.settings.url;
        let Some(frame) = frame else {
            return SessionEnd::Lost { cause: format!("{url} closed the connection"), retry: true, hint };
        };
        let number = u16::from(frame.code);
        let code = CloseCode::from_code(number);
        let words = code.map_or_else(|| format!("code {number}"), |code| code.to_string());
        let cause = match frame.reason.as_str() {
            "" => format!("{url} closed the connection: {words}"),
            reason => format!("{url} closed the connection: {words}: {reason}"),
        };
        // An unknown code comes from an intermediary: another attempt may help.
        let retry = code.is_none_or(|code| code.is_retryable() || code == CloseCode::Normal);
        SessionEnd::Lost { cause, retry, hint }
    }

    fn broken(&self, error: &tungstenite::Error, hint: Option<Duration>) -> SessionEnd {
        SessionEnd::Lost { cause: format!("lost {}: {error}", self.settings.url), retry: true, hint }
    }
}

async fn connect(settings: &Settings) -> Result<Socket, tungstenite::Error> {
    let url = &settings.url;
    // IPv6 addresses have brackets in URLs, but not in lookups.
    let host = url.host().unwrap_or_default().trim_matches(['[', ']']);
    let default_port = if settings.tls.is_some() { 443 } else { 80 };
    let stream = TcpStream::connect((host, url.port_u16().unwrap_or(default_port))).await?;
    // Small control frames must not be delayed.
    stream.set_nodelay(true)?;
    let stream = match &settings.tls {
        Some(tls) => tls.connect(host, stream).await?,
        None => Either::Left(stream),
    };
    let request = ClientRequestBuilder::new(url.clone()).with_sub_protocol(SUBPROTOCOL);
    let config = ws::WebSocketConfig::default()
        .max_message_size(Some(MAX_SERVER_FRAME))
        .max_frame_size(Some(MAX_SERVER_FRAME));
    Ok(client_async_with_config(request, stream, Some(config)).await?.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poll_until(source: &mut ServerStream, what: impl Fn(&StreamEvent) -> bool) -> StreamEvent {
        let limit = std::time::Instant::now() + Duration::from_secs(20);
        while std::time::Instant::now() < limit {
            match source.poll() {
                Some(event) if what(&event) => return event,
                Some(_) => {}
                None => std::thread::sleep(Duration::from_millis(2)),
            }
        }
        panic!("nothing happened");
    }

    fn connect_to(address: std::net::SocketAddr) -> ServerStream {
        let url = format!("ws://{address}/v1/stream").parse().unwrap();
        ServerStream::connect(Settings::new(url)).unwrap()
    }

    #[test]
    fn a_server_that_is_not_there_is_named_and_tried_again() {
        // A port that was free a moment ago.
        let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut source = connect_to(address);
        for _ in 0..2 {
            let event = poll_until(&mut source, |event| matches!(event, StreamEvent::Disconnected { .. }));
            let StreamEvent::Disconnected { cause, retry } = event else { unreachable!() };
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
        let mut source = connect_to(address);
        let event = poll_until(&mut source, |event| matches!(event, StreamEvent::Disconnected { .. }));
        let StreamEvent::Disconnected { cause, retry } = event else { unreachable!() };
        assert!(cause.contains("404") && retry.is_none(), "{cause}");
        server.join().unwrap();
    }
}
