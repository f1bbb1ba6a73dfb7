//! A relay of TCP connections that can delay what comes back.

use anyhow::{Context, Result};
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// See the module. Its threads end with the connections; the one that accepts ends when the relay
/// goes out of scope.
#[derive(Debug)]
pub struct Relay {
    address: SocketAddr,
    delay_ms: Arc<AtomicU64>,
    is_over: Arc<AtomicBool>,
}

impl Relay {
    /// A relay on a free port of the loopback.
    ///
    /// # Errors
    /// No port is free.
    pub fn start(target: SocketAddr) -> Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0").context("no free port on 127.0.0.1")?;
        let address = listener.local_addr()?;
        let (delay_ms, is_over) = (Arc::<AtomicU64>::default(), Arc::<AtomicBool>::default());
        let (delay, over) = (Arc::clone(&delay_ms), Arc::clone(&is_over));
        thread::spawn(move || {
            for connection in listener.incoming().flatten() {
                if over.load(Ordering::Relaxed) {
                    return;
                }
                // The target is gone: the connection is closed, as if it were refused.
                if let Ok(to) = TcpStream::connect(target) {
                    relay(&connection, &to, &delay);
                }
            }
        });
        Ok(Self { address, delay_ms, is_over })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// From now on every part of an answer comes so much later.
    pub fn delay(&self, by: Duration) {
        self.delay_ms.store(by.as_millis() as u64, Ordering::Relaxed);
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        // Wakes the thread that accepts. It may have ended.
        let _ = TcpStream::connect(self.address);
    }
}

/// Starts a thread for each direction of a connection.
fn relay(from: &TcpStream, to: &TcpStream, delay_ms: &Arc<AtomicU64>) {
    let _ = (from.set_nodelay(true), to.set_nodelay(true));
    let none = Arc::default();
    for (source, sink, delay) in [(from, to, &none), (to, from, delay_ms)] {
        if let (Ok(source), Ok(sink)) = (source.try_clone(), sink.try_clone()) {
            let delay = Arc::clone(delay);
            thread::spawn(move || copy(source, sink, &delay));
        }
    }
}

/// Copies until either end closes; then closes both.
fn copy(mut source: TcpStream, mut sink: TcpStream, delay_ms: &AtomicU64) {
    let mut buffer = vec![0; 64 << 10];
    while let Ok(length @ 1..) = source.read(&mut buffer) {
        acknowledge(&source);
        thread::sleep(Duration::from_millis(delay_ms.load(Ordering::Relaxed)));
        if sink.write_all(&buffer[..length]).is_err() {
            break;
        }
    }
    // The peers may have closed them.
    let _ = (source.shutdown(Shutdown::Both), sink.shutdown(Shutdown::Both));
}

/// Acknowledges what was read at once. s3s-fs sends the head of an answer and its body apart, and
/// waits for the acknowledgement of the head (Nagle's algorithm), which the system delays by 40 ms.
/// Without this every read would take that long, whatever the store does.
#[cfg(target_os = "linux")]
fn acknowledge(stream: &TcpStream) {
    // Without it the answer is later and as right.
    let _ = rustix::net::sockopt::set_tcp_quickack(stream, true);
}

#[cfg(not(target_os = "linux"))]
fn acknowledge(_: &TcpStream) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_comes_back_and_a_gone_target_closes_the_connection() {
        let target = TcpListener::bind("127.0.0.1:0").unwrap();
        let relay = Relay::start(target.local_addr().unwrap()).unwrap();
        let mut client = TcpStream::connect(relay.address()).unwrap();
        let (mut server, _) = target.accept().unwrap();
        client.write_all(b"question").unwrap();
        let mut bytes = [0; 8];
        server.read_exact(&mut bytes).unwrap();
        server.write_all(&bytes).unwrap();
        client.read_exact(&mut bytes).unwrap();
        assert_eq!(&bytes, b"question");
        drop((server, target));
        assert_eq!(client.read(&mut bytes).unwrap_or(0), 0);
        let mut late = TcpStream::connect(relay.address()).unwrap();
        assert_eq!(late.read(&mut bytes).unwrap_or(0), 0);
    }
}
