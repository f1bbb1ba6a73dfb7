//! A flood of pings whose pongs are not read.

use crate::client::{Server, config, frame, hello, in_time, upgrade_request};
use server::ServerConfig;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use test_support::counting_allocator::live;

/// Bytes of the payloads of the floods, one session each: those with the most pongs for each byte,
/// and those with the longest.
const PAYLOADS: [usize; 3] = [0, 1, 125];

/// Most bytes of one flood that are live at once, as documented: the session, and pongs for the
/// pings of one read.
const MAX_LIVE: usize = 300 * 1024;

/// Bytes of pings that each flood has sent before another client is looked at.
const SENT: usize = 256 * 1024;

/// Sends pings and reads nothing after the handshake, until the connection ends. Returns the kind
/// of the error.
fn flood(address: SocketAddr, payload: usize, sent: &AtomicUsize) -> ErrorKind {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_write_timeout(Some(crate::client::TEST_TIMEOUT)).unwrap();
    stream.write_all(upgrade_request().as_bytes()).unwrap();
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        head.extend(byte);
    }
    assert!(head.starts_with(b"HTTP/1.1 101 "));
    stream.write_all(&frame(&hello())).unwrap();
    let ping = [&[0x89, 0x80 | payload as u8, 0, 0, 0, 0][..], &vec![7; payload]].concat();
    let pings = ping.repeat(64 * 1024 / ping.len());
    loop {
        match stream.write_all(&pings) {
            Ok(()) => sent.fetch_add(pings.len(), Ordering::Relaxed),
            Err(error) => return error.kind(),
        };
    }
}

#[tokio::test]
async fn pongs_that_are_not_read_take_bounded_memory_and_end_the_session_by_the_timeout_of_a_write() {
    let write_timeout = Duration::from_millis(1500);
    let server = Server::start(ServerConfig { write_timeout, ..config() }).await;
    server.serves().await;
    server.is_empty().await;
    let before = live();
    let floods = PAYLOADS.map(|payload| {
        let (address, sent) = (server.address, Arc::new(AtomicUsize::new(0)));
        let counted = Arc::clone(&sent);
        (tokio::task::spawn_blocking(move || flood(address, payload, &counted)), sent)
    });
    let mut most = 0;
    let mut watch = async |is_over: &dyn Fn() -> bool| {
        in_time(async {
            while !is_over() {
                most = most.max(live() - before);
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
        .await;
    };
    watch(&|| floods.iter().all(|(_, sent)| sent.load(Ordering::Relaxed) > SENT)).await;
    server.serves().await;
    watch(&|| floods.iter().all(|(flood, _)| flood.is_finished())).await;
    assert!(most < (MAX_LIVE * PAYLOADS.len()) as isize, "{most} bytes");
    for (flood, _) in floods {
        let error = flood.await.unwrap();
        assert!(matches!(error, ErrorKind::ConnectionReset | ErrorKind::BrokenPipe), "{error}");
    }
    server.is_empty().await;
    // By the timeout of the session, or by that of the system.
    let reasons = ["write_timeout", "write_failed", "read_failed"];
    assert_eq!(server.ended(&reasons).await, PAYLOADS.len() as u64);
    server.stop().await;
}
