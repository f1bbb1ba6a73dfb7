//! Connections that end with a reset (`SO_LINGER` of 0), in each state of theirs.

use crate::client::{Server, Session, config, get_over, request, upgrade, upgrade_request, value};
use protocol::message::ClientMessage;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use server::ServerConfig;
use server::tls::Tls;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;

/// Connections that are reset in one state.
const RESETS: u64 = 50;

/// Sessions that may be open: fewer than are reset, so that each of them has to release its place.
const PLACES: usize = 40;

/// Ends of a session whose connection was reset.
const FAILED: [&str; 2] = ["read_failed", "write_failed"];

/// A server that rejects no chunk as late.
async fn server() -> Server {
    let deadline = Duration::from_secs(60);
    Server::start(ServerConfig { max_sessions: PLACES, deadline, ..config() }).await
}

/// Closes a connection by a reset, whatever is unread.
fn reset(stream: TcpStream) {
    stream.set_zero_linger().unwrap();
    drop(stream);
}

#[tokio::test]
async fn resets_in_the_handshake_of_a_session_leave_nothing() {
    let server = server().await;
    let request = upgrade_request();
    for _ in 0..RESETS {
        // In the head.
        let mut stream = server.connect().await;
        stream.write_all(&request.as_bytes()[..request.len() / 2]).await.unwrap();
        reset(stream);
        // Behind it, before the answer.
        let mut stream = server.connect().await;
        stream.write_all(request.as_bytes()).await.unwrap();
        reset(stream);
        // Behind the answer, before the Hello.
        let mut stream = server.connect().await;
        assert_eq!(upgrade(&mut stream).await, 101);
        reset(stream);
    }
    server.is_empty().await;
    // Whether those in the middle begin a session depends on the system.
    let failed = server.ended(&FAILED).await;
    assert!((RESETS..=2 * RESETS).contains(&failed), "{failed}");
    server.serves().await;
    server.is_empty().await;
    assert_eq!(server.ended(&["closed"]).await, 1, "the last one was not reset");
    server.stop().await;
}

#[tokio::test]
async fn resets_in_a_frame_are_counted_as_failed_reads() {
    let server = server().await;
    for _ in 0..RESETS {
        let mut stream = Session::open(&server).await.into_stream();
        // The head of a masked binary frame of 100 bytes, and some of them.
        stream.write_all(&[0x82, 0x80 | 100, 0, 0, 0, 0, 1, 2, 3]).await.unwrap();
        reset(stream);
    }
    server.is_empty().await;
    assert_eq!(server.ended(&["read_failed"]).await, RESETS);
    server.serves().await;
    server.is_empty().await;
    assert_eq!(server.ended(&["closed"]).await, 1, "the last one was not reset");
    server.stop().await;
}

#[tokio::test]
async fn resets_while_chunks_are_sent_are_counted_and_leave_no_job() {
    let server = server().await;
    for id in 0..RESETS as u32 {
        let mut session = Session::open(&server).await;
        session.send(&ClientMessage::Credit { chunks: 512 }).await;
        session.send(&request(id, 512)).await;
        session.receive_chunks(1).await;
        reset(session.into_stream());
    }
    server.is_empty().await;
    assert_eq!(server.ended(&FAILED).await, RESETS);
    server.serves().await;
    server.stop().await;
}

#[tokio::test]
async fn resets_in_the_handshake_of_tls_are_counted_and_leave_no_connection() {
    const CERTIFICATE: &str = include_str!("../http/tls/first.crt");
    let file = |name: &str| Some(format!("{}/tests/http/tls/{name}", env!("CARGO_MANIFEST_DIR")).into());
    let tls = Tls::of_options(file("first.crt"), file("first.key")).unwrap();
    let server = Server::start(ServerConfig { tls, ..config() }).await;
    for number in 0..RESETS {
        let mut stream = server.connect().await;
        // Nothing; or the head of a record of 512 bytes, and some of them.
        if number % 2 == 0 {
            stream.write_all(&[22, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3]).await.unwrap();
        }
        reset(stream);
    }
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(CERTIFICATE.as_bytes()).unwrap()).unwrap();
    let client = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connector = TlsConnector::from(Arc::new(client));
    let failed = crate::client::in_time(async {
        loop {
            let name = ServerName::try_from("localhost").unwrap();
            let stream = connector.connect(name, server.connect().await).await.unwrap();
            let text = get_over(stream, "/metrics").await;
            if value(&text, "tombolo_connections") == 1 {
                return value(&text, "tombolo_connections_failed_total{reason=\"tls_handshake\"}");
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await;
    assert_eq!(failed, RESETS);
    server.stop().await;
}
