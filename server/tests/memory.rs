//! Memory that the server holds for an idle client: bytes of the heap that are live while the
//! session is open. With huge pages all of them are resident, used or not.
//!
//! A test binary of its own, because it replaces the allocator.

use protocol::message::{ClientMessage, Hello};
use protocol::{Delivery, SUBPROTOCOL, control};
use server::ServerConfig;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;
use test_support::counting_allocator::{CountingAllocator, live};
use tokio::net::TcpListener;
use tokio::sync::oneshot;

/// Most bytes for one idle client, of which the task of its session takes about half. A buffer,
/// table or queue that an idle client does not use must be small or be allocated at its first use.
const MAX_IDLE: usize = 6 * 1024;

/// Clients that are measured, and clients that connect before: what the first ones allocate for all
/// is not counted.
const CLIENTS: usize = 200;
const WARM_UP: usize = 20;

/// Timeout of every wait.
const TEST_TIMEOUT: Duration = Duration::from_secs(30);

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Clients that have their Welcome and send nothing more.
fn connect(address: SocketAddr, count: usize) -> Vec<TcpStream> {
    let request = format!(
        "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
    );
    let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: "test".into() };
    let hello = control::encode(&ClientMessage::Hello(hello)).unwrap();
    // A whole binary message, masked by zeros.
    let hello = [&[0x82, 0x80 | u8::try_from(hello.len()).unwrap(), 0, 0, 0, 0], &hello[..]].concat();
    let client = |_| {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            head.extend(byte);
        }
        assert!(head.starts_with(b"HTTP/1.1 101 "), "{}", String::from_utf8_lossy(&head));
        stream.write_all(&hello).unwrap();
        let mut start = [0; 2];
        stream.read_exact(&mut start).unwrap();
        assert_eq!(start[0], 0x82, "the Welcome");
        stream.read_exact(&mut vec![0; usize::from(start[1])]).unwrap();
        stream
    };
    (0..count).map(client).collect()
}

/// Bytes that are live on this thread after some work, beyond those before it, for each client.
async fn bytes_per_client<T>(work: impl Future<Output = T>) -> (usize, T) {
    let before = live();
    let result = work.await;
    ((live() - before) as usize / CLIENTS, result)
}

/// The server runs on this thread, whose bytes are counted, and the clients on others.
#[tokio::test]
async fn an_idle_client_takes_little_memory() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let (stop, stopped) = oneshot::channel::<()>();
    let config = ServerConfig { threads: 1, ..ServerConfig::default() };
    let running = tokio::spawn(server::run(listener, config, async {
        let _ = stopped.await;
    }));
    let clients = async |count| tokio::task::spawn_blocking(move || connect(address, count)).await.unwrap();
    let first = clients(WARM_UP).await;
    let (idle, measured) = bytes_per_client(clients(CLIENTS)).await;
    // Less than a session's own state: the sessions would run on a thread that is not counted.
    assert!((1_024..=MAX_IDLE).contains(&idle), "{idle} bytes of {MAX_IDLE}");
    let too_much = || (0..CLIENTS).map(|_| vec![0u8; MAX_IDLE + 1]).collect::<Vec<_>>();
    assert!(bytes_per_client(async { too_much() }).await.0 > MAX_IDLE, "the count sees too much");
    drop((first, measured, stop));
    running.await.unwrap().unwrap();
}
