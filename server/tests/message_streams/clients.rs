//! Sessions that send streams of valid messages as fast as the server reads, and read all answers.

use crate::faults;
use crate::messages::Generator;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Longest time without progress of a session; a test that reaches it fails.
const TEST_TIMEOUT: Duration = Duration::from_secs(120);

/// Sessions of a peer with faults, on average, at least.
const FAULTS_OF_PEER: u32 = 8;

/// A Close frame of code 1000, masked by zeros; and the server's answer.
const CLOSE: [u8; 8] = [0x88, 0x82, 0, 0, 0, 0, 0x03, 0xe8];
const CLOSED: [u8; 4] = [0x88, 2, 0x03, 0xe8];

/// The request of a session.
pub const HANDSHAKE: &[u8] = b"GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: upgrade\r\n\
    Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
    Sec-WebSocket-Protocol: tombolo.v1\r\n\r\n";

/// Runs sessions of so many messages each beside peers with faults, until each of these has
/// failed a few times. Panics if a session without faults ends before its own Close frame.
pub fn run(address: SocketAddr, sessions: u64, messages: u64, seed: u64, faulty_peers: u32) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let running: Vec<_> = (0..sessions)
            .map(|number| tokio::spawn(session(address, messages, seed.wrapping_mul(1 << 16) + number)))
            .collect();
        let faults = faults::start(address, faulty_peers, seed);
        for session in running {
            session.await.expect("no session fails");
        }
        let all_failed = faults.reach(FAULTS_OF_PEER * faulty_peers);
        tokio::time::timeout(TEST_TIMEOUT, all_failed).await.expect("peers with faults have sessions");
    });
}

async fn session(address: SocketAddr, messages: u64, seed: u64) {
    let mut generator = Generator::new(seed);
    let (mut reader, mut writer) = TcpStream::connect(address).await.unwrap().into_split();
    writer.write_all(HANDSHAKE).await.unwrap();
    let write = async {
        let hello = generator.hello();
        let mut bytes = generator.frames(&hello);
        for number in 0..messages {
            let message = generator.message();
            bytes.extend(generator.frames(&message));
            let written = tokio::time::timeout(TEST_TIMEOUT, writer.write_all(&bytes)).await;
            written
                .unwrap_or_else(|_| panic!("seed {seed}, message {number}: the server reads nothing"))
                .unwrap_or_else(|error| panic!("seed {seed}, message {number}: {error}"));
            bytes.clear();
        }
        writer.write_all(&CLOSE).await.unwrap();
    };
    let read = async {
        let (mut buffer, mut last) = (vec![0; 1 << 16], Vec::new());
        loop {
            let read = tokio::time::timeout(TEST_TIMEOUT, reader.read(&mut buffer)).await;
            let count = read.unwrap_or_else(|_| panic!("seed {seed}: nothing arrives")).unwrap();
            if count == 0 {
                return last;
            }
            last.extend_from_slice(&buffer[..count]);
            last.drain(..last.len().saturating_sub(CLOSED.len()));
        }
    };
    let ((), last) = tokio::join!(write, read);
    assert_eq!(last, CLOSED, "seed {seed}: the session ends with code 1000");
}
