//! Places of connections and sessions that many networks hold together.

use crate::client::Server;
use server::ServerConfig;
use server::access::tokens::TokenSet;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;

/// Longer than a test, so that no silent connection ends by itself.
const LONG: Duration = Duration::from_secs(120);

async fn server_with(max_sessions: usize) -> Server {
    let config =
        ServerConfig { threads: 1, max_sessions, handshake_timeout: LONG, ..ServerConfig::default() };
    Server::start_with(config).await
}

async fn connect_from(server: &Server, source: [u8; 4]) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind((source, 0).into()).unwrap();
    socket.connect(server.address).await.unwrap()
}

/// Before, twelve networks held all places, and accepting stopped for all clients.
#[tokio::test]
async fn networks_that_hold_all_connections_do_not_stop_accepting() {
    let server = server_with(4).await;
    let mut silent = Vec::new();
    for network in 2..14 {
        for _ in 0..150 {
            silent.push(connect_from(&server, [127, 0, 0, network]).await);
        }
    }
    for client in 101..111 {
        let asked = server.request_from([127, 0, 0, client], "/livez", &[]);
        assert_eq!(timeout(LONG / 4, asked).await.expect("it is accepted").status, 200);
    }
    assert!(server.metric("tombolo_connections_failed_total{reason=\"displaced\"}").await > 0.0);
    assert!(server.metric("tombolo_connections").await <= 260.0);
    drop(silent);
    server.stop().await;
}

#[tokio::test]
async fn a_client_without_a_session_displaces_one_of_the_site_that_has_the_most() {
    let server = server_with(4).await;
    let mut open = Vec::new();
    for source in [[127, 0, 0, 2], [127, 0, 0, 2], [127, 0, 0, 3], [127, 0, 0, 4]] {
        let (status, stream) = server.open_session_from(source).await;
        assert_eq!(status, 101);
        open.push(stream);
    }
    assert_eq!(server.open_session_from([127, 0, 0, 5]).await.0, 503);
    // The newest of the network with two has a Close frame with 1001.
    let mut head = [0; 4];
    timeout(LONG / 4, open[1].read_exact(&mut head)).await.expect("it is closed").unwrap();
    assert_eq!((head[0], &head[2..]), (0x88, &1001_u16.to_be_bytes()[..]));
    drop(open.remove(1));
    let placed = async {
        loop {
            let (status, stream) = server.open_session_from([127, 0, 0, 5]).await;
            if status == 101 {
                return stream;
            }
            tokio::task::yield_now().await;
        }
    };
    let placed = timeout(LONG / 4, placed).await.expect("its place is free");
    assert_eq!(server.metric("tombolo_sessions_ended_total{reason=\"displaced\"}").await, 1.0);
    drop((open, placed));
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_never_takes_its_place_ends_one_session() {
    let server = server_with(16).await;
    let mut open = Vec::new();
    for (network, count) in [(2, 8), (3, 4), (4, 2), (5, 1), (6, 1)] {
        for _ in 0..count {
            let (status, stream) = server.open_session_from([127, 0, 0, network]).await;
            assert_eq!(status, 101);
            open.push(stream);
        }
    }
    for _ in 0..20 {
        // The displaced session has 2 s to answer its Close frame: its place is not free yet.
        if server.open_session_from([127, 0, 0, 7]).await.0 == 101 {
            break;
        }
        // All together longer than the least time between displacements.
        tokio::time::sleep(Duration::from_millis(60)).await;
    }
    let closed = open.iter().filter(|stream| stream.try_read(&mut [0; 4]).is_ok()).count();
    assert_eq!(closed, 1);
    drop(open);
    server.stop().await;
}

/// Before, peers that can never have a session ended those of clients with a token.
#[tokio::test]
async fn a_client_without_a_token_displaces_no_session() {
    let config = ServerConfig {
        threads: 1,
        max_sessions: 4,
        handshake_timeout: LONG,
        tokens: Some(TokenSet::one("sesame")),
        ..ServerConfig::default()
    };
    let server = Server::start_with(config).await;
    let token = [("Authorization", "Bearer sesame")];
    let mut open = Vec::new();
    for network in [2, 2, 3, 4] {
        let (status, stream) = server.open_session_with([127, 0, 0, network], &[], &token).await;
        assert_eq!(status, 101);
        open.push(stream);
    }
    assert_eq!(server.open_session_from([127, 0, 0, 5]).await.0, 503);
    // The control: the same client with a token.
    assert_eq!(server.open_session_with([127, 0, 0, 5], &[], &token).await.0, 503);
    let mut head = [0; 4];
    timeout(LONG / 4, open[1].read_exact(&mut head)).await.expect("it is closed").unwrap();
    assert_eq!(head[0], 0x88);
    let closed = open.iter().filter(|stream| stream.try_read(&mut [0; 4]).is_ok()).count();
    assert!(closed <= 1, "the displaced one alone");
    drop(open);
    server.stop().await;
}
