//! Limits of what the system keeps for a connection whose peer does not read. On systems other than
//! Linux those of the system apply while the connection is open.

use std::time::Duration;
use tokio::net::TcpStream;

/// Bytes of a connection that the system holds before it has sent them (`TCP_NOTSENT_LOWAT`,
/// tcp(7)). Without a limit it takes megabytes for each client that does not read, and copying them
/// delays all others. Bytes that wait there cannot follow a newer view, either. Bytes on the way
/// are not limited.
#[cfg(target_os = "linux")]
const UNSENT_BYTES: u32 = 64 * 1024;

/// Limits the unsent bytes, and ends the connection when its peer takes none for `timeout`, also
/// where a write has succeeded already (`TCP_USER_TIMEOUT`).
pub fn limit(stream: &TcpStream, timeout: Duration) {
    #[cfg(target_os = "linux")]
    {
        let socket = socket2::SockRef::from(stream);
        let _ = socket.set_tcp_notsent_lowat(UNSENT_BYTES);
        let _ = socket.set_tcp_user_timeout(Some(timeout));
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (stream, timeout);
}

/// Makes the drop of a stream give back what the system keeps for its peer, with a reset (RFC 9293,
/// section 3.10.4). Otherwise the system keeps it until the peer takes it or the timeout of
/// [`limit`].
pub fn discard(stream: &TcpStream) {
    // Fails only where the connection is gone already.
    let _ = stream.set_zero_linger();
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::io::ErrorKind;
    use tokio::io::AsyncReadExt;
    use tokio::net::{TcpListener, TcpSocket};

    /// Bytes that the system takes for a peer that does not read.
    async fn taken(is_limited: bool) -> usize {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(4096).unwrap();
        let peer = socket.connect(listener.local_addr().unwrap());
        let (_peer, accepted) = tokio::join!(peer, listener.accept());
        let (stream, _) = accepted.unwrap();
        if is_limited {
            limit(&stream, Duration::from_secs(10));
        }
        let (bytes, mut taken) = (vec![0; 1 << 20], 0);
        loop {
            stream.writable().await.unwrap();
            match stream.try_write(&bytes) {
                Ok(written) => taken += written,
                Err(_) => return taken,
            }
        }
    }

    #[tokio::test]
    async fn a_discarded_connection_ends_with_a_reset() {
        for is_discarded in [true, false] {
            let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
            let peer = TcpStream::connect(listener.local_addr().unwrap());
            let (peer, accepted) = tokio::join!(peer, listener.accept());
            let (mut peer, stream) = (peer.unwrap(), accepted.unwrap().0);
            if is_discarded {
                discard(&stream);
            }
            drop(stream);
            let read = peer.read_u8().await.map_err(|error| error.kind());
            let expected = if is_discarded { ErrorKind::ConnectionReset } else { ErrorKind::UnexpectedEof };
            assert_eq!(read, Err(expected));
        }
    }

    #[tokio::test]
    async fn the_system_takes_little_for_a_peer_that_does_not_read() {
        let limited = taken(true).await;
        assert!((1..4 * UNSENT_BYTES as usize).contains(&limited), "{limited}");
        let unlimited = taken(false).await;
        assert!(unlimited > 4 * UNSENT_BYTES as usize, "the control: {unlimited}");
    }
}
