//! Heads of requests over their limit, and the memory of those below it.

use crate::client::{Server, config, in_time, read_all};
use server::ServerConfig;
use std::io::Write;
use std::time::Duration;
use test_support::counting_allocator::live;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

/// The documented limit of a head, bytes.
const LIMIT: usize = 16 * 1024;

/// Connections whose memory is measured, and connections before: what the first ones allocate for
/// all is not counted.
const CONNECTIONS: usize = 100;
const WARM_UP: usize = 10;

/// Most bytes for one unfinished head: the buffer, which grows by doubling, and the task of its
/// connection.
const MAX_LIVE: usize = 2 * LIMIT + 8 * 1024;

/// A server that waits for heads as long as a test runs.
async fn patient_server() -> Server {
    Server::start(ServerConfig { handshake_timeout: Duration::from_secs(120), ..config() }).await
}

#[tokio::test]
async fn a_head_over_its_limit_is_rejected_with_431_whatever_is_long_in_it() {
    let server = patient_server().await;
    let long = "a".repeat(LIMIT);
    let many: String = (0..1000).map(|number| format!("X-{number}: 1\r\n")).collect();
    for (name, head) in [
        ("a value", format!("GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Long: {long}")),
        ("a name", format!("GET /livez HTTP/1.1\r\nHost: localhost\r\nX-{long}")),
        ("a path", format!("GET /{long}")),
        ("a query", format!("GET /livez?{long}")),
        ("many headers", format!("GET /livez HTTP/1.1\r\nHost: localhost\r\n{many}\r\n")),
        ("a handshake", format!("GET /v1/stream HTTP/1.1\r\nSec-WebSocket-Protocol: {long}")),
    ] {
        let mut stream = server.connect().await;
        stream.write_all(head.as_bytes()).await.unwrap();
        let reply = read_all(&mut stream).await;
        let status = String::from_utf8_lossy(&reply[..reply.len().min(12)]);
        assert_eq!(status, "HTTP/1.1 431", "{name}");
        server.serves().await;
    }
    server.is_empty().await;
    server.stop().await;
}

/// Connections with heads that lack 100 bytes to the limit, written in pieces from another thread:
/// their bytes are not counted.
async fn unfinished(server: &Server, count: usize, piece: usize) -> Vec<TcpStream> {
    let address = server.address;
    let open = move || {
        let head = format!("GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Long: {}", "a".repeat(LIMIT));
        let connect = |_| {
            let mut stream = std::net::TcpStream::connect(address).unwrap();
            stream.set_nodelay(true).unwrap();
            for bytes in head.as_bytes()[..LIMIT - 100].chunks(piece) {
                stream.write_all(bytes).unwrap();
                std::thread::yield_now();
            }
            stream.set_nonblocking(true).unwrap();
            stream
        };
        (0..count).map(connect).collect::<Vec<_>>()
    };
    let streams = tokio::task::spawn_blocking(open).await.unwrap();
    streams.into_iter().map(|stream| TcpStream::from_std(stream).unwrap()).collect()
}

#[tokio::test]
async fn heads_below_the_limit_take_no_more_memory_than_twice_the_limit() {
    let server = patient_server().await;
    let first = unfinished(&server, WARM_UP, LIMIT).await;
    for piece in [LIMIT, 1024] {
        server.serves().await;
        server.reaches(&[("tombolo_sessions", 0), ("tombolo_connections", 1 + WARM_UP as u64)]).await;
        let before = live();
        let mut measured = unfinished(&server, CONNECTIONS, piece).await;
        let each = || (live() - before) as usize / CONNECTIONS;
        in_time(async {
            while each() < LIMIT - 100 {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
        .await;
        // Once another client is served, the last bytes of the heads are read too.
        server.serves().await;
        let open = (1 + WARM_UP + CONNECTIONS) as u64;
        server.reaches(&[("tombolo_sessions", 0), ("tombolo_connections", open)]).await;
        assert!(each() <= MAX_LIVE, "{} bytes of {MAX_LIVE}, pieces of {piece}", each());
        for stream in &mut measured {
            stream.write_all(&[b'a'; 4 * 1024]).await.unwrap();
            assert!(read_all(stream).await.starts_with(b"HTTP/1.1 431 "));
        }
    }
    drop(first);
    server.is_empty().await;
    server.stop().await;
}
