//! Peers with faults: connections that send byte by byte, read no answer, fall silent, and end in
//! the middle of a request or of a message, half of them by a reset.

use crate::clients::HANDSHAKE;
use crate::messages::Generator;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use test_support::Random;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use tokio::task::{JoinSet, yield_now};
use tokio::time::{sleep, timeout};

/// Most messages of a session.
const MESSAGES: usize = 40;

/// Most bytes that are sent one by one.
const DRIBBLED: usize = 200;

/// Longest stall, and longest wait for a server that reads nothing more.
const STALL: Duration = Duration::from_millis(300);

/// Time for the answer to the request of a session.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(10);

/// Peers that connect again after each fault, until this is dropped.
pub struct Faults {
    _peers: JoinSet<()>,
    /// A permit for each session that has begun and failed.
    failed: Arc<Semaphore>,
}

/// Starts the peers on the runtime of the caller.
pub fn start(address: SocketAddr, peers: u32, seed: u64) -> Faults {
    let (mut running, failed) = (JoinSet::new(), Arc::new(Semaphore::new(0)));
    for number in 0..peers {
        // Other streams than those of the valid sessions.
        let seed = !seed.wrapping_mul(1 << 16).wrapping_add(number.into());
        running.spawn(peer(address, seed, Arc::clone(&failed)));
    }
    Faults { _peers: running, failed }
}

impl Faults {
    /// Waits until so many sessions have begun and failed.
    pub async fn reach(&self, count: u32) {
        let _permits = self.failed.acquire_many(count).await.expect("it is never closed");
    }
}

/// One connection after the other.
async fn peer(address: SocketAddr, seed: u64, failed: Arc<Semaphore>) {
    let (mut random, mut generator) = (Random(seed), Generator::new(seed));
    loop {
        // The server may end a session first.
        if connection(address, &mut random, &mut generator).await.unwrap_or(false) {
            failed.add_permits(1);
        }
        yield_now().await;
    }
}

/// One connection up to its end. Whether a session began.
async fn connection(address: SocketAddr, random: &mut Random, generator: &mut Generator) -> io::Result<bool> {
    let mut stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    let begins = random.percent(90);
    if begins {
        stream.write_all(HANDSHAKE).await?;
        let mut status = [0; "HTTP/1.1 101".len()];
        timeout(ANSWER_TIMEOUT, stream.read_exact(&mut status)).await??;
        if &status != b"HTTP/1.1 101" {
            return Ok(false);
        }
    }
    let mut bytes = if begins { generator.stream(random.below(MESSAGES)) } else { HANDSHAKE.into() };
    bytes.truncate(random.below(bytes.len()));
    if random.percent(50) {
        for byte in bytes.chunks(1).take(DRIBBLED) {
            stream.write_all(byte).await?;
            yield_now().await;
        }
    } else if let Ok(written) = timeout(STALL, stream.write_all(&bytes)).await {
        written?;
    }
    if random.percent(50) {
        sleep(STALL.mul_f64(random.below(100) as f64 / 100.0)).await;
    }
    if random.percent(50) {
        stream.set_zero_linger()?;
    }
    Ok(begins)
}
