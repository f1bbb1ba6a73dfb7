//! Connections that never finish a head: a byte at a time, or none at all.

use crate::client::{Server, config, get_over, in_time, read_all};
use server::ServerConfig;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

/// Starts of heads; the last byte of each may be repeated without end.
const STARTS: [&str; 4] = [
    "GET /a",
    "GET /livez HTTP/1.1\r\nHost: localhost\r\nX-a",
    "GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: a",
    "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nSec-WebSocket-Protocol: a",
];

/// Connections for each of them, and connections without a byte.
const EACH: usize = 4;

/// Time between two bytes.
const PAUSE: Duration = Duration::from_millis(20);

fn short_timeouts() -> ServerConfig {
    ServerConfig { handshake_timeout: Duration::from_millis(700), ..config() }
}

/// Writes a head byte by byte until the connection ends. What was answered, and the bytes written.
async fn dribble(mut stream: TcpStream, start: &'static str) -> (Vec<u8>, usize) {
    let mut written = 0;
    let bytes = start.bytes().chain(std::iter::repeat(b'a'));
    let mut answer = [0; 1024];
    for byte in bytes {
        match stream.try_read(&mut answer) {
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
            // The end, or an answer before it.
            Ok(count) if count > 0 => {
                let rest = read_all(&mut stream).await;
                return ([&answer[..count], &rest].concat(), written);
            }
            Ok(_) | Err(_) => break,
        }
        if stream.write_all(&[byte]).await.is_err() {
            break;
        }
        written += 1;
        tokio::time::sleep(PAUSE).await;
    }
    (Vec::new(), written)
}

#[tokio::test]
async fn a_head_that_comes_byte_by_byte_ends_with_its_time_and_others_are_served() {
    let server = Server::start(short_timeouts()).await;
    let mut session = crate::client::Session::open(&server).await;
    let mut slow = tokio::task::JoinSet::new();
    for start in STARTS.into_iter().cycle().take(EACH * STARTS.len()) {
        slow.spawn(dribble(server.connect().await, start));
    }
    server.serves().await;
    crate::client::is_served(&mut session).await;
    let ended = in_time(slow.join_all()).await;
    let mut longest = 0;
    for (answer, written) in ended {
        // None, or one of an error: no part of a head is taken as a request.
        assert!(answer.is_empty() || answer.starts_with(b"HTTP/1.1 4"), "{answer:?}");
        longest = longest.max(written);
    }
    session.has_nothing().await;
    drop(session);
    server.is_empty().await;
    server.stop().await;

    // The control: a server with more time takes as many bytes, at the same pace, and their end.
    let patient =
        Server::start(ServerConfig { handshake_timeout: Duration::from_secs(120), ..config() }).await;
    let mut stream = patient.connect().await;
    let start = STARTS[2];
    for byte in start.bytes().chain(std::iter::repeat(b'a')).take(longest.max(start.len())) {
        stream.write_all(&[byte]).await.unwrap();
        tokio::time::sleep(PAUSE).await;
    }
    stream.write_all(b"\r\nConnection: close\r\n\r\n").await.unwrap();
    assert!(read_all(&mut stream).await.starts_with(b"HTTP/1.1 200 "));
    patient.stop().await;
}

#[tokio::test]
async fn a_connection_without_a_byte_ends_with_the_time_of_a_head() {
    let server = Server::start(short_timeouts()).await;
    let mut silent = Vec::new();
    for _ in 0..EACH {
        silent.push(server.connect().await);
    }
    // One that is half open: its client has ended its own direction too.
    let mut half = server.connect().await;
    half.shutdown().await.unwrap();
    server.serves().await;
    for stream in silent.iter_mut().chain([&mut half]) {
        let answer = read_all(stream).await;
        assert!(answer.is_empty() || answer.starts_with(b"HTTP/1.1 4"), "{answer:?}");
    }
    server.is_empty().await;
    assert!(get_over(server.connect().await, "/livez").await.starts_with("HTTP/1.1 200 "));
    server.stop().await;
}
