//! A server in this process, and clients that write and read frames of RFC 6455 directly, so that
//! nothing is answered automatically.

use protocol::message::{ClientMessage, Hello, ServerMessage, WireKey};
use protocol::{Delivery, SUBPROTOCOL, control};
use server::ServerConfig;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// Timeout of every wait.
pub const TEST_TIMEOUT: Duration = Duration::from_secs(30);

/// Chunks that [`is_served`] requests.
const SERVED: usize = 16;

const BINARY: u8 = 2;
const CLOSE: u8 = 8;
const PING: u8 = 9;
const PONG: u8 = 10;

/// The defaults with one generation thread, and without a limit of memory: other tests of this
/// process take some of it.
pub fn config() -> ServerConfig {
    ServerConfig { threads: 1, memory: None, ..ServerConfig::default() }
}

/// The result of a wait, which must not take longer than [`TEST_TIMEOUT`].
pub async fn in_time<T>(wait: impl Future<Output = T>) -> T {
    tokio::time::timeout(TEST_TIMEOUT, wait).await.expect("it ends in time")
}

/// The request of a session.
pub fn upgrade_request() -> String {
    format!(
        "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
    )
}

pub fn hello() -> ClientMessage {
    let software = "hostile".into();
    ClientMessage::Hello(Hello { digest: None, delivery: Delivery::Exact, token: None, software })
}

/// A request of chunks of the sea, at most 512, in a row that is the same for each request.
pub fn request(id: u32, chunks: usize) -> ClientMessage {
    let keys = (0..chunks as i32).map(|n| WireKey { level: 0, x: 30_000 + n, z: 30_000 }).collect();
    ClientMessage::Request { id, keys }
}

/// A whole message, masked by zeros.
pub fn frame(message: &ClientMessage) -> Vec<u8> {
    control_frame(BINARY, &control::encode(message).unwrap())
}

fn control_frame(opcode: u8, payload: &[u8]) -> Vec<u8> {
    let length = match u8::try_from(payload.len()) {
        Ok(length @ 0..126) => vec![0x80 | length],
        _ => [&[0x80 | 126][..], &u16::try_from(payload.len()).unwrap().to_be_bytes()].concat(),
    };
    [&[0x80 | opcode][..], &length, &[0; 4], payload].concat()
}

/// All bytes until the connection ends, by a reset too.
pub async fn read_all(stream: &mut (impl AsyncRead + Unpin)) -> Vec<u8> {
    let mut bytes = Vec::new();
    in_time(async { while stream.read_buf(&mut bytes).await.is_ok_and(|count| count > 0) {} }).await;
    bytes
}

/// The answer to a GET over a new connection.
pub async fn get_over(mut stream: impl AsyncRead + AsyncWrite + Unpin, path: &str) -> String {
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    String::from_utf8(read_all(&mut stream).await).unwrap()
}

/// The value of a counter or gauge in the text of `/metrics`; its labels are part of the name.
pub fn value(text: &str, name: &str) -> u64 {
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("{name} is not in {text}")).parse().unwrap()
}

/// Requests a session. The status.
pub async fn upgrade(stream: &mut TcpStream) -> u16 {
    stream.write_all(upgrade_request().as_bytes()).await.unwrap();
    let mut head = Vec::new();
    let read = async {
        while !head.ends_with(b"\r\n\r\n") {
            head.push(stream.read_u8().await.unwrap());
        }
    };
    in_time(read).await;
    String::from_utf8(head).unwrap().split(' ').nth(1).unwrap().parse().unwrap()
}

/// A server, stopped when dropped.
pub struct Server {
    pub address: SocketAddr,
    stop: oneshot::Sender<()>,
    running: JoinHandle<()>,
}

impl Server {
    pub async fn start(config: ServerConfig) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel::<()>();
        let running = tokio::spawn(async move {
            let stopped = async {
                let _ = stopped.await;
            };
            server::run(listener, config, stopped).await.unwrap();
        });
        Self { address, stop, running }
    }

    /// Stops the server and waits for its end.
    pub async fn stop(self) {
        drop(self.stop);
        in_time(self.running).await.unwrap();
    }

    pub async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.unwrap()
    }

    pub async fn metrics(&self) -> String {
        get_over(self.connect().await, "/metrics").await
    }

    /// The sessions that ended for one of these reasons.
    pub async fn ended(&self, reasons: &[&str]) -> u64 {
        let text = self.metrics().await;
        let of = |reason| value(&text, &format!("tombolo_sessions_ended_total{{reason=\"{reason}\"}}"));
        reasons.iter().map(of).sum()
    }

    /// Waits until nothing of any client is left but the connection that asks.
    pub async fn is_empty(&self) {
        self.reaches(&[
            ("tombolo_sessions", 0),
            ("tombolo_connections", 1),
            ("tombolo_generation_pending_jobs", 0),
        ])
        .await;
    }

    /// Waits until metrics have these values.
    pub async fn reaches(&self, values: &[(&str, u64)]) {
        let start = tokio::time::Instant::now();
        loop {
            let text = self.metrics().await;
            if values.iter().all(|(name, expected)| value(&text, name) == *expected) {
                return;
            }
            assert!(start.elapsed() < TEST_TIMEOUT, "{values:?} is not reached: {text}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Asserts that a new client gets its chunks.
    pub async fn serves(&self) {
        is_served(&mut Session::open(self).await).await;
    }
}

/// Asserts that a session gets the chunks that it requests.
pub async fn is_served(session: &mut Session) {
    session.send(&ClientMessage::Credit { chunks: SERVED as u32 }).await;
    session.send(&request(1, SERVED)).await;
    session.receive_chunks(SERVED).await;
}

/// An answer of the server.
#[derive(Debug, PartialEq)]
pub enum Received {
    Chunk,
    Message(ServerMessage),
    Pong,
    Close(u16),
}

/// A session after its Welcome.
pub struct Session {
    stream: TcpStream,
}

impl Session {
    pub async fn open(server: &Server) -> Self {
        Self::over(server.connect().await).await
    }

    /// A session over a connection.
    pub async fn over(mut stream: TcpStream) -> Self {
        assert_eq!(upgrade(&mut stream).await, 101);
        let mut session = Self { stream };
        session.send(&hello()).await;
        let welcome = session.receive().await;
        assert!(matches!(welcome, Received::Message(ServerMessage::Welcome(_))), "{welcome:?}");
        session
    }

    pub fn into_stream(self) -> TcpStream {
        self.stream
    }

    pub async fn send(&mut self, message: &ClientMessage) {
        in_time(self.stream.write_all(&frame(message))).await.unwrap();
    }

    pub async fn receive(&mut self) -> Received {
        in_time(async {
            let opcode = self.stream.read_u8().await.unwrap() & 15;
            let length = match self.stream.read_u8().await.unwrap() {
                126 => usize::from(self.stream.read_u16().await.unwrap()),
                127 => usize::try_from(self.stream.read_u64().await.unwrap()).unwrap(),
                short => usize::from(short),
            };
            let mut payload = vec![0; length];
            self.stream.read_exact(&mut payload).await.unwrap();
            match opcode {
                PONG => Received::Pong,
                CLOSE => Received::Close(u16::from_be_bytes([payload[0], payload[1]])),
                BINARY => control::decode(&payload).map_or(Received::Chunk, Received::Message),
                other => panic!("a frame of opcode {other}"),
            }
        })
        .await
    }

    /// Receives so many chunks and nothing else.
    pub async fn receive_chunks(&mut self, count: usize) {
        for number in 0..count {
            assert_eq!(self.receive().await, Received::Chunk, "chunk {number} of {count}");
        }
    }

    /// Asserts that the server has nothing to send: the answer to a ping is the next one.
    pub async fn has_nothing(&mut self) {
        in_time(self.stream.write_all(&control_frame(PING, b""))).await.unwrap();
        assert_eq!(self.receive().await, Received::Pong);
    }
}
