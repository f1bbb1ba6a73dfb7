//! Clients that hang up at any moment leave nothing on the heap.
//!
//! A test binary of its own, because it replaces the allocator.

use protocol::message::{ClientMessage, Hello, WireKey};
use protocol::{Delivery, SUBPROTOCOL, control};
use server::ServerConfig;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;
use test_support::counting_allocator::{CountingAllocator, live_of_all_threads};
use tokio::net::TcpListener;
use tokio::sync::oneshot;

/// Cycles that fill caches and tables, and cycles that must leave nothing.
const WARM_UP: usize = 1000;
const CYCLES: usize = 20_000;

/// Bytes that may remain of the measured cycles: four for each. The connection that asks for
/// metrics may still be open with its buffers, whatever their number.
const MAX_LEFT: isize = 4 * CYCLES as isize;

/// Timeout of every wait.
const TEST_TIMEOUT: Duration = Duration::from_secs(30);

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// A whole binary message, masked by zeros.
fn frame(message: &ClientMessage) -> Vec<u8> {
    let payload = control::encode(message).unwrap();
    let length = u16::try_from(payload.len()).unwrap();
    match u8::try_from(length) {
        Ok(short @ 0..126) => [&[0x82, 0x80 | short, 0, 0, 0, 0], &payload[..]].concat(),
        _ => [&[0x82, 0xfe], &length.to_be_bytes()[..], &[0; 4], &payload].concat(),
    }
}

fn open(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
    stream
}

/// Connects and hangs up at one of five moments.
fn cycle(address: SocketAddr, number: usize) {
    let request = format!(
        "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
    );
    let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: "test".into() };
    let keys = (0..16).map(|x| WireKey { level: 0, x: x + number as i32 % 16, z: 0 }).collect();
    let messages = [
        ClientMessage::Hello(hello),
        ClientMessage::Credit { chunks: 100 },
        ClientMessage::Request { id: 1, keys },
    ]
    .map(|message| frame(&message))
    .concat();
    let mut stream = open(address);
    match number % 5 {
        0 => {}
        1 => stream.write_all(&request.as_bytes()[..request.len() / 2]).unwrap(),
        2 => stream.write_all(request.as_bytes()).unwrap(),
        moment => {
            stream.write_all(request.as_bytes()).unwrap();
            let mut head = [0; 12];
            stream.read_exact(&mut head).unwrap();
            assert!(head.ends_with(b" 101"), "{}", String::from_utf8_lossy(&head));
            let sent = if moment == 3 { messages.len() } else { messages.len() - 10 };
            // The server may have seen the end already.
            let _ = stream.write_all(&messages[..sent]);
        }
    }
}

/// The value of a metric.
fn metric(address: SocketAddr, name: &str) -> f64 {
    let mut stream = open(address);
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    value.unwrap_or_else(|| panic!("{name} is not in {text}")).parse().unwrap()
}

/// Runs so many cycles, and waits until no session, connection and job is left.
fn hang_up(address: SocketAddr, cycles: usize) {
    (0..cycles).for_each(|number| cycle(address, number));
    let busy = || {
        metric(address, "tombolo_sessions")
            + metric(address, "tombolo_generation_pending_jobs")
            + metric(address, "tombolo_connections")
    };
    // One connection asks.
    while busy() > 1.0 {
        std::thread::yield_now();
    }
}

/// All threads are counted: a job is allocated by a connection and freed by generation.
#[tokio::test]
async fn clients_that_hang_up_leave_nothing_on_the_heap() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let (stop, stopped) = oneshot::channel::<()>();
    // A cache would keep the chunks that are made before their clients hang up: on a loaded machine
    // some are, in other cycles each time.
    let config = ServerConfig { threads: 1, cache_bytes: 1, ..ServerConfig::default() };
    let running = tokio::spawn(server::run(listener, config, async {
        let _ = stopped.await;
    }));
    let live_after = async |cycles| {
        tokio::task::spawn_blocking(move || hang_up(address, cycles)).await.unwrap();
        live_of_all_threads()
    };
    let before = live_after(WARM_UP).await;
    let left = live_after(CYCLES).await - before;
    assert!(left <= MAX_LEFT, "{left} bytes after {CYCLES} cycles");
    // The control: a word of each cycle.
    let kept: Vec<_> = (0..CYCLES as u64).map(Box::new).collect();
    assert!(live_after(5).await - before > MAX_LEFT, "the count sees what remains");
    drop((kept, stop));
    running.await.unwrap().unwrap();
}
