//! Hostile sockets: heads without end, floods of pings, readers of a byte a second, storms of
//! connections and resets. Each ends or is answered, and other sessions are unaffected.

use futures_util::{SinkExt, StreamExt};
use protocol::message::{ClientMessage, Hello, WireKey};
use protocol::{Delivery, SUBPROTOCOL, control};
use server::ServerConfig;
use std::time::Duration;
use tests::peer::{Peer, TestClient, view};
use tests::{RunningServer, running};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinSet;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Bytes, Message};

/// Timeout of every wait.
const TEST_TIMEOUT: Duration = Duration::from_secs(30);

fn encoded(message: &ClientMessage) -> Message {
    Message::Binary(control::encode(message).unwrap().to_vec().into())
}

fn hello() -> ClientMessage {
    ClientMessage::Hello(Hello {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: "hostile".into(),
    })
}

/// A session over a given socket.
async fn session_over(server: &RunningServer, stream: TcpStream) -> WebSocketStream<TcpStream> {
    let mut request = server.stream_url().as_str().into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", SUBPROTOCOL.parse().unwrap());
    let (mut session, _) = tokio_tungstenite::client_async(request, stream).await.unwrap();
    session.send(encoded(&hello())).await.unwrap();
    session.next().await.unwrap().unwrap();
    session
}

async fn metrics(server: &RunningServer) -> String {
    let url = server.url("/metrics");
    let get = move || ureq::get(url).call().unwrap().body_mut().read_to_string().unwrap();
    tokio::task::spawn_blocking(get).await.unwrap()
}

/// The value of a series of `/metrics`; none if it is absent.
async fn metric(server: &RunningServer, series: &str) -> Option<u64> {
    let text = metrics(server).await;
    text.lines().find_map(|line| line.strip_prefix(series)?.trim().parse().ok())
}

/// Sessions that ended, for whatever reason.
async fn ended(server: &RunningServer) -> u64 {
    let text = metrics(server).await;
    let ended = text.lines().filter_map(|line| line.strip_prefix("tombolo_sessions_ended_total{"));
    ended.filter_map(|line| line.rsplit(' ').next()?.parse::<u64>().ok()).sum()
}

async fn wait_for(server: &RunningServer, series: &str, value: u64) {
    let reached = async {
        while metric(server, series).await != Some(value) {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let ended = tokio::time::timeout(TEST_TIMEOUT, reached).await;
    assert!(ended.is_ok(), "{series} is {:?}, not {value}", metric(server, series).await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_head_without_end_is_rejected_with_431() {
    let server = RunningServer::start().await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Long: ").await.unwrap();
    let (mut reader, mut writer) = stream.into_split();
    let writing = tokio::spawn(async move {
        let mut sent = 0;
        // An error means that the server ended the connection.
        while sent < 64 << 20 && writer.write_all(&[b'a'; 16 << 10]).await.is_ok() {
            sent += 16 << 10;
        }
        sent
    });
    let mut reply = [0; 12];
    let read = tokio::time::timeout(TEST_TIMEOUT, reader.read_exact(&mut reply)).await;
    read.expect("the head is rejected").expect("a reply comes before the end");
    assert_eq!(str::from_utf8(&reply), Ok("HTTP/1.1 431"));
    drop(reader);
    let sent = tokio::time::timeout(TEST_TIMEOUT, writing).await.expect("the connection ends").unwrap();
    assert!(sent < 64 << 20, "all of it was read");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_pings_is_answered_and_another_session_is_served() {
    // A read of many pings rarely ends where a frame does: none of them takes longer than this.
    let config = ServerConfig { message_timeout: Duration::from_secs(1), ..running::quick_config() };
    let server = RunningServer::start_with(config).await;
    let (mut flooding, mut reading) = (JoinSet::new(), JoinSet::new());
    for _ in 0..4 {
        let stream = TcpStream::connect(server.address).await.unwrap();
        let (mut sender, mut receiver) = session_over(&server, stream).await.split();
        flooding.spawn(async move {
            let payload = Bytes::from_static(&[7; 125]);
            while sender.feed(Message::Ping(payload.clone())).await.is_ok() {}
        });
        reading.spawn(async move {
            let mut answers = 0;
            while let Some(Ok(message)) = receiver.next().await {
                assert!(matches!(message, Message::Pong(_)), "{message:?}");
                answers += 1;
                if answers == 20_000 {
                    return;
                }
            }
            panic!("the session ended after {answers} pongs");
        });
    }
    let mut client = TestClient::connect(&server.stream_url()).await;
    let settled = tokio::time::timeout(TEST_TIMEOUT, client.settle(view(1, 500))).await;
    settled.expect("another session is served in the flood");
    // Every flooder was answered.
    let answered = tokio::time::timeout(TEST_TIMEOUT, reading.join_all()).await;
    answered.expect("pings are answered");
    flooding.abort_all();
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_that_reads_a_byte_a_second_is_closed() {
    let server = RunningServer::start().await;
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let stream = socket.connect(server.address).await.unwrap();
    let mut session = session_over(&server, stream).await;
    session.send(encoded(&ClientMessage::Credit { chunks: 4096 })).await.unwrap();
    let keys: Vec<_> = (0..512).map(|n| WireKey { level: 0, x: n % 32 - 16, z: n / 32 - 8 }).collect();
    session.send(encoded(&ClientMessage::Request { id: 1, keys })).await.unwrap();
    let mut raw = session.into_inner();
    let reading = tokio::spawn(async move {
        let mut byte = [0];
        while raw.read_exact(&mut byte).await.is_ok() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    });
    let mut client = TestClient::connect(&server.stream_url()).await;
    client.settle(view(1, 300)).await;
    drop(client);
    wait_for(&server, "tombolo_sessions", 0).await;
    // By the write's timeout, or by the system's.
    assert_eq!(ended(&server).await, 2);
    reading.abort();
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_storm_of_reconnections_leaves_no_session() {
    const CLIENTS: usize = 16;
    const TIMES: usize = 50;
    let server = RunningServer::start().await;
    let mut storm = JoinSet::new();
    for client in 0..CLIENTS {
        let url = server.stream_url();
        storm.spawn(async move {
            for time in 0..TIMES {
                let mut peer = Peer::connect(&url).await;
                // Every other one leaves before it says anything.
                if (client + time) % 2 == 0 {
                    peer.send(encoded(&hello())).await;
                    peer.receive().await.expect("a welcome");
                }
            }
        });
    }
    let mut client = TestClient::connect(&server.stream_url()).await;
    let settled = tokio::time::timeout(TEST_TIMEOUT, client.settle(view(1, 500))).await;
    settled.expect("another session is served in the storm");
    storm.join_all().await;
    drop(client);
    let all_ended = async {
        while ended(&server).await < (CLIENTS * TIMES) as u64 + 1 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(TEST_TIMEOUT, all_ended).await.expect("every session ends");
    wait_for(&server, "tombolo_sessions", 0).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn resets_at_any_moment_leave_no_session_and_no_connection() {
    let server = RunningServer::start().await;
    let before = metric(&server, "tombolo_connections").await.unwrap();
    for moment in 0..60 {
        let stream = TcpStream::connect(server.address).await.unwrap();
        // Its close is a reset, whatever is unread.
        stream.set_zero_linger().unwrap();
        match moment % 4 {
            // In the request's head.
            0 => {
                let mut stream = stream;
                stream.write_all(b"GET /v1/stream HTTP/1.1\r\nHost: loc").await.unwrap();
            }
            // After the welcome.
            1 => drop(session_over(&server, stream).await),
            // While chunks are sent.
            2 => {
                let mut session = session_over(&server, stream).await;
                session.send(encoded(&ClientMessage::Credit { chunks: 64 })).await.unwrap();
                let keys = (0..64).map(|n| WireKey { level: 0, x: n % 8, z: n / 8 - moment }).collect();
                session.send(encoded(&ClientMessage::Request { id: 1, keys })).await.unwrap();
                session.next().await.unwrap().unwrap();
            }
            // In the middle of a frame: the head of a masked binary frame of 100 bytes.
            _ => {
                let mut raw = session_over(&server, stream).await.into_inner();
                raw.write_all(&[0x82, 0x80 | 100, 1, 2, 3, 4, 5]).await.unwrap();
            }
        }
    }
    wait_for(&server, "tombolo_sessions", 0).await;
    wait_for(&server, "tombolo_connections", before).await;
    let mut client = TestClient::connect(&server.stream_url()).await;
    client.settle(view(1, 500)).await;
    server.stop().await;
}
