//! Log lines about peers that break the rules, for each address and reason. Each kind of peer has
//! an address of its own, which only Linux has on the loopback device.

use crate::running::{Server, TEST_TIMEOUT, peer_lines};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;

/// Times that each peer breaks its rule.
const TIMES: u8 = 3;

/// Sessions that an address may have, and connections beyond them.
const SESSIONS: usize = 4;
const EXTRA_CONNECTIONS_PER_IP: usize = 64;

async fn connect(server: &Server, last_byte: u8) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind(([127, 0, 0, last_byte], 0).into()).unwrap();
    socket.connect(server.address.parse().unwrap()).await.unwrap()
}

/// All bytes until the connection ends, by a reset too.
async fn read_all(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let read = async { while stream.read_buf(&mut bytes).await.is_ok_and(|count| count > 0) {} };
    timeout(TEST_TIMEOUT, read).await.expect("the server ends the connection");
    bytes
}

/// The head of the answer to a request.
async fn head(stream: &mut TcpStream, request: &str) -> String {
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut head = Vec::new();
    let read = async {
        while !head.ends_with(b"\r\n\r\n") {
            head.push(stream.read_u8().await.unwrap());
        }
    };
    timeout(TEST_TIMEOUT, read).await.expect("an answer");
    String::from_utf8(head).unwrap()
}

fn upgrade(more: &str) -> String {
    format!(
        "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: {}\r\n{more}\r\n",
        protocol::SUBPROTOCOL
    )
}

fn has_status(head: &str, status: u16) -> bool {
    head.starts_with(&format!("HTTP/1.1 {status} "))
}

/// Opens connections until one is closed at once.
async fn too_many_connections(server: &Server, last_byte: u8) {
    let mut open = Vec::new();
    for _ in 0..SESSIONS + EXTRA_CONNECTIONS_PER_IP {
        let mut stream = connect(server, last_byte).await;
        let answer = head(&mut stream, "GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n").await;
        assert!(has_status(&answer, 200), "{answer}");
        open.push(stream);
    }
    for _ in 0..TIMES {
        assert!(read_all(&mut connect(server, last_byte).await).await.is_empty());
    }
}

async fn too_many_sessions(server: &Server, last_byte: u8) {
    let mut open = Vec::new();
    for _ in 0..SESSIONS {
        let mut stream = connect(server, last_byte).await;
        assert!(has_status(&head(&mut stream, &upgrade("")).await, 101));
        open.push(stream);
    }
    for _ in 0..TIMES {
        let answer = head(&mut connect(server, last_byte).await, &upgrade("")).await;
        assert!(has_status(&answer, 503), "{answer}");
    }
}

/// Sends bytes after the handshake of a session, which the server ends. No session waits for the
/// place of one before: a refusal would have a line too.
async fn breach(server: &Server, last_byte: u8, frame: &[u8]) {
    assert!(usize::from(TIMES) <= SESSIONS);
    for _ in 0..TIMES {
        let mut stream = connect(server, last_byte).await;
        assert!(has_status(&head(&mut stream, &upgrade("")).await, 101));
        stream.write_all(frame).await.unwrap();
        // The server need not wait for an answer to its Close frame.
        stream.shutdown().await.unwrap();
        read_all(&mut stream).await;
    }
}

#[tokio::test]
async fn a_peer_that_breaks_a_rule_has_lines_with_its_address_the_reason_and_all_events() {
    let sessions = SESSIONS.to_string();
    let server = Server::start(&["--listen", "127.0.0.1:0", "--max-sessions-per-address", &sessions]);
    for _ in 0..TIMES {
        let evil = "GET /livez HTTP/1.1\r\nHost: evil.example\r\n\r\n";
        assert!(has_status(&head(&mut connect(&server, 11).await, evil).await, 421));
        let foreign = upgrade("Origin: http://evil.example\r\n");
        assert!(has_status(&head(&mut connect(&server, 12).await, &foreign).await, 403));
        let mut malformed = connect(&server, 15).await;
        malformed.write_all(b"\x00\x01\x02 no request\r\n\r\n").await.unwrap();
        assert!(read_all(&mut malformed).await.starts_with(b"HTTP/1.1 400 "));
    }
    too_many_connections(&server, 13).await;
    too_many_sessions(&server, 14).await;
    // A text, a frame without a mask, and a message that none is.
    breach(&server, 16, &[0x81, 0x81, 0, 0, 0, 0, b'a']).await;
    breach(&server, 17, &[0x82, 0x01, 0]).await;
    breach(&server, 18, &[0x82, 0x81, 0, 0, 0, 0, 0]).await;
    // The control: a peer that keeps the rules.
    assert!(has_status(&head(&mut connect(&server, 19).await, &upgrade("")).await, 101));

    let log = server.log();
    let lines = peer_lines(&log);
    assert!(lines.iter().all(|(line, _)| line.contains("WARN") && !line.contains("127.0.0.19")), "{log}");
    for (last_byte, reason) in [
        (11, "unknown host name"),
        (12, "page of another origin"),
        (13, "too many connections"),
        (14, "too many sessions"),
        (15, "malformed HTTP"),
        (16, "text_frame"),
        (17, "protocol_error"),
        (18, "malformed"),
    ] {
        let about = format!("address=\"127.0.0.{last_byte}\" reason=\"{reason}\"");
        let of_peer = lines.iter().filter(|(line, _)| line.contains(&about));
        let events: Vec<u64> = of_peer.map(|(_, events)| *events).collect();
        // The first event at once, and the others before the server ends.
        assert_eq!(
            (events.first(), events.iter().sum::<u64>()),
            (Some(&1), u64::from(TIMES)),
            "{about}: {log}"
        );
    }
}

/// Before, the first thread that logged stopped with the lock of standard error, and soon all did.
#[tokio::test]
async fn a_log_that_is_not_read_does_not_stop_the_server() {
    let server = Server::start(&["--listen", "127.0.0.1:0"]);
    // One line for each address, together more than a pipe holds.
    for number in 0..900_u16 {
        let [high, low] = number.to_be_bytes();
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind(([127, 0, 2 + high, low], 0).into()).unwrap();
        let mut stream = socket.connect(server.address.parse().unwrap()).await.unwrap();
        stream.write_all(b"no HTTP\r\n\r\n").await.unwrap();
        read_all(&mut stream).await;
    }
    assert!(server.get("/livez", "").starts_with("HTTP/1.1 200"));
    let log = server.log();
    assert!(log.len() > 64 << 10, "the control: {} bytes in {} lines", log.len(), log.lines().count());
}
