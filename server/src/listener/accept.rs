//! Accepts one connection after the other, whatever fails.

use crate::limits::system_buffers;
use std::io::ErrorKind;
use std::mem;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, sleep};

/// Pause after a failed accept. The usual cause is a lack of file descriptors, which an immediate
/// retry would meet again.
const RETRY: Duration = Duration::from_millis(100);

/// Time between two lines about failed accepts.
const LOG_INTERVAL: Duration = Duration::from_secs(60);

/// Accepts one connection, retrying after failures. The system ends it when its peer takes no bytes
/// for `write_timeout`.
pub async fn accept(
    listener: &TcpListener,
    write_timeout: Duration,
    failures: &mut AcceptFailures,
) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                // Messages are written whole; Nagle's algorithm would only delay the last packet.
                let _ = stream.set_nodelay(true);
                system_buffers::limit(&stream, write_timeout);
                return (stream, peer);
            }
            Err(error) if is_of_connection(error.kind()) => {
                tracing::debug!(%error, "connection ended before its accept");
            }
            Err(error) => {
                if let Some(failures) = failures.record(Instant::now()) {
                    tracing::warn!(%error, failures, "cannot accept a connection");
                }
                sleep(RETRY).await;
            }
        }
    }
}

/// Whether an accept failed because its connection has ended: no other one has to wait then. After
/// any other error, such as EPERM of a security module, the same connection may be the next one: a
/// retry without a pause would take a core.
fn is_of_connection(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::ConnectionAborted | ErrorKind::ConnectionReset | ErrorKind::ConnectionRefused)
}

/// Failed accepts: there are ten a second while file descriptors lack, and one line a minute.
#[derive(Debug, Default)]
pub struct AcceptFailures {
    logged: Option<Instant>,
    /// Failures since then.
    count: u64,
}

impl AcceptFailures {
    /// Counts a failure; if a line is due, the failures since the last one.
    fn record(&mut self, now: Instant) -> Option<u64> {
        self.count += 1;
        if self.logged.is_some_and(|logged| now.saturating_duration_since(logged) < LOG_INTERVAL) {
            return None;
        }
        self.logged = Some(now);
        Some(mem::take(&mut self.count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_accepts_have_one_line_a_minute_with_their_number() {
        let (mut failures, start) = (AcceptFailures::default(), Instant::now());
        assert_eq!(failures.record(start), Some(1));
        let soon = (1..600).filter_map(|n| failures.record(start + RETRY * n)).count();
        assert_eq!(soon, 0);
        assert_eq!(failures.record(start + LOG_INTERVAL), Some(600));
        assert_eq!(failures.record(start + LOG_INTERVAL), None);
    }

    /// Before, a client that ended its connection early delayed all others by 0.1 s.
    #[test]
    fn only_an_error_that_the_next_accept_may_meet_needs_a_pause() {
        for kind in [ErrorKind::ConnectionAborted, ErrorKind::ConnectionReset, ErrorKind::ConnectionRefused] {
            assert!(is_of_connection(kind), "{kind}");
        }
        #[cfg(unix)]
        for error in [libc::EMFILE, libc::ENFILE, libc::ENOBUFS, libc::ENOMEM, libc::EPERM, libc::EINVAL] {
            let error = std::io::Error::from_raw_os_error(error);
            assert!(!is_of_connection(error.kind()), "{error}");
        }
    }
}
