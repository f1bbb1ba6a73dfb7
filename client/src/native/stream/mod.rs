//! The chunk stream of a server: a WebSocket session on its own thread, restarted when it ends.
//!
//! The server is not trusted: `stream::guarded_session` decides what is taken from it. Here are the
//! channels to the drawing thread; the thread itself is in `worker`, its socket in `socket`.

mod socket;
mod worker;

use crate::stream::guarded_session::Rejects;
use crate::stream::{ChunkStream, StreamEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use tls_client::TlsClient;
use tokio::sync::mpsc;
use tokio_tungstenite::tungstenite::http::Uri;
use worker::Worker;

/// Capacity for events to the drawing thread. When it is full the session stops reading: no credit
/// is granted, and the server waits. Bounds the decoded chunks between the threads to a few MiB.
pub const EVENT_CAPACITY: usize = 256;
/// Capacity for commands to the session. When it is full they are queued by the caller until the
/// next poll.
const COMMAND_CAPACITY: usize = 64;

/// Time limits of the viewer for a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// For the connection and the WebSocket handshake.
    pub connect: Duration,
    /// For the Welcome.
    pub welcome: Duration,
    /// Until the server takes what is written to it.
    pub write: Duration,
    /// Between two pings.
    pub ping: Duration,
    /// Without any message: several pings were not answered.
    pub idle: Duration,
    /// Without a chunk or the end of a view while some are due. Longer than a server under load
    /// lets a view wait.
    pub progress: Duration,
    /// First delay before a new connection, and before a chunk is requested again.
    pub first_retry: Duration,
    /// Longest such delay.
    pub longest_retry: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            connect: Duration::from_secs(10),
            welcome: Duration::from_secs(10),
            write: Duration::from_secs(10),
            ping: Duration::from_secs(10),
            idle: Duration::from_secs(35),
            progress: Duration::from_secs(120),
            first_retry: Duration::from_millis(250),
            longest_retry: Duration::from_secs(10),
        }
    }
}

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
    /// Time limits.
    pub timeouts: Timeouts,
}

impl Settings {
    /// Any world, exact, without a token.
    #[must_use]
    pub fn new(url: Uri) -> Self {
        Self {
            url,
            tls: None,
            token: None,
            digest: None,
            delivery: Delivery::Exact,
            timeouts: Timeouts::default(),
        }
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
    bad: AtomicU64,
    refused: AtomicU64,
    retried: AtomicU64,
}

impl Counters {
    fn add(&self, rejects: Rejects) {
        self.bad.fetch_add(rejects.bad, Ordering::Relaxed);
        self.refused.fetch_add(rejects.refused, Ordering::Relaxed);
        self.retried.fetch_add(rejects.retried, Ordering::Relaxed);
    }
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
        let thread = std::thread::Builder::new().name("tombolo-stream".into()).spawn(move || {
            runtime.block_on(worker.run());
            // Not waited for: a name that is still looked up may take the resolver's whole time.
            runtime.shutdown_background();
        })?;
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
            waiting_events: self.events.as_ref().map_or(0, mpsc::Receiver::len),
            bad_chunks: self.counters.bad.load(Ordering::Relaxed),
            refused_chunks: self.counters.refused.load(Ordering::Relaxed),
            retried_chunks: self.counters.retried.load(Ordering::Relaxed),
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
