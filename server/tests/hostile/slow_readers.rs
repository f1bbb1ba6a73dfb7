//! A download and a session that are read byte by byte. Each byte is progress for the client; the
//! system reports progress to the server only where its buffers have room again.

use crate::client::{Server, Session, config, request, value};
use protocol::message::ClientMessage;
use server::ServerConfig;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinHandle;

/// Requests of a download: megabytes of answers, more than all buffers have room for.
const REQUESTS: usize = 200;

/// Time between two bytes that a client reads: fewer bytes in a timeout than the system announces.
const PAUSE: Duration = Duration::from_millis(50);

/// A server that ends no connection sooner for another reason.
async fn server() -> Server {
    let (write_timeout, handshake_timeout) = (Duration::from_secs(1), Duration::from_secs(120));
    Server::start(ServerConfig { write_timeout, handshake_timeout, ..config() }).await
}

/// A connection whose end buffers little.
async fn connect(server: &Server) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    socket.connect(server.address).await.unwrap()
}

/// Reads byte by byte until the connection ends, and counts the bytes.
fn read_slowly(mut stream: TcpStream) -> (JoinHandle<()>, Arc<AtomicU64>) {
    let bytes = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&bytes);
    let reading = tokio::spawn(async move {
        while stream.read_u8().await.is_ok() {
            counted.fetch_add(1, Ordering::Relaxed);
            tokio::time::sleep(PAUSE).await;
        }
    });
    (reading, bytes)
}

#[tokio::test]
async fn downloads_that_are_read_byte_by_byte_end_by_the_timeout_of_a_write() {
    let server = server().await;
    let mut stream = connect(&server).await;
    let requests = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(REQUESTS);
    stream.write_all(&requests).await.unwrap();
    let (reading, bytes) = read_slowly(stream);
    server.serves().await;
    server.is_empty().await;
    assert!(bytes.load(Ordering::Relaxed) > 0, "it was answered");
    let answered = value(&server.metrics().await, "tombolo_http_responses_total{status=\"200\"}");
    assert!(answered < REQUESTS as u64, "{answered} answers");
    // The client goes on with what the system has for it, or has seen the reset.
    reading.abort();
    server.stop().await;
}

#[tokio::test]
async fn a_session_that_is_read_byte_by_byte_ends_by_the_timeout_of_a_write() {
    let server = server().await;
    let mut session = Session::over(connect(&server).await).await;
    session.send(&ClientMessage::Credit { chunks: 4096 }).await;
    for id in 0..8 {
        session.send(&request(id, 512)).await;
    }
    let (reading, bytes) = read_slowly(session.into_stream());
    server.serves().await;
    server.is_empty().await;
    // By the timeout of the session, or by that of the system.
    assert_eq!(server.ended(&["write_timeout", "write_failed", "read_failed"]).await, 1);
    assert_eq!(server.ended(&["closed"]).await, 1, "the other client closed its own");
    assert!(bytes.load(Ordering::Relaxed) > 0, "it was answered");
    reading.abort();
    server.stop().await;
}
