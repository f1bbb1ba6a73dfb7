//! A server in this process, and requests written byte by byte, so that no client library corrects
//! them.

use futures_util::{SinkExt, StreamExt};
use protocol::control;
use protocol::message::{ClientMessage, Hello, ServerMessage};
use server::ServerConfig;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;
use terrain::Land;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::client::{Request, Response};

/// Timeout of every wait.
pub const TEST_TIMEOUT: Duration = Duration::from_secs(30);

pub struct Server {
    pub address: SocketAddr,
    /// Stops the server when dropped.
    stop: oneshot::Sender<()>,
    running: JoinHandle<()>,
}

/// Headers of a session's request with one subprotocol entry.
pub const UPGRADE: [(&str, &str); 5] = [
    ("Connection", "upgrade, close"),
    ("Upgrade", "websocket"),
    ("Sec-WebSocket-Version", "13"),
    ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ("Sec-WebSocket-Protocol", protocol::SUBPROTOCOL),
];

/// A response.
#[derive(Debug)]
pub struct Reply {
    pub status: u16,
    headers: BTreeMap<String, String>,
    pub body: Vec<u8>,
}

impl Server {
    pub async fn start() -> Self {
        Self::start_with(ServerConfig { threads: 2, ..ServerConfig::default() }).await
    }

    pub async fn start_with(config: ServerConfig) -> Self {
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
        tokio::time::timeout(TEST_TIMEOUT, self.running).await.expect("the server ends in time").unwrap();
    }

    /// The value of a counter or gauge in `/metrics`; its labels are part of the name.
    pub async fn metric(&self, name: &str) -> f64 {
        let text = String::from_utf8(self.get("/metrics").await.body).unwrap();
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("{name} is not in {text}")).parse().unwrap()
    }

    /// The path of a resource of this server's world, such as `chunk/0/0/0`.
    pub fn path(&self, rest: &str) -> String {
        format!("/v1/{}/{rest}", Land::new(1).digest())
    }

    pub async fn get(&self, path: &str) -> Reply {
        self.request("GET", path, &[]).await
    }

    /// A request for a session; `more` are further headers.
    pub async fn upgrade(&self, more: &[(&str, &str)]) -> Reply {
        self.request("GET", "/v1/stream", &[&UPGRADE, more].concat()).await
    }

    /// As [`Server::request`], from another address of the loopback device.
    pub async fn request_from(&self, source: [u8; 4], path: &str, headers: &[(&str, &str)]) -> Reply {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind((source, 0).into()).unwrap();
        request_over(socket.connect(self.address).await.unwrap(), "GET", path, headers).await
    }

    /// Asks for a session from an address of the loopback device; the status, and the connection,
    /// which keeps the session open.
    pub async fn open_session_from(&self, source: [u8; 4]) -> (u16, TcpStream) {
        self.open_session_with(source, &[], &[]).await
    }

    /// As [`Server::open_session_from`], with bytes before the request and further headers.
    pub async fn open_session_with(
        &self,
        source: [u8; 4],
        before: &[u8],
        more: &[(&str, &str)],
    ) -> (u16, TcpStream) {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind((source, 0).into()).unwrap();
        let mut stream = socket.connect(self.address).await.unwrap();
        stream.write_all(before).await.unwrap();
        let reply = request_over(&mut stream, "GET", "/v1/stream", &[&UPGRADE, more].concat()).await;
        (reply.status, stream)
    }

    pub async fn request(&self, method: &str, path: &str, headers: &[(&str, &str)]) -> Reply {
        let stream = TcpStream::connect(self.address).await.unwrap();
        request_over(stream, method, path, headers).await
    }
}

/// Opens a session and sends its hello; the response to the handshake, and the close code of the
/// session, none for a welcome.
pub async fn welcomed<S: AsyncRead + AsyncWrite + Unpin>(
    request: Request,
    stream: S,
    token: Option<&str>,
) -> (Response, Option<u16>) {
    let hello = Hello {
        digest: None,
        delivery: protocol::Delivery::Exact,
        token: token.map(ToOwned::to_owned),
        software: "test".into(),
    };
    let hello = control::encode(&ClientMessage::Hello(hello)).unwrap();
    let (mut socket, response) = client_async(request, stream).await.unwrap();
    socket.send(Message::Binary(hello)).await.unwrap();
    let next = async {
        loop {
            match socket.next().await.expect("an answer").unwrap() {
                Message::Binary(bytes)
                    if matches!(control::decode(&bytes), Ok(ServerMessage::Welcome(_))) =>
                {
                    return None;
                }
                Message::Close(frame) => return Some(frame.unwrap().code.into()),
                _ => {}
            }
        }
    };
    (response, tokio::time::timeout(TEST_TIMEOUT, next).await.expect("the server answers in time"))
}

/// All bytes until the connection ends, by a reset too.
pub async fn read_all(mut stream: TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let read = async { while stream.read_buf(&mut bytes).await.is_ok_and(|count| count > 0) {} };
    tokio::time::timeout(TEST_TIMEOUT, read).await.expect("the server closes in time");
    bytes
}

/// One request over a new connection, read to the end of the connection or, for an upgrade, of the
/// head.
pub async fn request_over<S: AsyncRead + AsyncWrite + Unpin>(
    mut stream: S,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
) -> Reply {
    let mut request = format!("{method} {path} HTTP/1.1\r\n");
    if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("host")) {
        request += "Host: localhost\r\n";
    }
    if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("connection")) {
        request += "Connection: close\r\n";
    }
    for (name, value) in headers {
        request += &format!("{name}: {value}\r\n");
    }
    request += "\r\n";
    stream.write_all(request.as_bytes()).await.unwrap();
    let read = async {
        let mut bytes = Vec::new();
        while stream.read_buf(&mut bytes).await.unwrap() > 0 {
            if bytes.starts_with(b"HTTP/1.1 101") && bytes.ends_with(b"\r\n\r\n") {
                break;
            }
        }
        bytes
    };
    let bytes = tokio::time::timeout(TEST_TIMEOUT, read).await.expect("the server answers in time");
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a whole head");
    let head = std::str::from_utf8(&bytes[..end]).unwrap();
    let mut lines = head.lines();
    let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
    let headers = lines
        .map(|line| line.split_once(": ").unwrap())
        .map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned()))
        .collect();
    Reply { status, headers, body: bytes[end + 4..].to_vec() }
}

impl Reply {
    /// A header; empty if it is missing.
    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", String::as_str)
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The kind of a valid problem document.
    pub fn problem(&self) -> String {
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], self.status);
        assert!(["title", "detail"].iter().all(|part| !problem[part].as_str().unwrap().is_empty()));
        let kind = problem["type"].as_str().unwrap();
        kind.strip_prefix("/openapi.json#/components/examples/").unwrap().to_owned()
    }
}
