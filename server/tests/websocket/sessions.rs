//! Violations of RFC 6455 and Close frames in sessions of a server, over TCP.

use crate::cases::close::{INVALID_CODES, VALID_CODES};
use crate::frame::{BINARY, CLOSE, CONTINUATION, Frame, Length, PING, PONG, TEXT, parse};
use protocol::{CloseCode, SUBPROTOCOL};
use server::ServerConfig;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;

/// Longest wait; a test that reaches it fails.
const TEST_TIMEOUT: Duration = Duration::from_secs(30);

/// A server in this process, stopped when dropped.
pub struct Server {
    address: SocketAddr,
    _stop: oneshot::Sender<()>,
}

impl Server {
    pub async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel::<()>();
        tokio::spawn(async move {
            let config = ServerConfig { threads: 1, ..ServerConfig::default() };
            let stopped = async {
                let _ = stopped.await;
            };
            server::run(listener, config, stopped).await.unwrap();
        });
        Self { address, _stop: stop }
    }

    pub async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.unwrap()
    }

    /// A connection after its handshake.
    async fn open(&self) -> TcpStream {
        let mut stream = self.connect().await;
        let request = format!(
            "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            head.push(stream.read_u8().await.unwrap());
        }
        assert!(head.starts_with(b"HTTP/1.1 101 "));
        stream
    }

    /// Sends frames in one write. Returns what is received until the end of the connection, which
    /// must be no reset.
    async fn exchange(&self, frames: &[Frame]) -> Vec<(u8, Vec<u8>)> {
        let mut stream = self.open().await;
        let bytes: Vec<u8> = frames.iter().flat_map(Frame::bytes).collect();
        stream.write_all(&bytes).await.unwrap();
        let mut received = Vec::new();
        let read = tokio::time::timeout(TEST_TIMEOUT, stream.read_to_end(&mut received)).await;
        read.expect("the connection ends").expect("the connection is not reset");
        parse(&received).unwrap()
    }

    /// The code of the Close frame that is the only answer.
    async fn code(&self, name: &str, frames: &[Frame]) -> u16 {
        let mut received = self.exchange(frames).await;
        let last = received.pop();
        assert!(received.is_empty(), "{name}: {received:?}");
        match last {
            Some((CLOSE, payload)) => u16::from_be_bytes([payload[0], payload[1]]),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_violation_ends_a_session_with_1002() {
    let server = Server::start().await;
    let mut cases = vec![
        ("unmasked", vec![Frame { is_masked: false, ..Frame::new(BINARY, "x") }]),
        ("a ping of 126 bytes", vec![Frame::new(PING, [0; 126])]),
        ("a pong of 126 bytes", vec![Frame::new(PONG, [0; 126])]),
        ("a Close frame of 126 bytes", vec![Frame::close(1000, [b'x'; 124])]),
        ("a fragmented ping", vec![Frame::part(PING, "x")]),
        ("a fragmented Close frame", vec![Frame::part(CLOSE, [3, 0xe8])]),
        ("a stray continuation", vec![Frame::new(CONTINUATION, "x")]),
        ("a stray fragment", vec![Frame::part(CONTINUATION, "x")]),
        ("interleaved data", vec![Frame::part(BINARY, "x"), Frame::new(BINARY, "y")]),
        ("a longer form of the length", vec![Frame { length: Length::Long, ..Frame::new(BINARY, "x") }]),
        ("a length of 2^63", vec![Frame { length: Length::False(1 << 63), ..Frame::new(BINARY, "x") }]),
    ];
    cases.extend([3, 7, 11, 15].map(|opcode| ("an opcode without a meaning", vec![Frame::new(opcode, "")])));
    cases.extend(
        [1, 2, 4].map(|reserved| ("a reserved bit", vec![Frame { reserved, ..Frame::new(BINARY, "x") }])),
    );
    for (name, frames) in cases {
        assert_eq!(server.code(name, &frames).await, CloseCode::ProtocolError.code(), "{name}");
    }
    // The control: the frames of a protocol fault are valid.
    assert_eq!(server.code("a fault", &[Frame::new(BINARY, "x")]).await, CloseCode::Malformed.code());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn text_ends_a_session_with_1003_and_text_that_is_not_utf8_with_1007() {
    let server = Server::start().await;
    for (name, frames, code) in [
        ("text", vec![Frame::new(TEXT, "κόσμε")], CloseCode::TextFrame),
        ("not UTF-8", vec![Frame::new(TEXT, b"\xed\xa0\x80")], CloseCode::NotUtf8),
        ("cut", vec![Frame::part(TEXT, b"\xe2\x82"), Frame::new(CONTINUATION, "")], CloseCode::NotUtf8),
        ("a reason", vec![Frame::close(1000, b"\xff")], CloseCode::NotUtf8),
    ] {
        assert_eq!(server.code(name, &frames).await, code.code(), "{name}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn close_codes_are_answered_by_themselves_or_by_1002() {
    let server = Server::start().await;
    for code in VALID_CODES {
        assert_eq!(server.code("valid", &[Frame::close(code, "reason")]).await, code);
    }
    for code in INVALID_CODES {
        assert_eq!(server.code("invalid", &[Frame::close(code, "")]).await, 1002, "{code}");
    }
    assert_eq!(server.code("empty", &[Frame::new(CLOSE, "")]).await, 1000);
    assert_eq!(server.code("one byte", &[Frame::new(CLOSE, [3])]).await, 1002);
}

/// Data behind a Close frame or a violation, more than one read: closing with it unread would reset
/// the connection, and the client would lose the Close frame.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn data_behind_the_end_of_a_session_resets_no_connection() {
    let server = Server::start().await;
    for (last, code) in [
        (Frame::close(4000, ""), 4000),
        (Frame::close(1005, ""), 1002),
        (Frame::new(3, ""), 1002),
        (Frame::new(TEXT, "text"), 1003),
        (Frame::new(BINARY, "no message"), 4400),
        (Frame::new(BINARY, vec![0; 100_000]), 1009),
    ] {
        let mut stream = server.open().await;
        stream.write_all(&last.bytes()).await.unwrap();
        let behind = Frame::new(BINARY, vec![7; 60_000]).bytes();
        for _ in 0..20 {
            // A server that ends its side goes on reading.
            stream.write_all(&behind).await.unwrap();
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let mut received = Vec::new();
        let read = tokio::time::timeout(TEST_TIMEOUT, stream.read_to_end(&mut received)).await;
        read.expect("the connection ends").expect("the connection is not reset");
        let frames = parse(&received).unwrap();
        let [(CLOSE, payload)] = &frames[..] else { panic!("{code}: {frames:?}") };
        assert_eq!(u16::from_be_bytes([payload[0], payload[1]]), code);
    }
}
